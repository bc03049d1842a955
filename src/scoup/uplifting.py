"""Sparse code uplifting: from region codes in many views to one code a Gaussian (method.md, stage 2)."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from scoup import raster
from scoup.agreement import Agreement
from scoup.cameras import Camera, Cameras
from scoup.codes import SparseCodes, add_codes, index_dtype
from scoup.errors import InputError
from scoup.gaussians import Gaussians
from scoup.native import native_core
from scoup.progress import Progress, no_progress
from scoup.regions import Regions

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# The compiled vote keeps its best by insertion, which is for short lists; a sort serves longer ones.
MOST_VOTED_BY_INSERTION = 32
SORTED_AT_A_TIME = 1 << 18  # Gaussians, by the vote where the compiled core does not do it


@dataclass(frozen=True, eq=False)
class ViewSums:
    """Region sums of one view: A[i, r] = sum of blending weights of Gaussian i over the pixels of region r.

    Attributes:
        view_name: the camera's name.
        gaussian: [T] int64.
        key: [T] int64 = level * stride + region of this view.
        weight: [T] float32, positive.
        stride: see ``key``.
        labels_digest: SHA-256 of the label maps, to tell whether they are the same later.
    """

    view_name: str
    gaussian: Tensor  # [T]
    key: Tensor  # [T]
    weight: Tensor  # [T]
    stride: int
    labels_digest: str = ""

    def level(self, level: int) -> tuple[Tensor, Tensor, Tensor]:
        """(gaussian, region, weight) of one level."""
        chosen = torch.div(self.key, max(1, self.stride), rounding_mode="floor") == level
        return self.gaussian[chosen], self.key[chosen] - level * self.stride, self.weight[chosen]


def iterate_region_sums(
    gaussians: Gaussians | raster.PreparedScene,
    cameras: Sequence[Camera],
    regions: Regions,
    raster_preset: str = "inria",
    backend: str | None = None,
) -> Iterator[ViewSums]:
    """Region sums view by view; only one view is in memory at a time.

    Args:
        gaussians: the scene; where it is prepared, the sums are of its Gaussians in their new places.
        cameras: views to visit, in this order; each must have regions.
        regions: the region maps; they are brought to the size of the camera.
        raster_preset, backend: see ``raster.look``.
    """
    device = (gaussians.gaussians if isinstance(gaussians, raster.PreparedScene) else gaussians).device
    for camera in cameras:
        labels, _ = regions.load_view(camera.name, camera.width, camera.height)
        view = raster.look(gaussians, camera, raster_preset, backend)
        gaussian, key, weight = raster.region_weights(view, labels.to(device))
        # Those of all views together may be too large for a GPU.
        stride = int(labels.max()) + 1
        parts = (gaussian.cpu(), key.cpu(), weight.cpu())
        yield ViewSums(camera.name, *parts, stride, digest_of_labels(labels))


def digest_of_labels(labels: Tensor) -> str:
    """SHA-256 of label maps [S, H, W]."""
    digest = hashlib.sha256(str(list(labels.shape)).encode())
    digest.update(labels.int().cpu().contiguous().numpy().tobytes())
    return digest.hexdigest()


class RegionSums:
    """The region sums of all views, kept: all that anything after rasterising needs.

    With them other codes, codebook sizes or embeddings can be lifted without rasterising again. They take about
    20 bytes for each pair of a Gaussian and a region it paints; ``build`` streams instead.

    Attributes:
        n_gaussians: N.
        levels: level names.
        views: one ViewSums a view.
        rows: per level, the rows of each view in the stacked embeddings (``Regions.embeddings``).
        raster_preset: the rasteriser constants they were made with.
    """

    def __init__(
        self,
        n_gaussians: int,
        levels: Sequence[str],
        views: Sequence[ViewSums],
        rows: Sequence[dict[str, slice]],
        raster_preset: str = "inria",
    ) -> None:
        self.n_gaussians = n_gaussians
        self.levels = tuple(levels)
        self.views = tuple(views)
        self.rows = tuple(rows)
        self.raster_preset = raster_preset

    def matrix(self, level: int) -> csr_array:
        """A [N, R] of one level as a scipy CSR matrix, float32; R counts the regions of all views.

        The triplets are placed view by view: 8 bytes a non-zero in all, where a matrix made from all triplets at once
        would pass through some 40. Columns are in order where the rows of the views are.
        """
        from scipy.sparse import csr_array

        places = self.rows[level]
        total = max((rows.stop for rows in places.values()), default=0)
        ends = np.zeros(self.n_gaussians + 1, np.int64)
        for view in self.views:
            ends[1:] += np.bincount(view.level(level)[0].cpu().numpy(), minlength=self.n_gaussians)
        np.cumsum(ends, out=ends)
        columns = np.empty(ends[-1], np.int32)
        weights = np.empty(ends[-1], np.float32)
        free = ends[:-1].copy()  # the next place of each Gaussian
        for view in self.views:
            gaussian, region, weight = (part.cpu().numpy() for part in view.level(level))
            order = np.argsort(gaussian.astype(np.int64) * max(1, view.stride) + region, kind="stable")
            gaussian = gaussian[order]
            # Where a Gaussian paints several regions of the view, they follow each other.
            first = np.flatnonzero(np.diff(gaussian, prepend=-1))
            repeats = np.diff(first, append=len(gaussian))
            at = free[gaussian] + np.arange(len(gaussian)) - np.repeat(first, repeats)
            columns[at] = region[order] + places[view.view_name].start
            weights[at] = weight[order]
            free[gaussian[first]] += repeats
        return csr_array((weights, columns, ends), shape=(self.n_gaussians, total))


def region_sums(
    gaussians: Gaussians,
    cameras: Cameras,
    regions: Regions,
    raster_preset: str = "inria",
    backend: str | None = None,
    progress: Progress = no_progress,
) -> RegionSums:
    """Rasterise every view that has regions once and keep the sums; arguments as in ``iterate_region_sums``."""
    chosen = cameras_with_regions(cameras, regions)
    views = []
    progress("region sums", 0, len(chosen))
    for sums in iterate_region_sums(gaussians, chosen, regions, raster_preset, backend):
        views.append(sums)
        progress("region sums", len(views), len(chosen))
    rows = [regions.embeddings(level)[1] for level in regions.levels]
    return RegionSums(len(gaussians), regions.levels, views, rows, raster_preset)


def cameras_with_regions(cameras: Cameras, regions: Regions) -> list[Camera]:
    """The cameras that have region maps, in order.

    Raises:
        InputError: there is none.
    """
    chosen = [camera for camera in cameras if camera.name in regions]
    if not chosen:
        raise InputError(
            f"none of the {len(cameras)} cameras has regions; views with regions: "
            f"{', '.join(regions.view_names[:5]) or 'none'}; check that names agree"
        )
    return chosen


def codes_of_view(
    codes: Sequence[SparseCodes], rows: Sequence[dict[str, slice]], view_name: str
) -> list[SparseCodes]:
    """Per level, the codes of one view's regions: ``codes`` of all regions, ``rows`` of each view in them."""
    return [of_level.rows(places[view_name]) for of_level, places in zip(codes, rows, strict=True)]


