"""A trial of one reader: many damaged files, read in processes that may end in any way."""

from __future__ import annotations

import multiprocessing
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, get_args

from benchmarks.hostile.worker import BROKEN, VALID, Job, Outcome, Result, damaged_file, work
from scoup.base.errors import InputError

FAILURES = tuple(outcome for outcome in get_args(Outcome) if outcome not in ("accepted", "refused"))
LEAST = 1 << 16  # bytes of a file that counts for multiples; smaller ones are lost in pages
READERS = "benchmarks.hostile.readers:READERS"


@dataclass(frozen=True)
class Limits:
    """Limits of the reading of a file."""

    processor: float = 10.0  # seconds of it that one file may take
    # seconds without a word after which a process is ended; far more than ``processor``, for busy machines
    # and readers that wait for others
    wall: float = 300.0


@dataclass
class Trial:
    """Outcomes of the files of one reader."""

    name: str  # of the reader
    outcomes: Counter[str] = field(default_factory=Counter)  # how many files had each
    failures: list[Result] = field(default_factory=list)  # results that should not be
    most_grown: int = 0  # largest growth of the process in bytes
    # largest growth as a multiple of the file's size, of files of at least ``LEAST`` bytes
    most_times: float = 0.0

    @property
    def files(self) -> int:
        return sum(self.outcomes.values())

    def add(self, result: Result) -> None:
        """Count a result."""
        self.outcomes[result.outcome] += 1
        self.most_grown = max(self.most_grown, result.grown)
        if result.size >= LEAST:
            self.most_times = max(self.most_times, result.grown / result.size)
        if result.outcome in FAILURES:
            self.failures.append(result)

    def to_dict(self) -> dict[str, Any]:
        """Return the record, for JSON."""
        return {
            "reader": self.name,
            "files": self.files,
            **{outcome: self.outcomes[outcome] for outcome in get_args(Outcome)},
            "most_grown_bytes": self.most_grown,
            "most_times_the_file": round(self.most_times, 2),
        }


def try_reader(
    name: str,
    samples: Path,
    count: int,
    seed: int = 0,
    readers: str = READERS,
    limits: Limits | None = None,
    failures: Path | None = None,
) -> Trial:
    """Give a reader ``count`` damaged files.

    ``name``, ``readers``: see ``worker.Job``.
    """
    trial, limits = Trial(name), limits or Limits()
    while trial.files < count:
        job = Job(readers, name, samples, seed, range(trial.files, count), limits.processor)
        for result in _results(job, limits):
            trial.add(result)
            if failures is not None and result.outcome in FAILURES:
                _save(failures, job, result)
    return trial


def _results(job: Job, limits: Limits) -> list[Result]:
    """Return results of a process: of all files of the job, or up to the one at which it ended."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["benchmarks.hostile.worker"])
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=work, args=(sender, job), daemon=False)
    process.start()
    sender.close()
    found: list[Result] = []
    outcome: Outcome = "crash"
    started = False
    try:
        while len(found) < len(job.numbers):
            if started and not receiver.poll(limits.wall):
                outcome = "hang"
                break
            result = receiver.recv()
            if result.number == BROKEN:
                raise RuntimeError(result.said)
            if result.number == VALID:
                started = True
                if result.outcome != "accepted":
                    raise InputError(f"{job.name}: its valid sample is not read ({result.said})")
            else:
                found.append(result)
    except EOFError:
        pass
    finally:
        if len(found) < len(job.numbers):
            process.kill()
        process.join()
    if not started:
        raise InputError(
            f"{job.name}: the process ended at its valid sample (exit status {process.exitcode})"
        )
    if len(found) < len(job.numbers):
        number = job.numbers[len(found)]
        said = "no word any more" if outcome == "hang" else f"exit status {process.exitcode}"
        found.append(Result(number, len(damaged_file(job, number)), outcome, said))
    return found


def _save(folder: Path, job: Job, result: Result) -> None:
    place = folder / job.name.replace(" ", "_").replace(",", "")
    place.mkdir(parents=True, exist_ok=True)
    stem = f"{result.number:06d}-{result.outcome.replace(' ', '-')}"
    (place / f"{stem}{Path(job.reader.file).suffix}").write_bytes(damaged_file(job, result.number))
    (place / f"{stem}.said").write_text(result.said + "\n", errors="backslashreplace")
