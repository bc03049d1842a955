"""Damaged files for every reader, as a study."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.hostile.readers import READERS
from benchmarks.hostile.run import FAILURES, Limits, try_reader
from benchmarks.hostile.samples import write_samples
from benchmarks.study import Record, Study
from scoup.base.errors import looked_up
from scoup_lab.bench import markdown


@dataclass(frozen=True, kw_only=True)
class Hostile(Study):
    """Give every reader damaged files: none may crash, hang, take memory beyond its allowance, or fail but by a
    ScoupError.

    Valid files of every format are cut, flipped, spliced and changed at numbers of their headers; containers (zip,
    gzip, zstd, PNG, safetensors) are opened, damaged inside and closed again with fitting lengths and checksums. The
    same seed gives the same files. The command ends with 1 where there are failures. Linux only.
    """

    per_reader: int = 10_000
    """Files for each reader."""
    seed: int = 0
    """Of the damage."""
    readers: tuple[str, ...] = ()
    """Some readers only, by name."""
    processes: int = 1
    """Readers at work at once."""
    seconds: float = 10.0
    """Of the processor that one file may take."""
    failures: Path | None = None
    """Folder for the files that made a reader fail."""

    def check(self) -> None:
        for name in self.readers:
            looked_up("reader", name, READERS)

    def measure(self, known: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        names = [name for name in READERS if name in (self.readers or READERS) and name not in known]
        names.sort(key=lambda name: READERS[name].share)  # those that take longest first
        limits = Limits(processor=self.seconds)
        with (
            tempfile.TemporaryDirectory(prefix="hostile-") as name,
            ThreadPoolExecutor(self.processes) as pool,
        ):
            samples = Path(name)
            write_samples(samples)

            def figures(reader: str) -> Record:
                trial = try_reader(
                    reader, samples, self.per_reader, self.seed, limits=limits, failures=self.failures
                )
                found = [
                    {"reader": reader, "number": each.number, "outcome": each.outcome, "said": each.said}
                    for each in trial.failures
                ]
                return {**trial.to_dict(), "allowed": str(READERS[reader].memory), "failures": found}

            yield from zip(names, pool.map(figures, names), strict=True)

    def line(self, figures: Any) -> str:
        return f"{figures['files']:,} files, {len(figures['failures'])} failures"

    def record(self, rows: dict[str, Any]) -> Record:
        failures = [each for row in rows.values() for each in row["failures"]]
        readers = [{key: row[key] for key in row if key != "failures"} for row in rows.values()]
        return {"readers": readers, "failures": failures}

    @staticmethod
    def failed(record: Record) -> bool:
        return bool(record["failures"])

    @staticmethod
    def table(record: Record) -> str:
        """Return one line per reader."""
        heads = ["reader", "files", "accepted", "refused", "other errors", "memory", "hangs", "crashes", "allowed",
                 "most, MB", "most, times the file"]  # fmt: skip
        rows = []
        for of in record["readers"]:
            counts = [f"{of[name]:,}" for name in ("files", "accepted", "refused", *FAILURES)]
            most = [f"{of['most_grown_bytes'] / 2**20:.1f}", f"{of['most_times_the_file']:.1f}"]
            rows.append([of["reader"], *counts, of["allowed"], *most])
        return markdown(heads, rows)