def add_view(
    sums: ViewSums, codes: Sequence[SparseCodes], out: Tensor, agreement: Agreement | None = None
) -> None:
    """Add one view's weighted codes into accumulators ``out`` [N, S, L] float32; ``codes``: this view's regions."""
    weight = sums.weight
    if agreement is not None:
        weight = weight * agreement.factors(sums.gaussian, sums.key, sums.stride, list(codes))
    add_codes(sums.gaussian, sums.key, weight, sums.stride, list(codes), out)


def uplift(sums: RegionSums, codes: Sequence[SparseCodes], agreement: Agreement | None = None) -> Tensor:
    """Accumulators w_i = sum over regions of A[i, r] * W_r.

    Args:
        sums: from ``region_sums``.
        codes: per level, the codes of all regions in the order of ``Regions.embeddings``.
        agreement: outcome of an earlier round, with which the codes must agree to count in full.

    Returns:
        [N, S, L] float32.
    """
    out = torch.zeros(sums.n_gaussians, len(codes), codes[0].n_atoms, device=codes[0].weights.device)
    for view in sums.views:
        add_view(view, codes_of_view(codes, sums.rows, view.view_name), out, agreement)
    return out


def top_k(accumulators: Tensor, k: int | None) -> tuple[Tensor, Tensor]:
    """The vote: keep the k largest entries of each accumulator and scale them to sum 1.

    Args:
        accumulators: [N, S, L] float32.
        k: entries to keep; None keeps all.

    Returns:
        indices [N, S, K] uint8 (uint16 beyond 256 atoms) and weights [N, S, K] float32, zero where nothing painted.
    """
    if k is not None and k < 1:
        raise InputError(f"the vote keeps at least one atom, not {k}; None keeps all")
    accumulators = accumulators.detach()
    count, levels, n_atoms = accumulators.shape
    keep = n_atoms if k is None else k
    core = native_core() if accumulators.device.type == "cpu" else None
    if core is not None and keep <= min(n_atoms, MOST_VOTED_BY_INSERTION):
        rows = accumulators.float().contiguous().view(count * levels, n_atoms).numpy()
        parts = core.vote(rows, keep, torch.get_num_threads())
        indices, weights = (torch.from_numpy(part).view(count, levels, keep) for part in parts)
        return indices, weights
    indices = torch.zeros(count, levels, keep, dtype=index_dtype(n_atoms), device=accumulators.device)
    weights = torch.zeros(count, levels, keep, device=accumulators.device)
    for level in range(levels):
        for start in range(0, count, SORTED_AT_A_TIME):  # bounds the memory of the sort
            rows = slice(start, start + SORTED_AT_A_TIME)
            codes = SparseCodes.from_dense(accumulators[rows, level], keep)
            indices[rows, level], weights[rows, level] = codes.indices, codes.weights
    return indices, weights
