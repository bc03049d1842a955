"""Matching of the Gaussians of a splat before and after an edit, by their numbers alone."""

from __future__ import annotations

import math
from bisect import bisect_left
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from scoup.base.brief import brief
from scoup.base.errors import InputError
from scoup.scene.gaussians import Gaussians

NEAREST = 16  # Gaussians within the tolerance that are compared with a rounded one
_MIX = np.uint64(
    0x9E3779B97F4A7C15
)  # odd, without a pattern in its bits: multiplying by it spreads differences


@dataclass(frozen=True)
class Tolerance:
    """Largest differences between the numbers of one Gaussian before and after an edit, for formats that round."""

    distance: float
    """Of the means, in world units; also of each scale, if that is more than ``scale`` allows. Above 0."""
    scale: float = 0.1
    """Of each scale, as a share of the larger one."""
    opacity: float = 0.07
    """Of the opacities."""

    def __post_init__(self) -> None:
        for name in ("distance", "scale", "opacity"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0) or (name == "distance" and value == 0):
                raise InputError(
                    f"the tolerance of matching must be a positive distance in units of the scene, got "
                    f"{name} {value}"
                )


@dataclass(frozen=True, eq=False)
class Matching:
    """The row before an edit of each Gaussian after it."""

    n_before: int
    """Number of Gaussians before."""
    before: Tensor
    """[M] int64, row before of each Gaussian after, each at most once; -1 for an appended one."""
    exact: Tensor
    """[M] boolean, whether the numbers that decide blending weights are the same bytes."""

    __repr__ = brief

    def __len__(self) -> int:
        return len(self.before)

    @property
    def n_matched(self) -> int:
        return int((self.before >= 0).sum())

    @property
    def n_rounded(self) -> int:
        """Number of matched Gaussians whose numbers differ within the tolerance."""
        return self.n_matched - int(self.exact.sum())

    @property
    def n_appended(self) -> int:
        return len(self) - self.n_matched

    @property
    def n_deleted(self) -> int:
        return self.n_before - self.n_matched

    @property
    def is_identity(self) -> bool:
        """Return whether every row is what it was."""
        return (
            len(self) == self.n_before
            and bool(self.exact.all())
            and torch.equal(self.before, torch.arange(self.n_before))
        )

    def unmoved(self) -> Tensor:
        """Return boolean [M], the largest set of exact Gaussians that kept their order among each other.

        Gaussians of equal depth are blended in the order of rows, so a new order may change pictures.
        """
        rows = self.exact.nonzero()[:, 0]
        kept = torch.zeros(len(self), dtype=torch.bool)
        kept[rows[_longest_rising(self.before[rows])]] = True
        return kept

    def counts(self) -> dict[str, int]:
        """Return the numbers of matched, rounded (among the matched), appended and deleted Gaussians."""
        return {name: getattr(self, f"n_{name}") for name in ("matched", "rounded", "appended", "deleted")}


def match(before: Gaussians, after: Gaussians, tolerance: Tolerance | None = None) -> Matching:
    """Match the M Gaussians ``after`` an edit with the N ``before`` it, in any order.

    Gaussians with the same bytes of means, quats, scales and opacities match first, duplicates in their order. With a
    tolerance, two of the remaining match if each is the other's best choice among those within the tolerance, by the
    sum of differences in units of it; rotations do not count here. Colours never count. Rows that are not finite match
    by bytes only.
    """
    found = _same_bytes(_numbers(before).view(np.uint32), _numbers(after).view(np.uint32))
    exact = found >= 0
    if tolerance is not None and not exact.all():
        free = np.ones(len(before), bool)
        free[found[exact]] = False
        old = np.flatnonzero(free & before.finite().cpu().numpy())
        new = np.flatnonzero(~exact & after.finite().cpu().numpy())
        near = _within(_numbers(before)[old], _numbers(after)[new], tolerance)
        found[new[near >= 0]] = old[near[near >= 0]]
    return Matching(len(before), torch.from_numpy(found), torch.from_numpy(exact))


def _numbers(gaussians: Gaussians) -> NDArray[np.float32]:
    """Return [N, 11]: mean, quat, scales, opacity."""
    parts = gaussians.means, gaussians.quats, gaussians.scales, gaussians.opacities[:, None]
    return torch.cat(parts, 1).detach().cpu().contiguous().numpy()


