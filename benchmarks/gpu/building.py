"""The whole build of a LERF-sized scene, beside the paper's procedure on the same device.

The paper's procedure: Adam over logits and codebook for 4000 epochs, level by level, then the per-pixel scatter, level
by level and view by view, then the K largest. Its solver is run in its plain form (autograd over D numbers a region)
and in ours (the same steps by Gram matrices), which is the stricter comparison.
"""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import Any

import torch
from torch import Tensor

import scoup
from benchmarks.gpu.context import PRESET, Context, look
from benchmarks.gpu.peers import plain_adam
from benchmarks.gpu.timing import Row, Unavailable, Work, measure_once
from scoup.bench import StageClock, room_cameras, room_regions
from scoup.cameras import Cameras
from scoup.codes import SparseCodes
from scoup.coding import fit_codes
from scoup.coding.adam import LEARNING_RATE
from scoup.coding.kmeans import spherical_kmeans
from scoup.gaussians import Gaussians
from scoup.pipeline import build_settings
from scoup.regions import Regions
from scoup.uplifting import top_k

PLAIN = "the paper's solver, plain (autograd)"
GRAM = "the paper's solver, by Gram matrices"
SCATTER = "per-pixel scatter of all views, level after level, and vote"
PAPER, STRICT = "the paper's procedure", "the paper's procedure, its solver by Gram matrices"


def ours_name(preset: str) -> str:
    return {
        "default": "ours: build, default settings (L = 128, exact, two rounds)",
        "paper": "ours: build, the paper's settings with exact codes (L = 64, one round)",
    }[preset]


def building(context: Context) -> None:
    """One run of each after a small one that compiles; inputs in memory, regions and label maps on the host."""
    sizes = context.sizes
    context.forget_rooms()
    gaussians = context.room(sizes.n_gaussians)
    cameras = room_cameras(sizes.build_views, sizes.width, sizes.height)
    regions = room_regions(cameras, sizes.build_regions, sizes.dim)
    context.result["about"] = (
        f"{sizes.n_gaussians:,} Gaussians, {sizes.build_views} views of {sizes.width} x {sizes.height}, "
        f"{'/'.join(map(str, sizes.build_regions))} regions a view, D = {sizes.dim}; one run each"
    )
    context.result["stages_s"] = {}
    for preset in ("paper", "default"):
        name = ours_name(preset)
        few = Cameras(list(cameras)[:1])
        stages: dict[str, float] = {}
        try:
            if sizes.warm_up:
                build(context, preset, gaussians, few, regions, {})
        except Exception as error:
            add(context, measure_once(Work(name, partial(fail, error)), context.clock))
            continue
        add(
            context,
            measure_once(
                Work(name, partial(build, context, preset, gaussians, cameras, regions, stages)),
                context.clock,
            ),
        )
        context.result["stages_s"][name] = stages
    paper(context, gaussians, cameras, regions)


def fail(error: Exception) -> None:
    raise error


def add(context: Context, row: Row) -> Row:
    context.result["rows"].append(row)
    context.save(context.result)
    return row


def build(
    context: Context,
    preset: str,
    gaussians: Gaussians,
    cameras: Cameras,
    regions: Regions,
    stages: dict[str, float],
) -> None:
    """``scoup.build``; ``stages`` gets seconds by stage, as the host sees them: the device may lag behind."""
    sizes = context.sizes
    n_atoms = sizes.n_atoms[0] if preset == "paper" else sizes.n_atoms[-1]
    settings = build_settings(preset, n_atoms=n_atoms, k=sizes.k, solver="exact")
    settings = dataclasses.replace(settings, raster_preset=PRESET)
    clock = StageClock()
    scoup.build(
        gaussians,
        cameras,
        regions,
        settings=settings,
        embedding_model="simulated",
        backend="triton",
        progress=clock,
    )
    context.clock.settle()
    stages.update({name: value for name, value in clock.stop().items() if value >= 1e-3})


