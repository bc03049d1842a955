"""Label maps of all levels as one map of label tuples.

A pixel has one region, or none, at each level, and few of these combinations occur. Sums over regions are sums over
combinations first, for all levels at once.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import torch
from torch import Tensor

from scoup.base.errors import InputError
from scoup.base.native import native_core


@dataclass(frozen=True, eq=False)
class CombinedLabels:
    """The combinations of regions of one view, in the order of their first pixels, row by row."""

    map: Tensor
    """[H, W] int32, number of the combination of each pixel; -1 where no level has a region."""
    table: Tensor
    """[C, S] int32, the region of each combination at each level, -1 for none."""

    def digest(self) -> str:
        """Return a SHA-256 that is equal for equal label maps only."""
        digest = hashlib.sha256(str([list(self.map.shape), list(self.table.shape)]).encode())
        for part in (self.table, self.map):
            digest.update(part.cpu().contiguous().numpy().data)
        return digest.hexdigest()


def combine(labels: Tensor) -> CombinedLabels:
    """Return the combinations of label maps [S, H, W] of integers; every number below 0 means no region."""
    check_labels(labels)
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
    flat = labels.clamp(min=-1).int().flatten(1).T  # [P, S]
    if not flat.numel():
        return CombinedLabels(
            torch.full((height, width), -1, dtype=torch.int32, device=labels.device),
            torch.zeros(0, levels, dtype=torch.int32, device=labels.device),
        )
    rows, number = torch.unique(flat, dim=0, return_inverse=True)
    pixel = torch.arange(len(flat), device=labels.device)
    first = torch.full((len(rows),), len(flat), device=labels.device)
    first.scatter_reduce_(0, number, pixel, "amin")
    used = (rows >= 0).any(1)
    order = torch.argsort(torch.where(used, first, len(flat)))[: int(used.sum())]
    new = torch.full((len(rows),), -1, dtype=torch.int32, device=labels.device)
    new[order] = torch.arange(len(order), dtype=torch.int32, device=labels.device)
    return CombinedLabels(new[number].view(height, width), rows[order].contiguous())


def check_labels(labels: Tensor) -> None:
    """Refuse what cannot be label maps [S, H, W]."""
    if labels.dim() != 3 or labels.is_floating_point():
        raise InputError(f"labels must be integers [S, H, W], got {labels.dtype} {list(labels.shape)}")
    if labels.dtype in (torch.int64, torch.uint32) and labels.numel() and int(labels.long().max()) >= 2**31:
        raise InputError(f"label {int(labels.long().max())} is beyond 32 bits; number the regions from 0")
