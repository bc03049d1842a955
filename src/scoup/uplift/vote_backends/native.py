"""The vote by the compiled core: threads over buckets of Gaussians."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from scoup.base import required_core
from scoup.scene import index_dtype
from scoup.uplift.reweighting import EarlierRound
from scoup.uplift.storage.entries import BUCKET
from scoup.uplift.voting import BATCHES, PreparedVote


class Vote(PreparedVote):
    """See ``reference.Vote``."""

    batches = BATCHES

    def __post_init__(self) -> None:
        arrays = []
        for view in self.views:
            sums = view.entries
            arrays.append(
                (sums.buckets, sums.starts, sums.places, sums.combinations, sums.weights, view.regions)
            )
        tables = [tuple(_array(tensor) for tensor in (level.indices, level.weights)) for level in self.codes]
        with required_core() as core:
            self._vote = core.Vote(self.n_gaussians, _array(self.grams), arrays, tables)

    def round(
        self, keep: int, earlier: EarlierRound | None, unit_norm: bool, buckets: range
    ) -> tuple[Tensor, Tensor]:
        first, last = buckets.start * BUCKET, min(buckets.stop * BUCKET, self.n_gaussians)
        shape = max(0, last - first), len(self.codes), keep
        indices = torch.empty(shape, dtype=index_dtype(self.codes[0].n_atoms))
        weights = torch.empty(shape)
        if not buckets:  # a process may have no views
            return indices, weights
        known = None if earlier is None else _arrays(earlier)
        threads = torch.get_num_threads()
        with required_core():
            self._vote.round(
                indices.numpy(), weights.numpy(), known, unit_norm, buckets.start, buckets.stop, threads
            )
        return indices, weights

    def deviations(self, earlier: EarlierRound, buckets: range) -> list[Tensor]:
        threads = torch.get_num_threads()
        with required_core():
            deviations = self._vote.deviations(_arrays(earlier), buckets.start, buckets.stop, threads)
        return [torch.from_numpy(of_level) for of_level in deviations]


def _arrays(earlier: EarlierRound) -> tuple[np.ndarray, ...]:
    return tuple(_array(tensor) for tensor in (earlier.indices, earlier.weights, earlier.sharpness))


def _array(tensor: Tensor) -> np.ndarray:
    return tensor.detach().cpu().contiguous().numpy()
