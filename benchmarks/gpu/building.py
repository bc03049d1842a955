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
from benchmarks.gpu.context import PRESET, Context, project
from benchmarks.gpu.peers import plain_adam
from benchmarks.gpu.timing import Row, Unavailable, Work
from scoup.bench import StageClock, random_scene_cameras, random_scene_regions
from scoup.coding import fit_codes
from scoup.coding.adam import LEARNING_RATE
from scoup.coding.kmeans import spherical_kmeans
from scoup.scene.cameras import Cameras
from scoup.scene.codes import SparseCodes
from scoup.scene.gaussians import Gaussians
from scoup.scene.regions import Regions
from scoup.uplift.build_settings import build_settings

WARM_UP_VIEWS = 4
ROWS_AT_ONCE = 1 << 16
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
    cameras = random_scene_cameras(sizes.build_views, sizes.width, sizes.height)
    regions = random_scene_regions(cameras, sizes.build_regions, sizes.dim)
    context.result["about"] = (
        f"{sizes.n_gaussians:,} Gaussians, {sizes.build_views} views of {sizes.width} x {sizes.height}, "
        f"{'/'.join(map(str, sizes.build_regions))} regions a view, D = {sizes.dim}; one run each"
    )
    context.result["stages_s"] = {}
    for preset in ("paper", "default"):
        name = ours_name(preset)
        few = Cameras(list(cameras)[:WARM_UP_VIEWS])
        stages: dict[str, float] = {}
        if sizes.warm_up:
            row = context.once(Work(name, partial(build, context, preset, gaussians, few, regions, {})))
            if "reason" in row:
                add(context, row)
                continue
        row = context.once(Work(name, partial(build, context, preset, gaussians, cameras, regions, stages)))
        context.result["stages_s"][name] = stages
        add(context, row)
    paper(context, gaussians, cameras, regions)


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
    clock = StageClock(context.heartbeat)
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
            context.heartbeat(PLAIN)
            atoms = spherical_kmeans(of_level, n_atoms, 0)
            _, weights = plain_adam(of_level, atoms, sizes.k, epochs, LEARNING_RATE)
            solved.append(weights)

    def gram(epochs: int) -> None:
        for of_level in rows:
            fit_codes(of_level, n_atoms, sizes.k, solver="adam", epochs=epochs, progress=context.heartbeat)

    times: dict[str, Row] = {}
    for name, solve in ((PLAIN, plain), (GRAM, gram)):
        start = context.once(Work(name, partial(solve, min(2, epochs))))
        if sizes.warm_up:  # that one has loaded torch's kernels
            start = context.once(Work(name, partial(solve, min(2, epochs))))
        row = add(context, context.once(Work(name, partial(solve, epochs))))
        if epochs < sizes.epochs and "median_s" in row and "median_s" in start:
            extrapolate(row, start["median_s"], epochs, sizes.epochs)
            context.save(context.result)
        times[name] = row

    codes = [SparseCodes.from_dense(weights, sizes.k) for weights in solved]

    def scatter(seen: Cameras) -> None:
        if len(codes) != len(rows):
            raise Unavailable("there are no codes: the paper's solver did not run")
        scatter_all(context, gaussians, seen, regions, codes, [places for _, places in levels])

    if sizes.warm_up:
        context.once(Work(SCATTER, partial(scatter, Cameras(list(cameras)[:1]))))
    times[SCATTER] = add(context, context.once(Work(SCATTER, partial(scatter, cameras))))
    totals(context, times)


def extrapolate(row: Row, start_s: float, run: int, wanted: int) -> None:
    """Time of all epochs from that of some: what the start takes (k-means, two epochs) stays, the others scale."""
    spent = row["median_s"]
    each = max(0.0, spent - start_s) / max(1, run - 2)
    row.update(measured_s=spent, epochs_run=run, extrapolated=True)
    row["median_s"] = row["min_s"] = row["max_s"] = spent + each * (wanted - run)
    row["note"] = f"extrapolated: {run} of {wanted} epochs were run, in {spent:.3g} s"


def scatter_all(
    context: Context,
    gaussians: Gaussians,
    cameras: Cameras,
    regions: Regions,
    codes: list[SparseCodes],
    places: list[dict[str, slice]],
) -> list[list[SparseCodes]]:
    """The paper's uplift: per level, its sums [N, 1, L], every view looked at anew, then the k largest."""
    from scoup.baselines.scatter_kernel import scatter_view

    found = []
    for level, name in enumerate(regions.levels):
        out = torch.zeros(len(gaussians), 1, codes[level].n_atoms, device=gaussians.device)
        for camera in cameras:
            context.heartbeat(SCATTER)
            labels = regions.load(camera.name, name).labels.to(gaussians.device)
            view = project(gaussians, camera)
            own = codes[level].rows(places[level][camera.name])
            scatter_view(view, labels[None], [own], out)  # pyright: ignore[reportArgumentType]
        found.append(
            [SparseCodes.from_dense(rows, context.sizes.k) for rows in out[:, 0].split(ROWS_AT_ONCE)]
        )
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
