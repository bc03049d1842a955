"""The compact form of a view's region sums: seven bytes per entry, by buckets of Gaussians."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from scoup.base import InputError
from scoup.raster import ViewSums

BUCKET_BITS = 8
BUCKET = 1 << BUCKET_BITS  # Gaussians whose entries lie together; a place in a bucket takes one byte
MOST_COMBINATIONS = 1 << 16  # per part of a view; views with more have several parts


@dataclass(frozen=True, eq=False)
class Entries:
    """Region sums of one view, or of some of its label tuples, by buckets of ``BUCKET`` Gaussians."""

    buckets: NDArray[np.uint32]  # [B] with entries, rising
    starts: NDArray[np.uint32]  # [B + 1] first entry of each bucket
    places: NDArray[np.uint8]  # [E] of the Gaussian in its bucket, rising
    combinations: NDArray[np.uint16]  # [E] rows of ``table``
    weights: NDArray[np.float32]  # [E]
    table: NDArray[np.int32]  # [C, S] label tuples: regions of this view, -1 for none

    def arrays(self) -> dict[str, NDArray[Any]]:
        return dict(vars(self))

    def check(self, n_levels: int) -> None:
        """Raise a ValueError for wrong types or shapes; numbers are checked where they are used."""
        types = (np.uint32, np.uint32, np.uint8, np.uint16, np.float32, np.int32)
        if [array.dtype for array in self.arrays().values()] != [np.dtype(kind) for kind in types]:
            raise ValueError("arrays of wrong types")
        if not (
            self.buckets.ndim == self.places.ndim == 1
            and self.starts.shape == (len(self.buckets) + 1,)
            and self.places.shape == self.combinations.shape == self.weights.shape
            and self.table.ndim == 2
            and self.table.shape[1] == n_levels
        ):
            raise ValueError("arrays of wrong shapes")

    def check_numbers(self, n_gaussians: int) -> None:
        """Raise an InputError for numbers that point outside; call it before any is used."""
        most = n_gaussians
        last = self.places[:0]
        if len(self.buckets):
            most -= BUCKET * int(self.buckets[-1])
            last = self.places[int(self.starts[-2]) :]
        if not (
            self.starts[0] == 0
            and self.starts[-1] == len(self.places)
            and bool((self.starts[1:] >= self.starts[:-1]).all())
            and bool((self.buckets[1:] > self.buckets[:-1]).all())
            and int(last.max(initial=0)) < max(most, 1)
            and (most > 0 or not len(self.buckets))
            and int(self.combinations.max(initial=0)) < max(len(self.table), 1)
            and (len(self.table) > 0 or not len(self.places))
        ):
            raise InputError("the region sums are damaged: an entry of a missing Gaussian or label tuple")

    def gaussians(self) -> NDArray[np.int64]:
        """Return [E] places in the order of the sums."""
        counts = np.diff(self.starts.astype(np.int64))
        return np.repeat(self.buckets.astype(np.int64) * BUCKET, counts) + self.places

    def select_buckets(self, first: int, last: int) -> Entries:
        """Return a copy with the entries of buckets first to last - 1."""
        low, high = self.find_buckets(first, last)
        begin, end = int(self.starts[low]), int(self.starts[high])
        return Entries(
            self.buckets[low:high].copy(),
            self.starts[low : high + 1] - np.uint32(begin),
            self.places[begin:end].copy(),
            self.combinations[begin:end].copy(),
            self.weights[begin:end].copy(),
            self.table,
        )

    def find_buckets(self, first: int, last: int) -> tuple[int, int]:
        """Return the range in ``buckets`` of first to last - 1."""
        low, high = np.searchsorted(self.buckets, [first, last])
        return int(low), int(high)


@dataclass(frozen=True, eq=False)
class ViewRecord:
    """The region sums of one view."""

    camera_digest: str  # of everything about the camera that decides the sums
    labels_digest: str  # of its label maps
    parts: tuple[Entries, ...]  # one, unless the view has more than ``MOST_COMBINATIONS``
    bytes: int = 0  # of its file, or in memory

    @property
    def digests(self) -> tuple[str, str]:
        return self.camera_digest, self.labels_digest

    @classmethod
    def from_arrays(
        cls, header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]], size: int
    ) -> ViewRecord:
        """Make a record of header and ``arrays``; a KeyError or ValueError if something is missing."""
        parts: list[Entries] = []
        while f"places.{len(parts)}" in arrays:
            number = len(parts)
            parts.append(
                Entries(**{name: arrays[f"{name}.{number}"] for name in Entries.__dataclass_fields__})
            )
        if not parts:
            raise ValueError(f"the view {header['name']!r} has no entries")
        return cls(str(header["camera"]), str(header["labels"]), tuple(parts), size)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the arrays of all parts, as ``from_arrays`` takes them."""
        return {
            f"{name}.{i}": array for i, item in enumerate(self.parts) for name, array in item.arrays().items()
        }


def pack(
    gaussians: NDArray[np.integer],  # [E] rising
    combinations: NDArray[np.integer],  # [E]
    weights: NDArray[np.float32],  # [E]
    table: NDArray[np.int32],  # [C, S]
) -> list[Entries]:
    """Pack entries in parts of at most ``MOST_COMBINATIONS``; a view without label tuples has one empty part."""
    parts = []
    for first in range(0, max(1, len(table)), MOST_COMBINATIONS):
        chosen: Any = slice(None)
        if len(table) > MOST_COMBINATIONS:
            chosen = np.flatnonzero((combinations >= first) & (combinations < first + MOST_COMBINATIONS))
        members = gaussians[chosen]
        bucket = members >> BUCKET_BITS
        begins = np.flatnonzero(bucket[1:] != bucket[:-1]) + 1
        if len(members):
            begins = np.insert(begins, 0, 0)
        parts.append(
            Entries(
                bucket[begins].astype(np.uint32),
                np.append(begins, len(members)).astype(np.uint32),
                members.astype(np.uint8),  # wraps around: what is left is counted from the bucket
                (combinations[chosen] - first).astype(np.uint16),
                weights[chosen].astype(np.float32, copy=False),
                table[first : first + MOST_COMBINATIONS],
            )
        )
    return parts


class Packer:
    """Packs views whose Gaussians are in any order; ``order`` as for ``RegionSums``."""

    def __init__(self, order: Tensor) -> None:
        self._order = order
        self._place_of: dict[torch.device, Tensor] = {}  # [N] int64, the place here of each row of the scene

    def entries(self, sums: ViewSums, order: Tensor | None) -> list[Entries]:
        """Return the entries of a view; arguments as for ``RegionSums.append``."""
        gaussian, combination, weight = sums.gaussian, sums.combination, sums.weight
        if order is None or not torch.equal(order.cpu(), self._order):
            device = gaussian.device
            if device not in self._place_of:
                self._place_of[device] = torch.argsort(self._order).to(device)
            row = gaussian.long() if order is None else order.to(device)[gaussian.long()]
            gaussian, by_place = torch.sort(self._place_of[device][row], stable=True)
            combination, weight = combination[by_place], weight[by_place]
        parts = [tensor.cpu().numpy() for tensor in (gaussian, combination, weight, sums.table)]
        return pack(parts[0], parts[1], parts[2], parts[3])
