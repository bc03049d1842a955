"""The compact form of a view's region sums: seven bytes an entry, by buckets of Gaussians."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scoup.base.errors import InputError

BUCKET = 256  # Gaussians whose entries lie together; a place among them is one byte
MOST_COMBINATIONS = 1 << 16  # of one part of a view; what has more is kept in several parts


@dataclass(frozen=True, eq=False)
class Entries:
    """Region sums of one view, or of some of its combinations, by buckets of ``BUCKET`` Gaussians.

    Attributes:
        buckets: [B] uint32, those that have entries, rising.
        starts: [B + 1] uint32, where the entries of each of them begin.
        places: [E] uint8, the Gaussian in its bucket, rising.
        combinations: [E] uint16.
        weights: [E] float32 or float16.
        table: [C, S] int32 regions of this view, -1 for none.
    """

    buckets: NDArray[np.uint32]
    starts: NDArray[np.uint32]
    places: NDArray[np.uint8]
    combinations: NDArray[np.uint16]
    weights: NDArray[np.floating]
    table: NDArray[np.int32]

    def arrays(self) -> dict[str, NDArray[Any]]:
        return dict(vars(self))

    def check(self, n_levels: int, weight_type: np.dtype) -> None:
        """Refuse arrays that do not fit; their numbers are checked where they are used.

        Raises:
            ValueError: types or shapes are others.
        """
        types = (np.uint32, np.uint32, np.uint8, np.uint16, weight_type, np.int32)
        if [array.dtype for array in self.arrays().values()] != [np.dtype(kind) for kind in types]:
            raise ValueError("arrays of other types")
        if not (
            self.buckets.ndim == self.places.ndim == 1
            and self.starts.shape == (len(self.buckets) + 1,)
            and self.places.shape == self.combinations.shape == self.weights.shape
            and self.table.ndim == 2
            and self.table.shape[1] == n_levels
        ):
            raise ValueError("arrays of other shapes")

    def check_numbers(self, n_gaussians: int) -> None:
        """Refuse numbers that point outside; nothing is read by them, and no memory taken, before.

        Raises:
            InputError: there is no such Gaussian, or no such combination of regions.
        """
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
            raise InputError("the region sums are damaged: no such Gaussian or combination of regions")

    def gaussians(self) -> NDArray[np.int64]:
        """[E] places in the order of the sums."""
        counts = np.diff(self.starts.astype(np.int64))
        return np.repeat(self.buckets.astype(np.int64) * BUCKET, counts) + self.places

    def of_buckets(self, first: int, last: int) -> Entries:
        """A copy that holds the entries of buckets first to last - 1 only."""
        low, high = self.among(first, last)
        begin, end = int(self.starts[low]), int(self.starts[high])
        return Entries(
            self.buckets[low:high].copy(),
            self.starts[low : high + 1] - np.uint32(begin),
            self.places[begin:end].copy(),
            self.combinations[begin:end].copy(),
            self.weights[begin:end].copy(),
            self.table,
        )

    def among(self, first: int, last: int) -> tuple[int, int]:
        """Where in ``buckets`` those of first to last - 1 begin and end."""
        low, high = np.searchsorted(self.buckets, [first, last])
        return int(low), int(high)


@dataclass(frozen=True, eq=False)
class ViewRecord:
    """The region sums of one view.

    Attributes:
        camera_digest: of everything about the camera that decides the sums.
        labels_digest: of its label maps.
        parts: its entries; one part, but for views of very many combinations.
    """

    camera_digest: str
    labels_digest: str
    parts: tuple[Entries, ...]

    @classmethod
    def of_arrays(cls, header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> ViewRecord:
        """From the header and the arrays of a record.

        Raises:
            KeyError, ValueError: something is missing.
        """
        parts: list[Entries] = []
        while f"places.{len(parts)}" in arrays:
            number = len(parts)
            parts.append(
                Entries(**{name: arrays[f"{name}.{number}"] for name in Entries.__dataclass_fields__})
            )
        if not parts:
            raise ValueError(f"the view {header['name']!r} has no entries")
        return cls(str(header["camera"]), str(header["labels"]), tuple(parts))

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Those of all parts, by names that ``of_arrays`` knows."""
        return {
            f"{name}.{i}": array for i, part in enumerate(self.parts) for name, array in part.arrays().items()
        }


def pack(
    gaussians: NDArray[np.integer],  # [E] rising
    combinations: NDArray[np.integer],  # [E]
    weights: NDArray[np.float32],  # [E]
    table: NDArray[np.int32],  # [C, S]
    weight_type: np.dtype,
) -> list[Entries]:
    """Entries in parts of at most ``MOST_COMBINATIONS``; of a view without any combination, one empty part."""
    parts = []
    for first in range(0, max(1, len(table)), MOST_COMBINATIONS):
        mine: Any = slice(None)
        if len(table) > MOST_COMBINATIONS:
            mine = np.flatnonzero((combinations >= first) & (combinations < first + MOST_COMBINATIONS))
        own = gaussians[mine]
        bucket = own // BUCKET
        begins = np.flatnonzero(np.diff(bucket, prepend=-1))
        parts.append(
            Entries(
                bucket[begins].astype(np.uint32),
                np.append(begins, len(own)).astype(np.uint32),
                (own & (BUCKET - 1)).astype(np.uint8),
                (combinations[mine] - first).astype(np.uint16),
                weights[mine].astype(weight_type, copy=False),
                table[first : first + MOST_COMBINATIONS],
            )
        )
    return parts
