"""Faults of region maps and embeddings, put in on purpose to compare how robust codings and votes are.

They act on region sums, where every fault changes rows or columns: nothing is rasterised again. A case joins faults by
name, such as "wrong20+noise60" (``perturbed``). The same seed gives the same faults.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from scoup.base.errors import UnknownNameError
from scoup.raster import ViewSums
from scoup.scene.regions import Regions
from scoup.uplift.region_sums import RegionSums

if TYPE_CHECKING:
    from scipy.sparse import csr_array

ISOTROPIC, ALONG_DIFFERENCES = 0.8, 0.6  # shares of the noise; their squares sum to 1


@dataclass(frozen=True, eq=False)
class LevelSums:
    """The inputs of coding, uplift and vote at one level."""

    # [N, R] float32 scipy CSR, A[i, r] = blending weight of Gaussian i in region r (``RegionSums.matrix``)
    matrix: csr_array
    embeddings: Tensor  # [R, D] float32, unit norm; a zero row means "unknown"
    views: np.ndarray  # [R] int64, the view each region lies in

    @property
    def n_gaussians(self) -> int:
        """N."""
        return len(self.matrix.indptr) - 1

    def kept(self, regions: np.ndarray) -> LevelSums:
        """Return the regions [R] boolean alone."""
        rows = np.flatnonzero(regions)
        return LevelSums(
            self.matrix.tocsc()[:, rows].tocsr(), self.embeddings[torch.from_numpy(rows)], self.views[rows]
        )


def level_sums(sums: RegionSums, regions: Regions) -> list[LevelSums]:
    """Return region sums and the embeddings they belong to, level by level."""
    levels = []
    for position, level in enumerate(sums.levels):
        rows, of_views = regions.embeddings(level)
        views = np.zeros(len(rows), np.int64)
        for number, part in enumerate(of_views.values()):
            views[part] = number
        levels.append(LevelSums(sums.matrix(position), torch.nn.functional.normalize(rows, dim=1), views))
    return levels


def as_region_sums(levels: Sequence[LevelSums]) -> RegionSums:
    """Return the inverse of ``level_sums``, as input to votes of several rounds. Regions must be sorted
    by view."""
    n_views = max(int(level.views.max(initial=-1)) for level in levels) + 1
    columns = [level.matrix.tocsc() for level in levels]
    starts = [np.searchsorted(level.views, np.arange(n_views + 1)) for level in levels]
    count = levels[0].n_gaussians
    sums = RegionSums("", torch.arange(count), [str(position) for position in range(len(levels))])
    for view in range(n_views):
        parts = []
        for position, (matrix, of_level) in enumerate(zip(columns, starts, strict=True)):
            first, last = of_level[view], of_level[view + 1]
            entries = slice(matrix.indptr[first], matrix.indptr[last])
            counts = np.diff(matrix.indptr[first : last + 1])
            region = np.repeat(np.arange(last - first), counts)
            of_entries = np.full(len(region), position)
            parts.append((matrix.indices[entries], of_entries, region, matrix.data[entries]))
        gaussian, level, region, weight = (
            torch.from_numpy(np.concatenate(each)) for each in zip(*parts, strict=True)
        )
        sums.append(str(view), ViewSums.of_triplets(gaussian, level, region, weight, len(levels)))
    sums.rows = [
        {str(view): slice(int(of_level[view]), int(of_level[view + 1])) for view in range(n_views)}
        for of_level in starts
    ]
    return sums


def wrong_embeddings(level: LevelSums, share: float, rng: np.random.Generator) -> LevelSums:
    """Return a ``share`` of the regions get the embedding of another region of the level, drawn at random."""
    count = len(level.embeddings)
    if count < 2:
        return level
    wrong = np.flatnonzero(rng.random(count) < share)
    others = (wrong + rng.integers(1, count, len(wrong))) % count
    embeddings = level.embeddings.clone()
    embeddings[torch.from_numpy(wrong)] = level.embeddings[torch.from_numpy(others)]
    return replace(level, embeddings=embeddings)


def diffuse_noise(level: LevelSums, length: float, rng: np.random.Generator) -> LevelSums:
    """Return noise of about ``length`` is added to every embedding, which is scaled to unit length again. The
    noise is partly isotropic, partly along the difference of two embeddings of the level, where it confuses one
    thing with another."""
    rows = level.embeddings
    count, dim = rows.shape
    isotropic = torch.from_numpy(rng.normal(size=(count, dim)) / np.sqrt(dim)).float()
    first, second = (torch.from_numpy(rng.integers(0, max(count, 1), count)) for _ in range(2))
    along = torch.nn.functional.normalize(rows[first] - rows[second], dim=1)
    noise = length * (ISOTROPIC * isotropic + ALONG_DIFFERENCES * along)
    # Unknown stays unknown.
    moved = torch.where(rows.any(1, keepdim=True), torch.nn.functional.normalize(rows + noise, dim=1), 0.0)
    return replace(level, embeddings=moved)


def missing_masks(level: LevelSums, share: float, rng: np.random.Generator) -> LevelSums:
    """Return a ``share`` of the regions are missing: their pixels have no region."""
    return level.kept(rng.random(len(level.embeddings)) >= share)


Fault = Callable[[LevelSums, float, np.random.Generator], LevelSums]
FAULTS: dict[str, Fault] = {"wrong": wrong_embeddings, "noise": diffuse_noise, "missing": missing_masks}
"""By name; the number after a name is in hundredths: "wrong20" is 20 % of the regions."""


def perturbed(levels: Sequence[LevelSums], case: str, seed: int = 0) -> list[LevelSums]:
    """Return the levels with the faults of a case.

    ``case``: "clean", or faults joined by "+" and applied from left to right: each of ``FAULTS`` with its
    number.
    """
    levels = list(levels)
    for part in case.split("+"):
        if part == "clean":
            continue
        found = re.fullmatch(r"([a-z]+)(\d+)", part)
        if not found or found[1] not in FAULTS:
            raise UnknownNameError("fault", part, ["clean", *(f"{name}20" for name in FAULTS)])
        draw = _draws(seed, found[1])
        levels = [FAULTS[found[1]](level, int(found[2]) / 100, draw) for level in levels]
    return levels


def _draws(seed: int, fault: str) -> np.random.Generator:
    return np.random.default_rng([seed, *fault.encode()])
