"""What each kernel of the rasteriser takes by itself, and how it was launched."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import torch

from benchmarks.gpu.timing import Clock

MODULES = (
    "scoup.raster.triton.rendering",
    "scoup.raster.triton.region_sums",
    "scoup.raster.triton.projection",
)
_SLEEP = 2_000_000  # cycles, about a millisecond: longer than a launch takes


@dataclass(eq=False)
class Launches:
    """Of one kernel.

    Attributes:
        seconds: of each launch.
        grids, constants: of each launch.
    """

    seconds: list[float] = field(default_factory=list)
    grids: list[tuple[int, ...]] = field(default_factory=list)
    constants: list[dict[str, Any]] = field(default_factory=list)


class _Timed:
    """A kernel that notes what each launch takes; launched like the kernel itself."""

    def __init__(self, kernel: Any, launches: Launches, clock: Clock) -> None:
        self._kernel, self._launches, self._clock = kernel, launches, clock

    def __getitem__(self, grid: tuple[int, ...]) -> Callable[..., None]:
        def launch(*arguments: Any, **constants: Any) -> None:
            self._launches.seconds.append(self._seconds(lambda: self._kernel[grid](*arguments, **constants)))
            self._launches.grids.append(grid)
            self._launches.constants.append(constants)

        return launch

    def _seconds(self, run: Callable[[], object]) -> float:
        self._clock.settle()
        if not self._clock.on_gpu:
            started = time.perf_counter()
            run()
            return time.perf_counter() - started
        first, last = (torch.cuda.Event(enable_timing=True) for _ in range(2))
        # The device is kept busy until the kernel is in its queue: the way there is not the kernel's time.
        torch.cuda._sleep(_SLEEP)
        first.record()
        run()
        last.record()
        self._clock.settle()
        return first.elapsed_time(last) / 1e3


@contextmanager
def timed_kernels(clock: Clock) -> Iterator[dict[str, Launches]]:
    """Inside, every launch of a kernel of the rasteriser is timed; by the kernel's name."""
    found: dict[str, Launches] = {}
    replaced: list[tuple[Any, str, Any]] = []
    try:
        for module in map(importlib.import_module, MODULES):
            for name in [name for name in vars(module) if name.endswith("_kernel")]:
                kernel = getattr(module, name)
                replaced.append((module, name, kernel))
                setattr(module, name, _Timed(kernel, found.setdefault(name, Launches()), clock))
        yield found
    finally:
        for module, name, kernel in replaced:
            setattr(module, name, kernel)
