"""scoup bench: the time of every stage on this machine."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar

from scoup.cli.console import Console
from scoup.cli.options import OptionalPath, OptionGroups, WritesCommon, arg

if TYPE_CHECKING:
    from scoup_lab.bench import Row

Names = Annotated[tuple[str, ...], arg(metavar="NAME [NAME ...]")]
Counts = Annotated[tuple[int, ...], arg(metavar="INT [INT ...]")]


@dataclass(frozen=True, kw_only=True)
class Bench(WritesCommon):
    """Time every stage on one view of a random scene, backend against backend.

    Runs are interleaved and medians are printed, so that ratios are right even where the machine is not idle. Needs no
    data and takes less than a minute; the larger measurements behind the documents are in benchmarks/.
    """

    option_groups: ClassVar[OptionGroups] = {
        "view": "n_gaussians width height",
        "measuring": "stages backends threads repeats",
    }

    n_gaussians: tuple[int, ...] = (100_000,)
    """Gaussians in the scene; one or several numbers."""
    width: int = 480
    """Width of the view, in pixels."""
    height: int = 360
    """Height of the view, in pixels."""
    threads: Counts = ()
    """Numbers of threads to measure. Default: as many as torch uses."""
    repeats: int = 5
    """Timed repetitions of each stage, after one warm-up."""
    backends: Names = ()
    """Backends of the rasteriser. Default: all that work here."""
    stages: Names = ()
    """Stages to time, among project, alpha, sums, colors, codes, cosines, vote. Default: all."""
    out: OptionalPath = None
    """JSON file for the figures, the machine and the commit."""

    def run(self, console: Console) -> None:
        """Measure and print."""
        from scoup.io import check_output
        from scoup_lab.bench import comparison, describe_environment, usable_backends, write_json
        from scoup_lab.bench.environment import in_one_line

        self._check()
        if self.out is not None:
            check_output(self.out, self.overwrite)
        backends, reasons = usable_backends(self.backends, self.device)
        environment = describe_environment()
        console.say(in_one_line(environment))
        size = f"{self.width} x {self.height}"
        console.say(f"one view of {size}, three levels, L = 64, K = 4, one query; medians of {self.repeats}")
        rows = self._measure(console, backends)
        _say_table(console, rows, backends, reasons)
        record = {
            "what": "scoup bench: stages on one view of the random scene",
            "machine": environment,
            "device": self.device,
            "width": self.width,
            "height": self.height,
            "backends": backends,
            "backends_not_working": reasons,
            **comparison(rows),
        }
        if self.out is not None:
            write_json(self.out, record, self.overwrite)
            console.say(f"\nfigures: {self.out}")
        console.result(record | ({} if self.out is None else {"out": str(self.out)}))

    def _check(self) -> None:
        from scoup.base.errors import InputError, UnknownNameError
        from scoup_lab.bench import STAGES

        counts: dict[str, tuple[int, ...]] = {
            "n-gaussians": self.n_gaussians,
            "width": (self.width,),
            "height": (self.height,),
            "threads": self.threads,
            "repeats": (self.repeats,),
        }
        for name, values in counts.items():
            if any(value < 1 for value in values):
                raise InputError(f"--{name} must be 1 or more, got {min(values)}")
        if not self.n_gaussians:
            raise InputError("--n-gaussians: expected at least one number, such as 100000")
        for stage in self.stages:
            if stage not in STAGES:
                raise UnknownNameError("stage", stage, STAGES)

    def _measure(self, console: Console, backends: list[str]) -> list[Row]:
        import torch

        from scoup_lab.bench import STAGES, random_workload, stage_runs, time_stages

        threads = self.threads or (torch.get_num_threads(),)
        stages = dict.fromkeys(self.stages or STAGES)
        rows: list[Row] = []
        for count in dict.fromkeys(self.n_gaussians):
            work = random_workload(count, self.width, self.height).to(self.device)
            runs = {backend: stage_runs(work, backend, stages) for backend in backends}
            with console.progress() as progress:
                rows += time_stages(work, runs, threads, self.repeats, self.device, progress)
        return rows


def _say_table(console: Console, rows: list[Row], backends: list[str], reasons: dict[str, str]) -> None:
    """Print the table, what its stages are, and which backends do not work here."""
    from scoup_lab.bench import STAGES, stage_table
    from scoup_lab.bench.report import SPECIFICATION

    console.say("\n" + stage_table(rows) + "\n")
    for name in dict.fromkeys(row.stage for row in rows):
        console.say(f"{name}: {STAGES[name]}")
    for name, reason in reasons.items():
        console.say(f"backend {name} does not work here: {reason}")
    if backends == [SPECIFICATION]:
        console.say(f"only {SPECIFICATION} was measured, so there is nothing to compare it with")
