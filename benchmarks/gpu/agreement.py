"""Every kernel's answers beside the reference's, on a small view of the room: the first thing to know on a new device.

It needs neither pytest nor what the suite is made of, and compiles most of the kernels that are timed later. The suite
is stricter, and has harder scenes; the other precisions have a stage of their own.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import torch
from torch import Tensor

from benchmarks.gpu.context import PRESET, Context, project
from benchmarks.gpu.region_sums import added_up, scatter
from benchmarks.gpu.timing import reason
from scoup import raster
from scoup.bench import Workload
from scoup.bench.stages import region_sums_of_a_view
from scoup.synthetic.random_scene import clip_like
from scoup.uplift.vote import vote

CLOSE = 1e-4  # of the greatest number: what counts as the same
FLIPS = 2e-3  # share of the numbers that may differ: rounding decides who paints where alpha is near 1/255


def agreement(context: Context) -> None:
    """A row for each thing asked: its greatest difference, how many numbers differ, and whether that will do."""
    sizes = context.sizes
    context.result["about"] = (
        f"{sizes.check_gaussians:,} Gaussians, a view of {sizes.check_size[0]} x {sizes.check_size[1]}; the reference "
        "works on the CPU"
    )
    for n_atoms in sizes.n_atoms:
        work = context.work(n_atoms, sizes.check_gaussians, sizes.check_size)
        here = work.to("cpu")
        theirs = cache(lambda here=here: raster.project(here.gaussians, here.camera, PRESET, "reference"))
        for name, ask in questions(n_atoms == sizes.n_atoms[0]).items():
            compare(
                context,
                f"{name}, L = {n_atoms}",
                lambda ask=ask, work=work: ask(work, project(work.gaussians, work.camera)),
                lambda ask=ask, here=here, theirs=theirs: ask(here, theirs()),
            )
        compare(
            context,
            f"codes of regions: their cosines, L = {n_atoms}",
            lambda n_atoms=n_atoms: coded(context, n_atoms, by_kernel=True),
            lambda n_atoms=n_atoms: coded(context, n_atoms, by_kernel=False),
        )


def questions(all_of_them: bool) -> dict[str, Callable[[Workload, raster.Projection], Tensor]]:
    """By name, what is asked of a view; those that know nothing of the codebook's size only once."""
    found: dict[str, Callable[[Workload, raster.Projection], Tensor]] = {
        "coefficient maps": lambda work, view: raster.render_codes(
            view, work.indices, work.weights, work.codebook.shape[1]
        ),
        "cosines": lambda work, view: raster.render_cosines(
            view, work.indices, work.weights, work.codebook, work.queries
        ),
        "features": lambda work, view: raster.render_features(
            view, work.indices, work.weights, work.codebook
        ),
        "vote on the sums of a view": voted,
        "per-pixel scatter": scattered,
    }
    if all_of_them:
        found["RGB"] = lambda work, view: raster.render_channels(view, work.values)[0]
        found["region sums"] = summed
    return found


def voted(work: Workload, view: raster.Projection) -> Tensor:
    """[N, S, L]: all atoms are kept, so that no near tie decides which."""
    sums = region_sums_of_a_view(work, view)
    n_atoms = work.codebook.shape[1]
    found = vote(sums, work.codes, work.codebook, keep=None, backend=view.backend)
    out = torch.zeros(len(work.gaussians), len(work.codes), n_atoms)
    return out.scatter_add_(2, found.indices.long(), found.weights)


def scattered(work: Workload, view: raster.Projection) -> Tensor:
    """[N, S, L] region sums times the codes of the regions, by the baseline's kernel where there is one."""
    return scatter(work) if view.backend == "triton" else added_up(work, view)


def summed(work: Workload, view: raster.Projection) -> Tensor:
    """[N, C] region sums."""
    found = raster.region_sums(view, work.labels)
    out = torch.zeros(len(work.gaussians), len(found.table), device=found.weight.device)
    return out.index_put_((found.gaussian.long(), found.combination.long()), found.weight)


def coded(context: Context, n_atoms: int, by_kernel: bool) -> Tensor:
    """[R] cosines of regions and their codes over a given codebook."""
    from scoup.coding import reference
    from scoup.coding.triton import coder

    sizes = context.sizes
    rows, atoms = clip_like(8 * n_atoms, sizes.dim, 3), clip_like(n_atoms, sizes.dim, 4)
    if not by_kernel:
        return reference.code_rows(rows, atoms, sizes.k, 1).cosines
    return coder.code_rows(rows.to(context.device), atoms.to(context.device), sizes.k, 1).cosines


def compare(context: Context, name: str, ours: Callable[[], Tensor], theirs: Callable[[], Tensor]) -> None:
    """Into the rows: "agrees", or a reason why that is not known."""
    row: dict[str, Any] = {"name": name}
    context.result["rows"].append(row)
    left_out = context.about_to(name)
    if left_out is not None or context.time_is_up():
        row["reason"] = left_out or "no time was left"
    else:
        try:
            row.update(difference(ours().cpu(), theirs().cpu()))
        except Exception as error:
            row["reason"] = reason(error)
            context.save(context.result)
            context.clock.recover()
    context.save(context.result)


def difference(found: Tensor, expected: Tensor) -> dict[str, Any]:
    """Relative to the greatest number; numbers that are not finite differ."""
    scale = float(expected.abs().max().clamp(min=1e-30))
    off = ((found - expected).abs() / scale).nan_to_num(nan=float("inf"))
    beyond = float((off > CLOSE).float().mean())
    return {"difference": float(off.max()), "beyond": beyond, "agrees": beyond <= FLIPS}
