"""Small non-negative least-squares problems in Gram space, batched over rows, in plain torch."""

from __future__ import annotations

import torch
from torch import Tensor

DEPENDENT = 1e-5  # an atom with less than this share of its squared norm left depends on those chosen
NO_WEIGHT = 1e-7  # weights below this share of the largest possible are rounding


def nonnegative_least_squares(
    toward: Tensor,  # [n, K]
    within: Tensor,  # [n, K, K]
    valid: Tensor,  # [n, K]
) -> Tensor:
    """[n, K]: the w >= 0 that minimise w^T within w - 2 w . toward, zero outside ``valid`` and for atoms that depend
    on others.

    Where the solution without signs is positive it is the answer; elsewhere the active-set method of Lawson and
    Hanson (Solving Least Squares Problems, 1974, chapter 23) finds it.
    """
    norms = within.diagonal(dim1=1, dim2=2)
    alone = torch.where(valid & (norms > 0), toward / norms, 0.0)
    smallest = NO_WEIGHT * alone.amax(1, keepdim=True).clamp(min=0)
    weights, independent = _least_squares(toward, within, valid)
    rest = (~(independent & ((weights > smallest) | ~valid).all(1))).nonzero()[:, 0]
    if len(rest):
        weights[rest] = _active_set(toward[rest], within[rest], valid[rest], smallest[rest])
    return weights


def _active_set(toward: Tensor, within: Tensor, valid: Tensor, smallest: Tensor) -> Tensor:
    norms = within.diagonal(dim1=1, dim2=2)
    weights = torch.zeros_like(toward)
    used = torch.zeros_like(valid)
    barred = ~valid
    for _ in range(4 * valid.shape[1]):
        pull = toward - (within @ weights[:, :, None])[:, :, 0]
        helps = ~used & ~barred & (pull > smallest * norms) & (pull > 0)
        if not bool(helps.any()):
            break
        steepest = torch.where(helps, pull, -torch.inf).argmax(1, keepdim=True)
        enters = torch.zeros_like(used).scatter_(1, steepest, True) & helps
        target, independent = _least_squares(toward, within, used | enters)
        useless = ~independent | (target.gather(1, steepest) <= smallest)[:, 0]
        barred |= enters & useless[:, None]
        moving = enters.any(1) & ~useless
        used |= enters & moving[:, None]
        while bool(moving.any()):
            target, _ = _least_squares(toward, within, used)
            falls = used & (target <= 0)
            step = torch.where(falls, weights / (weights - target), 1.0).amin(1, keepdim=True)
            moved = weights + step * (target - weights)
            keeps = used & ((step == 1) | (moved > smallest))
            weights = torch.where(moving[:, None], torch.where(keeps, moved, 0.0), weights)
            dropped = (keeps != used).any(1)
            used = torch.where(moving[:, None], keeps, used)
            moving &= dropped
    return weights


def _least_squares(toward: Tensor, within: Tensor, active: Tensor) -> tuple[Tensor, Tensor]:
    """Weights [n, K], zero outside ``active``, and whether the active atoms are independent [n]."""
    factor, info = torch.linalg.cholesky_ex(identity_outside(within, active))
    norms = torch.where(active, within.diagonal(dim1=1, dim2=2), 1.0)
    pivots = factor.diagonal(dim1=1, dim2=2) ** 2
    independent = (info == 0) & (pivots > DEPENDENT * norms).all(1)
    identity = torch.eye(toward.shape[1], dtype=toward.dtype, device=toward.device)
    factor = torch.where(independent[:, None, None], factor, identity)
    weights = torch.cholesky_solve(torch.where(active, toward, 0.0)[:, :, None], factor)[:, :, 0]
    return weights, independent


def identity_outside(within: Tensor, active: Tensor) -> Tensor:
    """[n, K, K]: ``within`` with rows and columns of the identity where not ``active`` [n, K]."""
    both = active[:, :, None] & active[:, None, :]
    return torch.where(both, within, torch.eye(active.shape[1], dtype=within.dtype, device=within.device))
