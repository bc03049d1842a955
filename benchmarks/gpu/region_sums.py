"""Region sums of one view and the vote on them, beside dense uplift through the peer's backward and the paper's
per-pixel scatter.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial

import torch
from torch import Tensor

from benchmarks.gpu.context import Context, project
from benchmarks.gpu.peers import dense_uplift
from benchmarks.gpu.rendering import RGB, at_hand
from benchmarks.gpu.timing import Work
from scoup import raster
from scoup.bench import Workload
from scoup.bench.stages import region_sums_of_a_view, vote_of_a_view
from scoup.synthetic.random_scene import clip_like

OURS = "ours: region sums of all levels"
DENSE = "dense uplift of all levels, D channels, by gsplat's backward"
DENSE_BY_PARTS = f"{DENSE}, 32 channels a call"
DENSE_NOTE = (
    "gsplat's backward also makes the gradients of positions, shapes and opacities: it has no other form"
)
SCATTER = "per-pixel scatter, level after level (the paper's)"
ENTRIES_AT_ONCE = 1 << 20


def vote_name(n_atoms: int) -> str:
    return f"ours: vote on the sums of one view, one round, L = {n_atoms}"


def region_sums(context: Context) -> None:
    """Each row of a view includes projection and sort, unless it says that the view is at hand. The vote has sums in
    the host's memory, and leaves codes there.
    """
    sizes = context.sizes
    context.result["about"] = (
        f"{sizes.n_gaussians:,} Gaussians, a view of {sizes.width} x {sizes.height}, three levels of "
        f"{'/'.join(map(str, sizes.regions))} regions, K = {sizes.k}"
    )
    works: list[Work] = []
    for n_atoms in reversed(sizes.n_atoms):  # the first comes last: what follows uses it
        works.append(Work(vote_name(n_atoms), vote_run(context.work(n_atoms))))
    work = context.work(sizes.n_atoms[0])
    works += [
        Work(OURS, partial(ours, work)),
        Work(f"{OURS}, view at hand", at_hand(work, ours)),
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


def ours(work: Workload, view: raster.Projection | None = None) -> object:
    return raster.region_sums(view or project(work.gaussians, work.camera), work.labels)


def vote_run(work: Workload) -> Callable[[], object]:
    """The vote; its sums are made when it is first run: that may fail, too."""
    sums = cache(lambda: region_sums_of_a_view(work, project(work.gaussians, work.camera)))
    return lambda: vote_of_a_view(work, sums(), "triton")


def empty_sums(work: Workload) -> Tensor:
    """[N, S, L] zeros, to add codes to."""
    shape = len(work.gaussians), len(work.codes), work.codes[0].n_atoms
    return torch.zeros(shape, device=work.labels.device)


def added_up(work: Workload, view: raster.Projection) -> Tensor:
    """[N, S, L] region sums of a view times the codes of the regions, by torch."""
    out = empty_sums(work)
    found = raster.region_sums(view, work.labels)
    for level, codes in enumerate(work.codes):
        dense = codes.to_dense()
        for gaussian, region, weight in zip(
            *(part.split(ENTRIES_AT_ONCE) for part in found.triplets(level)), strict=True
        ):
            out[:, level].index_add_(0, gaussian, weight[:, None] * dense[region])
    return out


def scatter(work: Workload) -> Tensor:
    """All levels with one look."""
    from scoup.baselines.scatter_kernel import scatter_view

    view, out = project(work.gaussians, work.camera), empty_sums(work)
    scatter_view(view, work.labels, work.codes, out)  # pyright: ignore[reportArgumentType]
    return out


def scatter_by_level(work: Workload) -> None:
    """As the paper does it: the levels know nothing of each other."""
    from scoup.baselines.scatter_kernel import scatter_view

    for level, codes in enumerate(work.codes):
        out = torch.zeros(len(work.gaussians), 1, codes.n_atoms, device=work.labels.device)
        view = project(work.gaussians, work.camera)
        scatter_view(view, work.labels[level : level + 1], [codes], out)  # pyright: ignore[reportArgumentType]


def dense_run(context: Context, work: Workload, channels: int) -> Callable[[], None]:
    """Dense uplift by so many channels a call; given its sums for as long as it runs: they are large."""
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
    one, other = added_up(work, project(work.gaussians, work.camera)), scatter(work)
    return float((one - other).abs().max() / other.max().clamp(min=1e-30))
