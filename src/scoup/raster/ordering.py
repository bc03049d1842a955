"""An order of the Gaussians in which neighbours in space are neighbours in memory."""

from __future__ import annotations

import torch
from torch import Tensor

AT_A_TIME = 1 << 20  # rows, whose numbers are in memory in double precision
_AT_A_TIME_CPU = 1 << 13  # rows that stay in the cache; too few for torch to wait for threads
BITS = 21  # an axis: enough for rooms in scenes with a far-away background


def morton_order(means: Tensor) -> Tensor:
    """Return [N] int64 rows of ``means`` [N, 3] along a Z-order curve; rows in one of its cells keep their order."""
    return torch.argsort(morton_codes(means)[0], stable=True)


def morton_codes(means: Tensor, around: Tensor | None = None) -> tuple[Tensor, float]:
    """Return [N] int64 places of ``means`` [N, 3] on a Z-order curve through a cube around ``around`` [M, 3], by
    default around them, and the edge of its cells. Means beyond the cube count as at its sides.

    Bits 3 b to 3 b + 2 of a place are bit b of the cell along x, y, z. Entries that are not finite count as 0.
    """
    if not len(means):
        return torch.zeros(0, dtype=torch.int64, device=means.device), 1.0
    rows = _AT_A_TIME_CPU if means.device.type == "cpu" else AT_A_TIME
    parts = means.split(rows)
    inside = parts if around is None else around.split(rows)
    low = torch.stack([_finite(chunk).amin(0) for chunk in inside]).amin(0)
    span = torch.stack([(_finite(chunk) - low).amax() for chunk in inside]).amax()
    span = span.clamp(min=torch.finfo(torch.float64).tiny)
    code = torch.cat([_codes(_finite(chunk), low, span) for chunk in parts])
    return code, float(span) / (2**BITS - 1)


def restored(rows: Tensor, order: Tensor) -> Tensor:
    """Move rows [N, ...] back: row ``i`` to place ``order[i]``."""
    out = torch.empty_like(rows)
    if rows.dtype == torch.uint16:  # torch moves rows of its signed counterpart only
        out.view(torch.int16)[order] = rows.view(torch.int16)
    else:
        out[order] = rows
    return out


def _finite(means: Tensor) -> Tensor:
    return torch.nan_to_num(means.double(), nan=0.0, posinf=0.0, neginf=0.0)


def _codes(points: Tensor, low: Tensor, span: Tensor) -> Tensor:
    """Return [N] int64 places on the curve."""
    cells = ((points - low) / span * (2**BITS - 1)).clamp(0, 2**BITS - 1).long()
    return _spread(cells[:, 0]) | (_spread(cells[:, 1]) << 1) | (_spread(cells[:, 2]) << 2)


def _spread(cells: Tensor) -> Tensor:
    """Put two zero bits between every two bits of 21-bit numbers."""
    for shift, mask in (
        (32, 0x1F00000000FFFF),
        (16, 0x1F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    ):
        cells = (cells | (cells << shift)) & mask
    return cells
