"""Uplift of one view, beside dense uplift through the peer's backward and the paper's per-pixel scatter."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import torch
from torch import Tensor

from benchmarks.gpu.context import Context, look
from benchmarks.gpu.peers import dense_uplift
from benchmarks.gpu.rendering import RGB, at_hand
from benchmarks.gpu.timing import Work
from scoup import raster
from scoup.bench import Workload
from scoup.bench.room import clip_like

DENSE = "dense uplift of all levels, D channels, by gsplat's backward"
DENSE_BY_PARTS = f"{DENSE}, 32 channels a call"
DENSE_NOTE = (
    "gsplat's backward also makes the gradients of positions, shapes and opacities: it has no other form"
)
SCATTER = "per-pixel scatter, level after level (the paper's)"


def ours_name(n_atoms: int) -> str:
    return f"ours: uplift of all levels, L = {n_atoms}"


def uplift(context: Context) -> None:
    """Each row includes projection and sort, unless it says that the view is at hand."""
    sizes = context.sizes
    context.result["about"] = (
        f"{sizes.n_gaussians:,} Gaussians, a view of {sizes.width} x {sizes.height}, three levels of "
        f"{'/'.join(map(str, sizes.regions))} regions, K = {sizes.k}"
    )
    works: list[Work] = []
    for n_atoms in reversed(sizes.n_atoms):  # the first comes last: what follows uses it
        work = context.work(n_atoms, accumulators=True)
        works.append(Work(ours_name(n_atoms), partial(ours, work)))
    work = context.work(sizes.n_atoms[0], accumulators=True)
    works += [
        Work(f"{ours_name(sizes.n_atoms[0])}, view at hand", at_hand(work, ours)),
        Work(
            "ours: region sums as triplets, view at hand",
            at_hand(work, lambda work, view: raster.region_weights(view, work.labels)),
        ),
        Work(RGB, partial(peer_rgb, context, work)),
        Work(f"{RGB}, packed", partial(peer_rgb, context, work, packed=True)),
        Work("per-pixel scatter, all levels in one pass", partial(scatter, work)),
        Work(SCATTER, partial(scatter_by_level, work)),
        Work(DENSE, dense_run(context, work, context.sizes.dim), note=DENSE_NOTE),
        Work(DENSE_BY_PARTS, dense_run(context, work, 32)),
    ]
    context.rows(
        works, over={RGB: [RGB, f"{RGB}, packed"], SCATTER: [SCATTER], DENSE: [DENSE, DENSE_BY_PARTS]}
    )
    if context.about_to("agreement") is None and not context.time_is_up():
        context.result["agreement"] = {
            "ours against the scatter, greatest difference over the greatest number": disagreement(work)
        }
    context.save(context.result)


def ours(work: Workload, view: raster.View | None = None) -> None:
    view = view or look(work.gaussians, work.camera)
    raster.uplift_view(view, work.labels, work.codes, work.accumulators)


def scatter(work: Workload, out: Tensor | None = None) -> None:
    """All levels with one look."""
    from scoup.baselines.scatter_kernel import scatter_view

    view = look(work.gaussians, work.camera)
    scatter_view(view, work.labels, work.codes, work.accumulators if out is None else out)  # pyright: ignore[reportArgumentType]


def scatter_by_level(work: Workload) -> None:
    """As the paper does it: the levels know nothing of each other. Accumulators [N, L] lie level after level."""
    from scoup.baselines.scatter_kernel import scatter_view

    count, _, n_atoms = work.accumulators.shape
    flat = work.accumulators.view(-1)
    for level, codes in enumerate(work.codes):
        out = flat[level * count * n_atoms : (level + 1) * count * n_atoms].view(count, 1, n_atoms)
        view = look(work.gaussians, work.camera)
        scatter_view(view, work.labels[level : level + 1], [codes], out)  # pyright: ignore[reportArgumentType]


def dense_run(context: Context, work: Workload, channels: int) -> Callable[[], None]:
    """Dense uplift by so many channels a call; given its accumulators for as long as it runs: they are large."""
    embeddings = [clip_like(len(codes), context.sizes.dim).to(context.device) for codes in work.codes]

    def run() -> None:
        peer = context.gsplat()
        shape = len(work.labels), len(work.gaussians), context.sizes.dim
        dense_uplift(peer, work, embeddings, torch.zeros(shape, device=context.device), channels)

    return run


def peer_rgb(context: Context, work: Workload, packed: bool = False) -> object:
    peer = context.gsplat()
    with torch.no_grad():
        return peer.render(work.gaussians, work.camera, work.values, packed)


def disagreement(work: Workload) -> float:
    """Of the two ways to add a view up; the order of additions is not the same."""
    sums = [torch.zeros_like(work.accumulators) for _ in range(2)]
    view = look(work.gaussians, work.camera)
    raster.uplift_view(view, work.labels, work.codes, sums[0])
    scatter(work, sums[1])
    return float((sums[0] - sums[1]).abs().max() / sums[1].max().clamp(min=1e-30))
