"""The stages of the method on one view, as callables of one backend."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import torch
from torch import Tensor

from scoup import raster
from scoup.base import InputError, ScoupError, serves
from scoup.raster import morton_order
from scoup.scene import Camera, Gaussians, SparseCodes
from scoup.uplift import GaussianCodes, RegionSums, vote
from scoup_lab.synthetic.random_scene import (
    HEIGHT,
    REGIONS,
    WIDTH,
    clip_like,
    random_scene_cameras,
    random_scene_codes,
    random_scene_gaussians,
    voronoi_labels,
)

STAGES = {
    "project": "project, bin and sort",
    "alpha": "render one channel of ones: blending and little else",
    "sums": "region sums, all levels",
    "colors": "render 3 channels",
    "codes": "render the coefficient maps, all levels",
    "cosines": "cosines with the queries, all levels, no coefficient map kept",
    "vote": "from region sums to codes of the Gaussians, one round",
}

_K, _D = 4, 512
Run: TypeAlias = Callable[[], Any]


@dataclass(frozen=True, eq=False)
class Workload:
    """One view of one scene and everything the stages take."""

    gaussians: Gaussians  # N Gaussians
    camera: Camera  # the view
    labels: Tensor  # [S, H, W] int32 regions
    codes: list[SparseCodes]  # S codes of those regions
    indices: Tensor  # [N, S, K] codes of the Gaussians
    weights: Tensor
    codebook: Tensor  # [S, L, D] float32
    queries: Tensor  # [Q, D] float32, unit norm
    values: Tensor  # [N, 3] float32, to render as channels

    def to(self, device: str | torch.device) -> Workload:
        """Return the same on another device."""
        names = ("labels", "indices", "weights", "codebook", "queries", "values")
        moved = {name: getattr(self, name).to(device) for name in names}
        codes = [
            SparseCodes(item.indices.to(device), item.weights.to(device), item.n_atoms) for item in self.codes
        ]
        return replace(self, gaussians=self.gaussians.to(device), codes=codes, **moved)


def random_workload(
    n_gaussians: int,
    width: int = WIDTH,
    height: int = HEIGHT,
    regions: Sequence[int] = REGIONS,
    n_atoms: int = 64,
    n_queries: int = 1,
) -> Workload:
    """Return the first view of the random scene of ``scoup_lab.synthetic.random_scene``, with so many regions at each
    level, random codes of four atoms, codebook and queries of 512 numbers."""
    labels = voronoi_labels(regions, width, height)
    (camera,) = random_scene_cameras(1, width, height)
    gaussians, levels = random_scene_gaussians(n_gaussians), len(labels)
    generator = torch.Generator().manual_seed(0)
    codes = [
        SparseCodes.from_dense(torch.rand(max(0, int(level.max())) + 1, n_atoms, generator=generator), _K)
        for level in labels
    ]
    return Workload(
        gaussians,
        camera,
        labels,
        codes,
        *random_scene_codes(gaussians.means, levels, n_atoms, _K),
        codebook=clip_like(levels * n_atoms, _D).view(levels, n_atoms, _D),
        queries=clip_like(n_queries, _D, 1),
        values=raster.view_colors(gaussians, camera),
    )


def stage_runs(work: Workload, backend: str, names: Iterable[str] = tuple(STAGES)) -> dict[str, Run]:
    """Return stages, in the order wanted, as callables without arguments; each gives what its function gives.

    The projection that the later stages share is made here, so that its cost is in ``project`` alone.
    """
    names = tuple(names)
    projection = raster.project(work.gaussians, work.camera, backend=backend)
    ones = torch.ones(len(work.gaussians), 1, device=work.gaussians.device)
    sums = region_sums_of_a_view(work, projection) if "vote" in names else None
    runs: dict[str, Run] = {
        "project": lambda: raster.project(work.gaussians, work.camera, backend=backend),
        "alpha": lambda: raster.render_channels(projection, ones),
        "sums": lambda: raster.region_sums(projection, work.labels),
        "colors": lambda: raster.render_channels(projection, work.values),
        "codes": lambda: raster.render_codes(projection, work.indices, work.weights, work.codebook.shape[1]),
        "cosines": lambda: raster.render_cosines(
            projection, work.indices, work.weights, work.codebook, work.queries
        ),
        "vote": lambda: vote_of_a_view(work, sums, backend),
    }
    for name in names:
        if name not in runs:
            raise InputError(f"there is no stage {name!r}; stages: {', '.join(runs)}")
    return {name: runs[name] for name in names}


def region_sums_of_a_view(work: Workload, projection: raster.Projection) -> RegionSums:
    """Return the sums of one view, ready for the vote."""
    levels = [str(level) for level in range(len(work.labels))]
    sums = RegionSums("", morton_order(work.gaussians.means), levels)
    sums.append("view", raster.region_sums(projection, work.labels))
    sums.rows = [{"view": slice(0, len(codes))} for codes in work.codes]
    return sums


def vote_of_a_view(work: Workload, sums: RegionSums | None, backend: str | None) -> GaussianCodes:
    """Vote for one round over one view; most of it is what does not depend on the number of views."""
    assert sums is not None
    return vote(sums, work.codes, work.codebook, 1, work.indices.shape[2], backend=backend)


def usable_backends(wanted: Sequence[str] = (), device: str = "cpu") -> tuple[list[str], dict[str, str]]:
    """Return the names of the backends, of those wanted or all that serve the device, that work on this machine, and
    why the others do not."""
    usable: list[str] = []
    reasons: dict[str, str] = {}
    all_here = [name for name in raster.BACKENDS if serves(name, torch.device(device))]
    for name in dict.fromkeys(wanted or all_here):
        try:
            if name in raster.BACKENDS:
                importlib.import_module(raster.BACKENDS[name])
            raster.project(
                random_scene_gaussians(8).to(device), random_scene_cameras(1, 16, 16)[0], backend=name
            )
        except (ScoupError, ImportError) as error:
            if isinstance(error, ScoupError) and wanted:
                raise
            if wanted:
                raise InputError(f"backend {name!r} does not work here: {error}") from error
            reasons[name] = " ".join(str(error).split())
        else:
            usable.append(name)
    return usable, reasons
