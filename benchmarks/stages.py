"""Times of every stage of the method on one view, backend against backend."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from benchmarks.study import Record, Study, report
from scoup_lab.bench import STAGES, Task, markdown, random_workload, stage_runs, time_tasks, usable_backends
from scoup_lab.bench.report import milliseconds

REFERENCE = "reference"  # the backend with which others are compared


@dataclass(frozen=True, kw_only=True)
class Stages(Study):
    """Time every stage on one view of a random scene: three levels, L = 64, K = 4, one query.

    Runs are interleaved and medians are taken, so that ratios are right even where the machine is not idle.
    """

    n_gaussians: tuple[int, ...] = (100_000, 300_000)
    """Gaussians in the scene; one or several numbers."""
    width: int = 988
    """Width of the view, in pixels."""
    height: int = 731
    """Height of the view, in pixels."""
    threads: tuple[int, ...] = (1, 2)
    """Numbers of threads."""
    repeats: int = 5
    """Timed repetitions of each stage, after one warm-up."""
    backends: tuple[str, ...] = ()
    """Backends of the rasteriser. Default: all that work here."""
    stages: tuple[str, ...] = tuple(STAGES)
    """Stages to time."""
    device: str = "cpu"
    """Device of the tensors: cpu or cuda."""

    rows_depend_on = ("width", "height", "threads", "repeats", "backends", "stages", "device")

    def measure(self, known: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        backends, _ = usable_backends(self.backends, self.device)
        for count in self.n_gaussians:
            if str(count) in known:
                continue
            work = random_workload(count, self.width, self.height).to(self.device)
            runs = {backend: stage_runs(work, backend, self.stages) for backend in backends}
            tasks = {
                (stage, backend, threads): Task(runs[backend][stage], threads, self.repeats)
                for stage in self.stages
                for backend in backends
                for threads in self.threads
            }
            timings = time_tasks(tasks, self.device, report)
            yield (
                str(count),
                [
                    {"stage": stage, "backend": backend, "threads": threads, **timing.to_dict()}
                    for (stage, backend, threads), timing in timings.items()
                ],
            )

    def record(self, rows: dict[str, Any]) -> Record:
        return {"rows": rows, "not_working": usable_backends(self.backends, self.device)[1]}

    @staticmethod
    def table(record: Record) -> str:
        """Return medians of each backend, and how many times as long the reference takes."""
        medians = {
            (int(count), row["stage"], row["backend"], row["threads"]): row["median_s"]
            for count, rows in record["rows"].items()
            for row in rows
        }
        threads = list(dict.fromkeys(key[-1] for key in medians))
        lines = dict.fromkeys(key[:-1] for key in medians)
        body = []
        for count, stage, backend in lines:
            if backend == REFERENCE and any(
                line[:2] == (count, stage) and line[2] != backend for line in lines
            ):
                continue
            cells = [f"{count:,}", stage, backend]
            for used in threads:
                median = medians[count, stage, backend, used]
                reference = medians.get((count, stage, REFERENCE, used))
                cells += [milliseconds(median), "-" if reference is None else f"{reference / median:.1f} x"]
            body.append(cells)
        heads = [head for used in threads for head in (f"ms, threads: {used}", "reference takes")]
        reasons = [
            f"\nbackend {name} does not work here: {why}" for name, why in record["not_working"].items()
        ]
        return markdown(["Gaussians", "stage", "backend", *heads], body) + "".join(reasons)