def paper(context: Context, gaussians: Gaussians, cameras: Cameras, regions: Regions) -> None:
    """Rows for the parts of the paper's procedure, and their sums."""
    sizes = context.sizes
    n_atoms = sizes.n_atoms[0]
    levels = [regions.embeddings(level) for level in regions.levels]
    rows = [of_views.to(context.device) for of_views, _ in levels]
    solved: list[Tensor] = []
    epochs = sizes.epochs_run

    def plain(epochs: int) -> None:
        solved.clear()
        for of_level in rows:
            atoms = spherical_kmeans(of_level, n_atoms, 0)
            _, weights = plain_adam(of_level, atoms, sizes.k, epochs, LEARNING_RATE)
            solved.append(weights)

    def gram(epochs: int) -> None:
        for of_level in rows:
            fit_codes(of_level, n_atoms, sizes.k, solver="adam", epochs=epochs)

    times: dict[str, Row] = {}
    for name, solve in ((PLAIN, plain), (GRAM, gram)):
        if context.time_is_up():
            times[name] = add(context, {"name": name, "reason": "no time was left"})
            continue
        start = measure_once(Work(f"{name}: its start", partial(solve, min(2, epochs))), context.clock)
        row = add(context, measure_once(Work(name, partial(solve, epochs)), context.clock))
        if epochs < sizes.epochs and "median_s" in row and "median_s" in start:
            extrapolate(row, start["median_s"], epochs, sizes.epochs)
            context.save(context.result)
        times[name] = row

    codes = [SparseCodes.from_dense(weights, sizes.k) for weights in solved]
    lifting = Work(
        SCATTER, partial(scatter_all, gaussians, cameras, regions, codes, [r for _, r in levels], sizes.k)
    )
    if len(codes) != len(rows):
        lifting = Work(
            SCATTER, partial(fail, Unavailable("there are no codes: the paper's solver did not run"))
        )
    elif sizes.warm_up and not context.time_is_up():
        scatter_all(gaussians, Cameras(list(cameras)[:1]), regions, codes, [r for _, r in levels], sizes.k)
    times[SCATTER] = add(context, measure_once(lifting, context.clock))
    totals(context, times)


def extrapolate(row: Row, start_s: float, run: int, wanted: int) -> None:
    """Time of all epochs from that of some: what the start takes (k-means, two epochs) stays, the others scale."""
    spent = row["median_s"]
    each = max(0.0, spent - start_s) / max(1, run - 2)
    row.update(measured_s=spent, epochs_run=run, extrapolated=True)
    row["median_s"] = row["min_s"] = row["max_s"] = spent + each * (wanted - run)
    row["note"] = f"extrapolated: {run} of {wanted} epochs were run, in {spent:.3g} s"


def scatter_all(
    gaussians: Gaussians,
    cameras: Cameras,
    regions: Regions,
    codes: list[SparseCodes],
    places: list[dict[str, slice]],
    k: int,
) -> list[tuple[Tensor, Tensor]]:
    """The paper's uplift: per level, its accumulators [N, 1, L], every view looked at anew, then the k largest."""
    from scoup.baselines.scatter_kernel import scatter_view

    found = []
    for level, name in enumerate(regions.levels):
        out = torch.zeros(len(gaussians), 1, codes[level].n_atoms, device=gaussians.device)
        for camera in cameras:
            labels = regions.load(camera.name, name).labels.to(gaussians.device)
            view = look(gaussians, camera)
            own = codes[level].rows(places[level][camera.name])
            scatter_view(view, labels[None], [own], out)  # pyright: ignore[reportArgumentType]
        found.append(top_k(out, k))
    return found


def totals(context: Context, times: dict[str, Row]) -> None:
    """Sums of the paper's parts, and ours beside them."""
    for name, solver in ((PAPER, PLAIN), (STRICT, GRAM)):
        parts = [times[solver], times[SCATTER]]
        row: Row = {"name": name, "note": f"sum of: {solver}; {SCATTER}"}
        missing = [part["name"] for part in parts if "median_s" not in part]
        if missing:
            row["reason"] = f"not measured: {', '.join(missing)}"
        else:
            row["median_s"] = sum(part["median_s"] for part in parts)
            peaks: list[Any] = [part.get("peak_bytes") for part in parts]
            row["peak_bytes"] = None if None in peaks else max(peaks)
            row["extrapolated"] = any(part.get("extrapolated", False) for part in parts)
            for ours in context.result["rows"]:
                if ours["name"].startswith("ours") and "median_s" in ours:
                    ours.setdefault("over", {})[name] = ours["median_s"] / row["median_s"]
        add(context, row)
