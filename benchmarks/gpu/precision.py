"""What the precision of the matrix products costs and changes, against plain float32 ("ieee")."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from benchmarks.gpu.context import PRESET, Context
from benchmarks.gpu.region_sums import added_up
from benchmarks.gpu.timing import Work, reason
from scoup import raster
from scoup.bench import Workload

if TYPE_CHECKING:
    from scoup.raster.triton.projection import Precision

EXACT = "ieee"
PRECISIONS = ("ieee", "fp16x3", "tf32x3", "tf32")
REFERENCE = "reference backend (torch)"


def precision(context: Context) -> None:
    """Times of each precision side by side, and in what their answers differ.

    The reference backend is the same in plain float32 with sums in another order: what differs between it and "ieee"
    is no matter of precision. It takes long, and looks at a smaller view.
    """
    from scoup.raster.triton import rendering as gpu

    sizes = context.sizes
    n_atoms = sizes.n_atoms[0]
    work = context.work(n_atoms)
    constants = raster.raster_preset(PRESET)
    context.result["about"] = (
        f"{sizes.n_gaussians:,} Gaussians, a view of {sizes.width} x {sizes.height}, three levels, L = {n_atoms}; the "
        "view is at hand"
    )
    works: list[Work] = []
    for name in PRECISIONS:
        view = cache(partial(gpu.project, work.gaussians, work.camera, constants, name))
        for what, run in runs_of(work, view).items():
            works.append(Work(f"{what}, {name}", run))
    context.rows(works)
    context.result["differences"] = found = []
    if context.about_to(f"answers of {EXACT}") is not None or context.time_is_up():
        return
    exact = answers(work, gpu.project(work.gaussians, work.camera, constants, EXACT))

    def compare(name: str, find: Callable[[], dict[str, float]]) -> None:
        left_out = context.about_to(f"answers of {name}")
        if left_out is not None or context.time_is_up():
            found.append({"name": name, "reason": left_out or "no time was left"})
            return
        try:
            found.append({"name": name, **find()})
        except Exception as error:
            found.append({"name": name, "reason": reason(error)})
            context.clock.recover()
        context.save(context.result)

    def of_precision(name: Precision, exact: dict[str, Tensor]) -> dict[str, float]:
        theirs = answers(work, gpu.project(work.gaussians, work.camera, constants, name))
        return differences(theirs, exact, sizes.k)

    def of_reference() -> dict[str, float]:
        size = (max(8, sizes.width // 4), max(8, sizes.height // 4))
        small = context.work(n_atoms, size=size)
        theirs = answers(small, raster.project(small.gaussians, small.camera, constants, "reference"))
        return differences(
            theirs, answers(small, gpu.project(small.gaussians, small.camera, constants, EXACT)), sizes.k
        )

    for name in PRECISIONS[1:]:
        compare(name, partial(of_precision, name, exact))
    del exact
    compare(REFERENCE, of_reference)


def runs_of(work: Workload, view: Callable[[], raster.Projection]) -> dict[str, Callable[[], object]]:
    n_atoms, codes = work.codebook.shape[1], (work.indices, work.weights)
    return {
        "coefficient maps": lambda: raster.render_codes(view(), *codes, n_atoms),
        "cosines": lambda: raster.render_cosines(view(), *codes, work.codebook, work.queries),
        "region sums": lambda: raster.region_sums(view(), work.labels),
    }


def answers(work: Workload, view: raster.Projection) -> dict[str, Tensor]:
    """Coefficient maps [S, H, W, L], cosines [S, Q, H, W] and one view's sums of codes [N, S, L], which torch adds up:
    region sums are all that precision changes.
    """
    n_atoms = work.codebook.shape[1]
    return {
        "coefficients": raster.render_codes(view, work.indices, work.weights, n_atoms),
        "cosines": raster.render_cosines(view, work.indices, work.weights, work.codebook, work.queries),
        "sums": added_up(work, view),
    }


def differences(theirs: dict[str, Tensor], exact: dict[str, Tensor], k: int) -> dict[str, float]:
    """Greatest differences; share of pixels, at any level, and of Gaussians painted whose k largest atoms are not the
    same in the same order.
    """
    off = {name: float((theirs[name] - exact[name]).abs().max()) for name in exact}
    scale = float(exact["sums"].max().clamp(min=1e-30))
    pixels = torch.stack(
        [changed(a, b, k) for a, b in zip(theirs["coefficients"], exact["coefficients"], strict=True)]
    )
    painted = (exact["sums"] > 0).any(2)
    votes = changed(theirs["sums"], exact["sums"], k)[painted]
    return {
        "coefficients_max": off["coefficients"],
        "cosines_max": off["cosines"],
        "sums_max_relative": off["sums"] / scale,
        "pixels_of_another_order": float(pixels.any(0).float().mean()),
        "votes_of_another_order": float(votes.float().mean()) if len(votes) else 0.0,
    }


def changed(one: Tensor, other: Tensor, k: int) -> Tensor:
    """[...] of [..., L]: whether the k largest entries that are not zero are others, or in another order."""
    k = min(k, one.shape[-1])
    tops = [part.sort(dim=-1, descending=True, stable=True) for part in (one, other)]
    atoms = [torch.where(top.values > 0, top.indices, -1)[..., :k] for top in tops]
    return (atoms[0] != atoms[1]).any(-1)
