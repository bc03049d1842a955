"""The vote in plain torch: the specification that the faster backends are tested against."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import torch
from torch import Tensor

from scoup.base import InputError
from scoup.scene import SparseCodes, check_atoms, index_dtype, signed
from scoup.uplift import constants
from scoup.uplift.reweighting import EarlierRound
from scoup.uplift.storage.entries import BUCKET
from scoup.uplift.voting import BATCHES, CodedEntries, PreparedVote

BUCKETS_AT_A_TIME = 64


class Vote(PreparedVote):
    """The vote of the views for the Gaussians of a scene."""

    batches = BATCHES
    """Shares of the Gaussians that it is given one after another; after each, progress is reported and memory of files
    is released."""

    def __post_init__(self) -> None:
        for level in self.codes:
            check_atoms(level.indices, level.n_atoms)
        for view in self.views:
            self._check(view)
            check_regions(view.regions, self.codes)
        self.codes = [level.to(self.device) for level in self.codes]
        self.grams = self.grams.to(self.device)

    def round(
        self, keep: int, earlier: EarlierRound | None, unit_norm: bool, buckets: range
    ) -> tuple[Tensor, Tensor]:
        """Return the ``keep`` largest of w_i = sum over regions of A[i, r] W_r, for the Gaussians of some consecutive
        buckets.

        Regions count by A alone if there is no ``earlier`` round of all Gaussians. With ``unit_norm`` weights are
        scaled so that a decoded code has norm 1, instead of to sum 1.

        Returns:
            indices [n, S, keep] uint8 (uint16 beyond 256 atoms), weights [n, S, keep] float32.
        """
        results = []
        for some in self.chunks(buckets, keep):
            indices, weights = self.largest(earlier, some, keep)
            results.append((signed(indices), self._unit(indices, weights) if unit_norm else weights))
        indices, weights = (torch.cat(parts) for parts in zip(*results, strict=True))
        return indices.view(index_dtype(self.codes[0].n_atoms)), weights

    def largest(self, earlier: EarlierRound | None, buckets: range, keep: int) -> tuple[Tensor, Tensor]:
        """Return the ``keep`` largest of ``sums``, scaled to sum 1, for the Gaussians of some buckets."""
        sums = self.sums(earlier, buckets)
        levels = [SparseCodes.from_dense(sums[:, level], keep) for level in range(len(self.codes))]
        indices = torch.stack([signed(level.indices) for level in levels], 1)
        return indices.view(levels[0].indices.dtype), torch.stack([level.weights for level in levels], 1)

    def sums(self, earlier: EarlierRound | None, buckets: range) -> Tensor:
        """Return [n, S, L], w_i = sum of A[i, r] W_r for the Gaussians of some buckets."""
        first = buckets.start * BUCKET
        count = max(0, min(buckets.stop * BUCKET, self.n_gaussians) - first)
        n_atoms = self.codes[0].n_atoms
        sums = torch.zeros(count, len(self.codes), n_atoms, device=self.device)
        for view in self.views:
            gaussian, regions, weight = self._entries(view, buckets)
            for level, codes in enumerate(self.codes):
                there = regions[:, level] >= 0
                row, offset, share = regions[there, level], gaussian[there], weight[there]
                if earlier is not None:
                    cosines = self._cosines(earlier, level, first + offset, row)
                    factor = torch.exp(earlier.sharpness[level] * (cosines - 1).clamp(max=0))
                    share = share * factor.clamp(min=constants.LEAST_FACTOR)
                target = offset[:, None] * n_atoms + codes.indices.long()[row]
                sums[:, level] += (
                    torch.zeros(count * n_atoms, device=self.device)
                    .scatter_add_(0, target.flatten(), (share[:, None] * codes.weights[row]).flatten())
                    .view(count, n_atoms)
                )
        return sums

    def deviations(self, earlier: EarlierRound, buckets: range) -> list[Tensor]:
        """Return, per level, 1 - cosine of each region and each Gaussian of some buckets that meet in a view."""
        deviations = []
        for level, codes in enumerate(self.codes):
            pairs = [torch.zeros(0, dtype=torch.int64, device=self.device)]
            for view in self.views:
                gaussian, regions, _ = self._entries(view, buckets)
                there = regions[:, level] >= 0
                pairs.append(gaussian[there] * len(codes) + regions[there, level])
            pair = torch.cat(pairs).unique()
            gaussian = torch.div(pair, max(1, len(codes)), rounding_mode="floor")
            row = pair - gaussian * len(codes)
            cosines = self._cosines(earlier, level, buckets.start * BUCKET + gaussian, row)
            deviations.append((1 - cosines).cpu())
        return deviations

    def chunks(self, buckets: range, keep: int) -> Iterator[range]:
        """Yield the buckets whose sums are in memory at a time, for the ``keep`` largest; one empty range for none."""
        if not buckets:
            yield buckets
        for first in range(buckets.start, buckets.stop, BUCKETS_AT_A_TIME):
            yield range(first, min(first + BUCKETS_AT_A_TIME, buckets.stop))

    def _check(self, view: CodedEntries) -> None:
        view.entries.check_numbers(self.n_gaussians)

    def _entries(self, view: CodedEntries, buckets: range) -> tuple[Tensor, Tensor, Tensor]:
        """Return places [E] from the first bucket's start, rows of the regions [E, S] and weights [E]."""
        entries = view.entries.select_buckets(buckets.start, buckets.stop)
        parts = (
            entries.gaussians() - buckets.start * BUCKET,
            view.regions[entries.combinations],
            entries.weights,
        )
        gaussian, regions, weight = (torch.from_numpy(array).to(self.device) for array in parts)
        return gaussian, regions, weight

    def _cosines(self, earlier: EarlierRound, level: int, gaussian: Tensor, row: Tensor) -> Tensor:
        """Return [T] cosines of decoded codes of Gaussians and regions; 1 where the Gaussian has no code."""
        gram, codes = self.grams[level], self.codes[level]
        own_atoms = earlier.indices[:, level].to(self.device).long()[gaussian]  # [T, K]
        own_weights = earlier.weights[:, level].to(self.device)[gaussian]
        atoms, weights = codes.indices.long()[row], codes.weights[row]
        norms = (weights[:, :, None] * weights[:, None] * gram[atoms[:, :, None], atoms[:, None]]).sum((1, 2))
        products = own_weights[:, :, None] * weights[:, None] * gram[own_atoms[:, :, None], atoms[:, None]]
        norms = norms.clamp(min=0).sqrt()
        cosines = torch.where(norms > 0, products.sum((1, 2)) / norms.clamp(min=1e-12), 0.0)
        return torch.where(own_weights.sum(1) > 0, cosines, 1.0)

    def _unit(self, indices: Tensor, weights: Tensor) -> Tensor:
        """Scale weights so that decoded codes have norm 1; codes that decode to zero become zero."""
        out = torch.empty_like(weights)
        for level, gram in enumerate(self.grams):
            atoms, parts = indices[:, level].long(), weights[:, level]
            squared = parts[:, :, None] * parts[:, None] * gram[atoms[:, :, None], atoms[:, None]]
            norms = squared.sum((1, 2)).clamp(min=0).sqrt()[:, None]
            out[:, level] = torch.where(norms > 1e-6, parts / norms.clamp(min=1e-6), 0.0)
        return out


def check_regions(regions: np.ndarray, codes: Sequence[SparseCodes]) -> None:
    """Raise an InputError if a row [C, S] is beyond the codes."""
    for level, of_level in enumerate(codes):
        highest = int(regions[:, level].max(initial=-1))
        if highest >= len(of_level):
            raise InputError(f"the region sums are damaged: region {highest} has no code")
