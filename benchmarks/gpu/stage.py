"""A stage: the device, sizes, a view of the room, and rows that are sent as they are known."""

from __future__ import annotations

import gc
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import torch

from scoup import raster
from scoup.scene.cameras import Camera
from scoup.scene.gaussians import Gaussians
from scoup_lab.bench import (
    Task,
    Timing,
    Watch,
    Workload,
    random_scene_cameras,
    random_scene_gaussians,
    time_tasks,
)
from scoup_lab.bench.measure import DeviceClock
from scoup_lab.bench.stages import make_workload
from scoup_lab.synthetic.random_scene import HEIGHT, REGIONS, WIDTH, voronoi_labels

PRESET = "gsplat"  # of both rasterisers, so that they draw the same picture
LEAST_SECONDS = 0.02  # of a repetition: what is shorter runs several times in a row
NO_TIME = "no time was left"
LOST = 3  # exit code: the device is lost

Row = dict[str, Any]
Runs = dict[str, Callable[[], object]]


class Unavailable(Exception):
    """The reason why something cannot be measured here."""


@dataclass(frozen=True)
class Sizes:
    """Sizes of what is measured; the defaults are those of a LERF scene."""

    n_gaussians: int = 1_000_000
    width: int = WIDTH
    height: int = HEIGHT
    large: tuple[int, int] = (1920, 1080)  # the other view
    n_atoms: tuple[int, ...] = (64, 128)  # L of the codebooks compared; the first is the paper's
    k: int = 4
    dim: int = 512
    regions: tuple[int, ...] = REGIONS  # in the view, at levels s, m, l
    channels: tuple[int, ...] = (64, 192, 512)  # that gsplat renders besides RGB; the last is D
    build_views: int = 200
    build_regions: tuple[int, ...] = (100, 100, 100)  # in each of them
    epochs: int = 4000  # of the paper's solver
    epochs_run: int = 4000  # the time of the others is extrapolated, and the row says so
    repeats: int = 15
    tests: str = ""  # of the parity suite, an expression of pytest's -k


FULL = Sizes()
# Of the tests those that run on a GPU, and of three draws of every scene the first.
_ON_A_GPU = "(on_a_gpu and not seed1 and not seed2) or a_gpu_finds or encode_does_not_care"
QUICK = Sizes(epochs_run=200, repeats=5, tests=_ON_A_GPU)
# For interpreted kernels: proves that every stage runs, and nothing else.
TINY = Sizes(
    n_gaussians=20, width=8, height=8, large=(9, 8), n_atoms=(16,), k=2, dim=16, regions=(3, 2, 1),
    channels=(4, 16), build_views=1, build_regions=(2, 2, 2), epochs=6, epochs_run=3, repeats=1, tests="not on_a_gpu",
)  # fmt: skip


