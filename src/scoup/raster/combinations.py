"""Label maps of all levels as one map of label tuples, and the region sums of a view over these.

A pixel has one region, or none, at each level, and few of these combinations occur. Sums over regions are sums over
combinations first, for all levels at once.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import torch
from torch import Tensor

from scoup.base import InputError, native_core


@dataclass(frozen=True, eq=False)
class CombinedLabels:
    """The combinations of regions of one view, in the order of their first pixels, row by row."""

    map: Tensor  # [H, W] int32, number of the combination of each pixel; -1 where no level has a region
    table: Tensor  # [C, S] int32, the region of each combination at each level, -1 for none

    def digest(self) -> str:
        """Return a SHA-256 that is equal for equal label maps only."""
        digest = hashlib.sha256(str([list(self.map.shape), list(self.table.shape)]).encode())
        for tensor in (self.table, self.map):
            digest.update(tensor.cpu().contiguous().numpy().data)
        return digest.hexdigest()


def combine(labels: Tensor) -> CombinedLabels:
    """Return the combinations of label maps [S, H, W] of integers; every number below 0 means no region."""
    if labels.dim() != 3 or labels.is_floating_point():
        raise InputError(f"labels must be integers [S, H, W], got {labels.dtype} {list(labels.shape)}")
    if labels.dtype in (torch.int64, torch.uint32) and labels.numel() and int(labels.long().max()) >= 2**31:
        raise InputError(f"label {int(labels.long().max())} is beyond 32 bits; number the regions from 0")
    if not labels.dtype.is_signed:
        labels = labels.long()
    core = native_core() if labels.device.type == "cpu" else None
    if core is None:
        return combine_reference(labels)
    narrow = labels.clamp(min=-1).int() if labels.dtype == torch.int64 else labels.int()
    map_, table = core.combine(narrow.contiguous().numpy(), torch.get_num_threads())
    return CombinedLabels(torch.from_numpy(map_), torch.from_numpy(table))


def combine_reference(labels: Tensor) -> CombinedLabels:
    """Do as ``combine`` in plain torch, on any device."""
    levels, height, width = labels.shape
    flat = labels.clamp(min=-1).long().flatten(1)  # [S, P]
    if not flat.numel():
        return CombinedLabels(
            torch.full((height, width), -1, dtype=torch.int32, device=labels.device),
            torch.zeros(0, levels, dtype=torch.int32, device=labels.device),
        )
    # One number per combination, 0 for no region at all; a pixel without any comes first, so that one is always there.
    keys, total = flat.new_zeros(flat.shape[1] + 1), 1
    for of_level, size in zip(flat, (flat.amax(1) + 2).tolist(), strict=True):
        if total * size >= 2**62:
            keys, total = torch.unique(keys, return_inverse=True)[1], len(keys)
        keys = keys * size
        keys[1:] += of_level + 1
        total *= size
    rising, order = torch.sort(keys.int() if total < 2**31 else keys, stable=True)
    begins = rising != torch.nn.functional.pad(rising[:-1], (1, 0), value=-1)
    firsts = order[begins][1:] - 1  # pixel of each combination
    number = torch.empty_like(order).scatter_(0, order, torch.cumsum(begins, 0) - 2)[1:]
    by_pixel = torch.argsort(firsts)
    new = flat.new_full((len(firsts) + 1,), -1)  # the last for pixels without any region
    new[by_pixel] = torch.arange(len(firsts), device=labels.device)
    table = flat[:, firsts[by_pixel]].T.int().contiguous()
    return CombinedLabels(new[number].int().view(height, width), table)


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
