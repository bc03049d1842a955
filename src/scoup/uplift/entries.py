"""The compact form of a view's region sums: seven bytes an entry, by buckets of Gaussians."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

BUCKET = 256  # Gaussians whose entries lie together; a place among them is one byte
MOST_COMBINATIONS = 1 << 16  # of one part of a view; what has more is kept in several parts


@dataclass(frozen=True, eq=False)
class Entries:
    """Region sums of one view, or of some of its combinations, by buckets of ``BUCKET`` Gaussians.

    Attributes:
        starts: [B + 1] uint32, where the entries of each bucket begin.
        places: [E] uint8, the Gaussian in its bucket, rising.
        combinations: [E] uint16.
        weights: [E] float32 or float16.
        table: [C, S] int32 regions of this view, -1 for none.
    """

    starts: NDArray[np.uint32]
    places: NDArray[np.uint8]
    combinations: NDArray[np.uint16]
    weights: NDArray[np.floating]
    table: NDArray[np.int32]

    def arrays(self) -> dict[str, NDArray[Any]]:
        return dict(vars(self))

    def gaussians(self) -> NDArray[np.int64]:
        """[E] places in the order of the sums."""
        counts = np.diff(self.starts.astype(np.int64))
        return np.repeat(np.arange(len(counts)) * BUCKET, counts) + self.places

    def of_buckets(self, first: int, last: int) -> Entries:
        """A copy that holds the entries of buckets first to last - 1 only."""
        begin, end = int(self.starts[first]), int(self.starts[last])
        starts = (self.starts.clip(begin, end) - np.uint32(begin)).astype(np.uint32)
        places, combinations = self.places[begin:end].copy(), self.combinations[begin:end].copy()
        return Entries(starts, places, combinations, self.weights[begin:end].copy(), self.table)


@dataclass(frozen=True, eq=False)
class TakenView:
    """A view whose sums are kept.

    Attributes:
        camera_digest: of everything about the camera that decides the sums.
        labels_digest: of its label maps.
        parts: its entries; one part, but for views of very many combinations.
    """

    camera_digest: str
    labels_digest: str
    parts: tuple[Entries, ...]


def pack(
    gaussians: NDArray[np.integer],  # [E] rising
    combinations: NDArray[np.integer],  # [E]
    weights: NDArray[np.float32],  # [E]
    table: NDArray[np.int32],  # [C, S]
    n_buckets: int,
    weight_type: np.dtype,
) -> list[Entries]:
    """Entries in parts of at most ``MOST_COMBINATIONS``; of a view without any combination, one empty part."""
    parts = []
    for first in range(0, max(1, len(table)), MOST_COMBINATIONS):
        mine: Any = slice(None)
        if len(table) > MOST_COMBINATIONS:
            mine = np.flatnonzero((combinations >= first) & (combinations < first + MOST_COMBINATIONS))
        edges = np.arange(n_buckets + 1, dtype=gaussians.dtype) * BUCKET
        parts.append(
            Entries(
                np.searchsorted(gaussians[mine], edges).astype(np.uint32),
                (gaussians[mine] & (BUCKET - 1)).astype(np.uint8),
                (combinations[mine] - first).astype(np.uint16),
                weights[mine].astype(weight_type, copy=False),
                table[first : first + MOST_COMBINATIONS],
            )
        )
    return parts