@dataclass(eq=False)
class Stage(Watch[str]):
    """One stage in its process."""

    device: torch.device  # "cuda", or "cpu" with interpreted kernels
    sizes: Sizes  # of everything
    deadline: float  # seconds since the epoch after which nothing is begun
    send: Callable[[dict[str, Any]], None]  # the result, to the runner, whenever there is more
    # "rows", and "about": on what they were measured
    result: dict[str, Any] = field(default_factory=lambda: {"rows": []})

    def __post_init__(self) -> None:
        self.clock = DeviceClock(self.device.type)
        self.no_gsplat = ""  # why gsplat is not used
        self._timed: dict[str, Row] = {}
        self._over: dict[str, list[str]] = {}

    def row(self, name: str, run: Callable[[], Row]) -> Row:
        """Return a row with what ``run`` returns, or with the reason why that failed."""
        row: Row = {"name": name}
        self.result["rows"].append(row)
        try:
            self.begin()
            row.update(run())
        except Exception as error:
            self._give_up(row, error)
        self.save()
        return row

    def once(self, name: str, run: Callable[[], object]) -> Row:
        """Return a row with seconds and memory of one run of something that takes long."""

        def measured() -> Row:
            self.clock.settle()
            started = time.perf_counter()
            memory = self.clock.peak_bytes(run)
            return {**Timing((time.perf_counter() - started,)).record(), **memory}

        return self.row(name, measured)

    def rows(self, runs: Runs, over: dict[str, list[str]] | None = None) -> None:
        """Add interleaved times and memory of everything; ``over`` as in ``add_ratios``."""
        self._over, self._timed = over or {}, {name: {"name": name} for name in runs}
        self.result["rows"] += self._timed.values()
        tasks: dict[str, Task] = {}
        for name, run in runs.items():
            try:
                self.begin()
                if self.clock.on_gpu:  # the first run compiles kernels
                    run()
                    self._timed[name].update(self.clock.peak_bytes(run))
                tasks[name] = Task(run, None, self.sizes.repeats)
            except Exception as error:
                self._give_up(self._timed[name], error)
        least = LEAST_SECONDS if self.clock.on_gpu else 0.0
        time_tasks(tasks, self.device.type, least_seconds=least, watch=self)
        for row in self._timed.values():
            if "median_s" not in row:
                row.setdefault("reason", NO_TIME)
        self.save()

    def may_run(self, key: str) -> bool:
        return not self.time_is_up()

    def failed(self, key: str, error: Exception) -> None:
        self._give_up(self._timed[key], error)

    def round_done(self, timings: dict[str, Timing]) -> None:
        for name, timing in timings.items():
            self._timed[name].update(timing.record())
        add_ratios(list(self._timed.values()), self._over)
        self.save()

    def begin(self) -> None:
        """Refuse to begin where no time is left."""
        if self.time_is_up():
            raise Unavailable(NO_TIME)

    def progress(self, what: str, done: int = 0, total: int = 0) -> None:
        """Stop what takes long where no time is left; a ``Progress``."""
        if self.time_is_up():
            raise Unavailable(f"{NO_TIME}, at {done} of {total} of: {what}")

    def time_is_up(self) -> bool:
        return time.time() > self.deadline

    def save(self) -> None:
        self.send(self.result)

    def recover(self) -> None:
        """Free memory. A kernel that has broken the device's context ends the process: only a new one can use it."""
        gc.collect()
        try:
            self.clock.settle()
            torch.cuda.empty_cache()
        except RuntimeError:
            os._exit(LOST)  # an orderly end would wait for the device

    def _give_up(self, row: Row, error: Exception) -> None:
        row["reason"] = reason(error)
        error.__traceback__ = None  # it would hold on to all tensors of the frames that it came through
        self.save()
        self.recover()

    def work(self, n_atoms: int, size: tuple[int, int] | None = None) -> Workload:
        """Return the first view of the room with everything the rasteriser takes, on the device: codes in
        float16, as a field has them; a query and four canonical phrases.
        """
        width, height = size or (self.sizes.width, self.sizes.height)
        labels, camera = (
            voronoi_labels(self.sizes.regions, width, height),
            random_scene_cameras(1, width, height)[0],
        )
        gaussians, k, dim = random_scene_gaussians(self.sizes.n_gaussians), self.sizes.k, self.sizes.dim
        work = make_workload("room", gaussians, camera, labels, n_atoms, k, dim, n_queries=5).to(self.device)
        return replace(work, weights=work.weights.half())


def project(gaussians: Gaussians, camera: Camera) -> raster.Projection:
    """Return what all stages project with."""
    return raster.project(gaussians, camera, PRESET, "triton")


def reason(error: BaseException) -> str:
    """Return an error in one line: of a long one, as compilers have them, the lines that speak of errors, or
    its beginning."""
    lines = str(error).splitlines()
    telling = [line for line in lines if "error:" in line.lower()]
    text = " ".join(" ".join(telling[:3] if len(lines) > 8 and telling else lines).split())
    text = text if len(text) <= 400 else text[:400] + " ..."
    return text if isinstance(error, Unavailable) else f"{type(error).__name__}: {text}"


def add_ratios(rows: Sequence[Row], over: dict[str, list[str]]) -> None:
    """Add to each row with a time its ratio to that of other rows: ``over`` maps what the other is called to the
    names of its rows, of which the fastest counts.
    """
    times = {row["name"]: row["median_s"] for row in rows if "median_s" in row}
    for called, names in over.items():
        found = [times[name] for name in names if name in times]
        for row in rows:
            if found and "median_s" in row and row["name"] not in names:
                row.setdefault("over", {})[called] = row["median_s"] / min(found)
