"""Region sums of one view: the contribution of each Gaussian to each combination of its regions."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True, eq=False)
class ViewSums:
    """Region sums of one view: A[i, c] = sum of the blending weights e_i over the pixels of combination c.

    A region is the union of its combinations, so that A[i, r] of method.md, stage 2, is a sum of these.
    """

    gaussian: Tensor  # [E] int32, rising
    combination: Tensor  # [E] int32, rising among entries of the same Gaussian; each pair occurs once
    weight: Tensor  # [E] float32, positive
    table: Tensor  # [C, S] int32, the region of each combination at each level, -1 for none
    labels_digest: str = ""  # of the label maps (``CombinedLabels.digest``), "" if unknown

    def triplets(self, level: int) -> tuple[Tensor, Tensor, Tensor]:
        """Return (gaussian [T] int64, region [T] int64, weight [T] float32) of one level, sorted, each pair once."""
        region = self.table[:, level].long()[self.combination.long()]
        there = region >= 0
        n_regions = int(self.table[:, level].max()) + 1 if len(self.table) else 0
        gaussian, region, weight = merge(
            self.gaussian[there], region[there], self.weight[there], max(1, n_regions)
        )
        return gaussian.long(), region.long(), weight


def merge(first: Tensor, second: Tensor, weight: Tensor, n_second: int) -> tuple[Tensor, Tensor, Tensor]:
    """Add up the weights of equal pairs, in order and in float64; return (int32, int32, float32) sorted by both."""
    keys, order = torch.sort(first.long() * n_second + second.long(), stable=True)
    keys, counts = torch.unique_consecutive(keys, return_counts=True)
    total = weight.double()[order]
    if len(keys):  # torch reduces no empty lengths
        # One after the other on a GPU, too, unlike additions that are scattered.
        total = torch.segment_reduce(total, "sum", lengths=counts)
    return (torch.div(keys, n_second, rounding_mode="floor").int(), (keys % n_second).int(), total.float())
