"""Damaged files for every reader: none may crash, hang, take memory beyond its allowance, or fail but by a ScoupError.

    python -m benchmarks.hostile [--per-reader 10000] [--seed 0] [--readers spz glb] [--out FILE.json]

Valid files of every format are cut, flipped, spliced and changed at numbers of their headers; containers (zip, gzip,
zstd, PNG, safetensors) are opened, damaged inside and closed again with fitting lengths and checksums. The same seed
gives the same files. Linux only.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

from benchmarks.hostile.readers import READERS
from benchmarks.hostile.run import FAILURES, Limits, Trial, try_reader
from benchmarks.hostile.samples import write_samples
from scoup.base.errors import InputError
from scoup.io import check_output
from scoup_lab.bench import describe_environment, markdown, write_json
from scoup_lab.bench.environment import in_one_line


@dataclass(frozen=True)
class Arguments:
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
    out: Path | None = None
    """Where to write the figures as JSON."""
    overwrite: bool = False
    """Replace OUT."""


def main(arguments: Arguments) -> dict[str, Any]:
    """Make the files, have them read, print the table, give the record."""
    if arguments.out is not None:
        check_output(arguments.out, arguments.overwrite)
    unknown = set(arguments.readers) - set(READERS)
    if unknown:
        raise InputError(f"no readers named {', '.join(sorted(unknown))}; there are {', '.join(READERS)}")
    environment = describe_environment()
    with tempfile.TemporaryDirectory(prefix="hostile-") as folder:
        write_samples(Path(folder))
        trials = all_trials(arguments, Path(folder))
    record = {
        "what": "benchmarks.hostile: damaged files for every reader",
        "environment": environment,
        "settings": {
            "per_reader": arguments.per_reader,
            "seed": arguments.seed,
            "seconds": arguments.seconds,
        },
        "readers": [{**trial.record(), "allowed": str(READERS[trial.name].memory)} for trial in trials],
        "failures": [
            {"reader": trial.name, "number": result.number, "outcome": result.outcome, "said": result.said}
            for trial in trials
            for result in trial.failures
        ],
    }
    print(in_one_line(environment))
    print(table(record["readers"]))
    if arguments.out is not None:
        write_json(arguments.out, record, arguments.overwrite)
    return record


def all_trials(arguments: Arguments, samples: Path) -> list[Trial]:
    """The trials of all readers that are wanted."""

    def trial(name: str) -> Trial:
        limits = Limits(processor=arguments.seconds)
        found = try_reader(
            name, samples, arguments.per_reader, arguments.seed, limits=limits, failures=arguments.failures
        )
        print(f"{name}: {dict(found.outcomes)}", file=sys.stderr, flush=True)
        return found

    names = [name for name in READERS if name in (arguments.readers or READERS)]
    names.sort(key=lambda name: READERS[name].share)  # those that take longest first
    with ThreadPoolExecutor(arguments.processes) as pool:
        return list(pool.map(trial, names))


def table(readers: Sequence[Mapping[str, Any]]) -> str:
    """One line a reader, from its record."""
    heads = ["reader", "files", "accepted", "refused", "other errors", "memory", "hangs", "crashes", "allowed",
             "most, MB", "most, times the file"]  # fmt: skip
    rows = []
    for of in readers:
        counts = [f"{of[name]:,}" for name in ("files", "accepted", "refused", *FAILURES)]
        most = [f"{of['most_grown_bytes'] / 2**20:.1f}", f"{of['most_times_the_file']:.1f}"]
        rows.append([of["reader"], *counts, of["allowed"], *most])
    return markdown(heads, rows)


if __name__ == "__main__":
    sys.exit(1 if main(tyro.cli(Arguments, description=__doc__))["failures"] else 0)
