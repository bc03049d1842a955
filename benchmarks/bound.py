"""How close blending comes to what the arithmetic alone would take.

Only evaluations that paint count. A kernel that works on whole vectors of pixels also evaluates lanes that paint
nothing, and those count against it: the fraction is the share of evaluated lanes that paint, times how close the
kernel comes to its arithmetic.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from scoup.base.errors import InputError
from scoup.base.native import native_core
from scoup.raster import raster_preset, reference
from scoup.scene.cameras import Camera
from scoup.scene.gaussians import Gaussians
from scoup_lab.bench import Row, markdown
from scoup_lab.bench.report import milliseconds

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
    projection = reference.project(gaussians, camera, raster_preset("inria"))
    bins = projection.bins
    step = torch.arange(bins.tile, device=gaussians.device)
    count = 0
    for tile, _, weights in reference.tile_weights(projection):
        row, column = divmod(tile, bins.across)
        inside = ((row * bins.tile + step < camera.height)[:, None]) & (
            column * bins.tile + step < camera.width
        )
        count += int((weights[:, inside.flatten()] > 0).sum())
    return count


def clock_hz(ghz: float | None = None) -> Clock | None:
    """The clock of a core: as given, else as the native core measures it, else as the system reports it, else None.

    A system, and more so a virtual machine, often reports the nominal clock and not the one the core runs at; give
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
        reported = re.findall(r"^cpu MHz\s*:\s*([\d.]+)", Path("/proc/cpuinfo").read_text(), re.MULTILINE)
    except OSError:
        return None
    return Clock(max(map(float, reported)) * 1e6, "cpuinfo") if reported else None


def arithmetic_bound(evaluations: int, hz: float, threads: int) -> float:
    """Seconds the evaluations take at the bound; see ``FORMULA``."""
    return evaluations / LANES * CYCLES / (hz * threads)


def bound_rows(
    rows: list[Row], evaluations: list[dict[str, Any]], clock_ghz: float | None
) -> list[dict[str, Any]]:
    """For every row of `alpha`: the bound and which part of the time it is."""
    clock = clock_hz(clock_ghz)
    if clock is None:
        return []
    counts = {(item["scene"], item["gaussians"]): item["evaluations"] for item in evaluations}
    found = []
    for row in rows:
        if row.stage != "alpha":
            continue
        count = counts[row.scene, row.n_gaussians]
        bound = arithmetic_bound(count, clock.hz, row.threads)
        found.append(
            {
                "scene": row.scene,
                "gaussians": row.n_gaussians,
                "backend": row.backend,
                "threads": row.threads,
                "evaluations": count,
                "clock_hz": clock.hz,
                "clock_from": clock.source,
                "bound_s": bound,
                "measured_s": row.timing.median,
                "fraction": bound / row.timing.median,
            }
        )
    return found


def print_bounds(bounds: list[dict[str, Any]]) -> None:
    """The second table."""
    if not bounds:
        print("\nno arithmetic bound: the clock is not known; give --clock-ghz")
        return
    first = bounds[0]
    print(f"\n{FORMULA}; clock {first['clock_hz'] / 1e9:.2f} GHz ({first['clock_from']})\n")
    headers = [
        "scene",
        "Gaussians",
        "backend",
        "threads",
        "evaluations",
        "bound, ms",
        "alpha, ms",
        "fraction",
    ]
    body = [
        [
            item["scene"],
            f"{item['gaussians']:,}",
            item["backend"],
            str(item["threads"]),
            f"{item['evaluations'] / 1e6:.1f} M",
            milliseconds(item["bound_s"]),
            milliseconds(item["measured_s"]),
            f"{item['fraction']:.3f}",
        ]
        for item in bounds
    ]
    print(markdown(headers, body, left=3))