def _same_bytes(before: NDArray[np.uint32], after: NDArray[np.uint32]) -> NDArray[np.int64]:
    """Return [M], the row of ``before`` [N, 11] with the bytes of each row of ``after`` [M, 11], each once, or -1."""
    _, group = np.unique(np.concatenate([_hashes(before), _hashes(after)]), return_inverse=True)
    old, new = group[: len(before)], group[len(before) :]
    # The n-th of a group before is the n-th of it after.
    stride = len(group) + 1
    old_keys, new_keys = (part * stride + _place_in_group(part) for part in (old, new))
    order = np.argsort(old_keys)
    at = np.searchsorted(old_keys, new_keys, sorter=order)
    row = np.append(order, 0)[at]  # any row past the last: the comparison fails, or finds equal bytes
    found = np.full(len(after), -1, np.int64)
    if len(before):
        same = (at < len(before)) & (old_keys[row] == new_keys) & (before[row] == after).all(1)
        found[same] = row[same]
    return found


def _hashes(rows: NDArray[np.uint32]) -> NDArray[np.uint64]:
    """Return [N], 64 bits per row [N, C]; the caller compares rows of equal hash."""
    found = np.zeros(len(rows), np.uint64)
    for column in rows.T:
        found = (found ^ column) * _MIX
        found ^= found >> np.uint64(29)
    return found


def _place_in_group(group: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return [N], how many of the same group come before each."""
    order = np.argsort(group, kind="stable")
    ordered = group[order]
    starts = np.searchsorted(ordered, ordered)
    place = np.empty(len(group), np.int64)
    place[order] = np.arange(len(group)) - starts
    return place


def _within(
    before: NDArray[np.float32], after: NDArray[np.float32], tolerance: Tolerance
) -> NDArray[np.int64]:
    """Return [M], the row of ``before`` matched within the tolerance to each of ``after``, each once, or -1."""
    found = np.full(len(after), -1, np.int64)
    if not len(before) or not len(after):
        return found
    new, old, cost = _candidates(before, after, tolerance)
    by_cost = np.lexsort((old, new, cost))  # equal costs by rows: the same result everywhere
    new, old = new[by_cost], old[by_cost]
    taken = np.zeros(len(before), bool)
    while len(new):
        first_of_new, first_of_old = (np.zeros(len(new), bool) for _ in range(2))
        first_of_new[np.unique(new, return_index=True)[1]] = True
        first_of_old[np.unique(old, return_index=True)[1]] = True
        both = first_of_new & first_of_old  # mutual best choices; the cheapest pair always is one
        found[new[both]] = old[both]
        taken[old[both]] = True
        left = (found[new] < 0) & ~taken[old]
        new, old = new[left], old[left]
    return found


def _candidates(
    before: NDArray[np.float32], after: NDArray[np.float32], tolerance: Tolerance
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Return pairs (row of ``after``, row of ``before``) within the tolerance, and the sums of their differences."""
    from scipy.spatial import KDTree

    count = min(NEAREST, len(before))
    distance, old = KDTree(before[:, :3].astype(np.float64)).query(
        after[:, :3].astype(np.float64), k=count, distance_upper_bound=tolerance.distance
    )
    distance, old = distance.reshape(len(after), count), old.reshape(len(after), count)
    new, place = np.nonzero(np.isfinite(distance))
    distance, old = distance[new, place], old[new, place].astype(np.int64)
    one, other = before[old].astype(np.float64), after[new].astype(np.float64)
    larger = np.maximum(np.abs(one[:, 7:10]), np.abs(other[:, 7:10]))
    allowed = np.maximum(larger * tolerance.scale, tolerance.distance)
    scales = (np.abs(one[:, 7:10] - other[:, 7:10]) / allowed).max(1)
    # Opacities above 1 count as 1 when rasterised.
    opacities = np.abs(one[:, 10].clip(max=1) - other[:, 10].clip(max=1))
    near = (scales <= 1) & (opacities <= tolerance.opacity)
    cost = distance / tolerance.distance + scales + opacities / max(tolerance.opacity, 1e-9)
    return new[near], old[near], cost[near]


def _longest_rising(rows: Tensor) -> Tensor:
    """Return the places of a longest increasing subsequence of distinct numbers [E]."""
    if len(rows) < 2 or bool((rows.diff() > 0).all()):
        return torch.arange(len(rows))
    smallest: list[int] = []  # smallest last number of a subsequence of each length
    at: list[int] = []  # its place
    earlier: list[int] = []  # place before each, in the longest subsequence that ends there
    for place, row in enumerate(rows.tolist()):
        length = bisect_left(smallest, row)
        earlier.append(at[length - 1] if length else -1)
        if length == len(smallest):
            smallest.append(row)
            at.append(place)
        else:
            smallest[length], at[length] = row, place
    places, place = [], at[-1]
    while place >= 0:
        places.append(place)
        place = earlier[place]
    return torch.tensor(places[::-1])
