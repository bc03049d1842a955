"""How close blending comes to what the arithmetic alone would take.

Only evaluations that paint count. A kernel that works on whole vectors of pixels also evaluates lanes that paint
nothing, and those count against it: the fraction is the share of evaluated lanes that paint, times how close the
kernel comes to its arithmetic.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import torch

from scoup.base.errors import InputError
from scoup.base.native import native_core
from scoup.raster import raster_preset, reference
from scoup.scene.cameras import Camera
from scoup.scene.gaussians import Gaussians

CYCLES, LANES = 11, 16
FORMULA = (
    "bound = E / 16 * 11 / (clock * threads): E pixel-Gaussian evaluations with alpha >= 1/255 before their pixel "
    "stops, 16 at a time in 11 cycles of fused multiply-adds; fraction = bound / measured time of `alpha`"
)


@dataclass(frozen=True)
class Clock:
    """Cycles a second of one core, and where the number comes from ("option", "native core", "cpuinfo")."""

    hz: float
    source: str


def count_evaluations(gaussians: Gaussians, camera: Camera) -> int:
    """E: pairs of a pixel and a Gaussian with alpha >= 1/255 before the pixel stops: those with a blending weight.

    Counted by the reference rasteriser, whatever backend is measured: it takes as long as one of its renders.
    """
    view = reference.project(gaussians, camera, raster_preset("inria"))
    bins = view.bins
    step = torch.arange(bins.tile, device=gaussians.device)
    count = 0
    for tile, _, weights in reference.tile_weights(view):
        row, column = divmod(tile, bins.across)
        inside = ((row * bins.tile + step < camera.height)[:, None]) & (
            column * bins.tile + step < camera.width
        )
        count += int((weights[:, inside.flatten()] > 0).sum())
    return count


def clock_hz(ghz: float | None = None) -> Clock | None:
    """The clock of a core: as given, else as the native core measures it, else as the system tells it, else None.

    A system, and more so a virtual machine, often tells the nominal clock and not the one the core runs at; give
    ``ghz`` where it is known.
    """
    if ghz is not None:
        if not ghz > 0:
            raise InputError(f"the clock must be positive, got {ghz} GHz")
        return Clock(ghz * 1e9, "option")
    core = native_core()
    measured = 0.0 if core is None else float(core.measure_clock_hz())
    if measured > 0:
        return Clock(measured, "native core")
    try:
        told = re.findall(r"^cpu MHz\s*:\s*([\d.]+)", Path("/proc/cpuinfo").read_text(), re.MULTILINE)
    except OSError:
        return None
    return Clock(max(map(float, told)) * 1e6, "cpuinfo") if told else None


def arithmetic_bound(evaluations: int, hz: float, threads: int) -> float:
    """Seconds the evaluations take at the bound; see ``FORMULA``."""
    return evaluations / LANES * CYCLES / (hz * threads)
