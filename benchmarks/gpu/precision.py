"""Cost and effect of the precision of the matrix products, against plain float32 ("ieee")."""

from __future__ import annotations

from functools import cache, partial

import torch
from torch import Tensor

from benchmarks.gpu.stage import PRESET, Row, Runs, Stage
from scoup import raster
from scoup_lab.bench import Workload

EXACT = "ieee"
OTHERS = ("fp16x3", "tf32x3", "tf32")
KEYS = ("coefficients_max", "cosines_max", "sums_max_relative", "pixels_of_another_order")


def answers_name(precision: str) -> str:
    return f"answers: {precision} against {EXACT}"


def precision(stage: Stage) -> None:
    """Add times of each precision side by side, and the differences of their answers.

    The reference backend is plain float32 with sums in another order: what differs between it and "ieee" is not a
    matter of precision. It takes long, and renders a smaller view.
    """
    sizes = stage.sizes
    n_atoms = sizes.n_atoms[0]
    stage.result["about"] = (
        f"{sizes.n_gaussians:,} Gaussians, a view of {sizes.width} x {sizes.height}, three levels, L = {n_atoms}; "
        "projected before"
    )
    work = stage.work(n_atoms)
    runs: Runs = {}
    for name in (EXACT, *OTHERS):
        runs |= {f"{what}, {name}": run for what, run in runs_of(work, name).items()}
    stage.rows(runs)
    exact = cache(lambda: answers(work, EXACT))
    for name in OTHERS:
        stage.row(answers_name(name), lambda name=name: differences(answers(work, name), exact(), sizes.k))
    exact.cache_clear()

    def of_reference() -> Row:
        small = stage.work(n_atoms, (max(8, sizes.width // 4), max(8, sizes.height // 4)))
        return differences(answers(small, "reference"), answers(small, EXACT), sizes.k)

    stage.row(answers_name("reference backend"), of_reference)


def project_with(work: Workload, name: str) -> raster.Projection:
    """Project by the kernels in that precision, or by the reference backend."""
    from scoup.raster.triton import rendering as gpu

    if name == "reference":
        return raster.project(work.gaussians, work.camera, PRESET, "reference")
    constants = raster.raster_preset(PRESET)
    return gpu.project(work.gaussians, work.camera, constants, name)  # pyright: ignore[reportArgumentType]


def runs_of(work: Workload, name: str) -> Runs:
    n_atoms, codes = work.codebook.shape[1], (work.indices, work.weights)
    projection = cache(partial(project_with, work, name))
    return {
        "coefficient maps": lambda: raster.render_codes(projection(), *codes, n_atoms),
        "cosines": lambda: raster.render_cosines(projection(), *codes, work.codebook, work.queries),
        "region sums": lambda: raster.region_sums(projection(), work.labels),
    }


def answers(work: Workload, name: str) -> tuple[Tensor, Tensor, Tensor]:
    """Return coefficient maps [S, H, W, L], cosines [S, Q, H, W] and region sums [N, C]."""
    maps, cosines, found = (run() for run in runs_of(work, name).values())
    assert isinstance(maps, Tensor)
    assert isinstance(cosines, Tensor)
    assert isinstance(found, raster.ViewSums)
    sums = torch.zeros(len(work.gaussians), len(found.table), device=maps.device)
    return maps, cosines, sums.index_put_((found.gaussian.long(), found.combination.long()), found.weight)


def differences(theirs: tuple[Tensor, Tensor, Tensor], exact: tuple[Tensor, Tensor, Tensor], k: int) -> Row:
    """Return the greatest differences, and the share of pixels whose k largest atoms, at any level, are not the
    same in order."""
    off = [float((one - other).abs().max()) for one, other in zip(theirs, exact, strict=True)]
    off[2] /= float(exact[2].max().clamp(min=1e-30))
    tops = [maps.sort(dim=-1, descending=True, stable=True) for maps in (theirs[0], exact[0])]
    atoms = [torch.where(top.values > 0, top.indices, -1)[..., :k] for top in tops]
    changed = (atoms[0] != atoms[1]).any(-1).any(0)
    return dict(zip(KEYS, (*off, float(changed.float().mean())), strict=True))
