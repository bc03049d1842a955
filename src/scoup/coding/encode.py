"""Codes of rows under a fixed codebook: non-negative K-sparse least squares in Gram space."""

from __future__ import annotations

import torch
from torch import Tensor

from scoup.codes import SparseCodes, index_dtype

_CHUNK = 8192
_DEPENDENT = 1e-5  # an atom with less than this share of its squared norm left depends on those chosen


def encode(
    rows: Tensor,  # [R, D]
    atoms: Tensor,  # [L, D]
    k: int,
) -> SparseCodes:
    """For each row at most K atoms and weights >= 0 that bring the decoded code near to it in angle.

    Under the cosine loss only the direction of w C matters, so the best weights on a support solve
    non-negative least squares. The support is chosen by orthogonal least squares: at each step the atom that
    lowers the residual most (without exchanging atoms afterwards). Greedy, hence near the optimum but
    not guaranteed to be it.

    Args:
        rows: [R, D] float32, any norm; rows of norm zero, and rows to which no atom
            has a positive inner product, get empty codes.
        atoms: [L, D] float32, any norm; atoms of norm zero are never used.
        k: most atoms a row may use; the codes have K columns even if there are fewer atoms.
    """
    gram = atoms @ atoms.T
    picks = min(k, len(atoms))
    parts = [
        _encode_chunk(rows[start : start + _CHUNK] @ atoms.T, gram, picks)
        for start in range(0, len(rows), _CHUNK)
    ]
    if not parts:
        parts = [(torch.zeros(0, picks, dtype=torch.long), torch.zeros(0, picks))]
    indices = torch.nn.functional.pad(torch.cat([part[0] for part in parts]), (0, k - picks))
    weights = torch.nn.functional.pad(torch.cat([part[1] for part in parts]), (0, k - picks))
    return SparseCodes(indices.to(index_dtype(len(atoms))), weights.float(), len(atoms))


def _encode_chunk(similarities: Tensor, gram: Tensor, k: int) -> tuple[Tensor, Tensor]:
    support, valid = _choose(similarities, gram, k)
    weights = _nonnegative(similarities, gram, support, valid)
    total = weights.sum(1, keepdim=True)
    weights = torch.where(total > 0, weights / total.clamp(min=torch.finfo(weights.dtype).tiny), 0.0)
    weights, order = torch.sort(weights, dim=1, descending=True, stable=True)
    return torch.where(weights > 0, support.gather(1, order), 0), weights


def _choose(similarities: Tensor, gram: Tensor, k: int) -> tuple[Tensor, Tensor]:
    """Orthogonal least squares with positive residuals only: support [n, K] int64 and which of it counts [n,
    K].
    """
    residual = similarities.clone()  # of each atom with what is left of the row
    norms = gram.diagonal()
    left = norms.expand_as(residual).clone()  # squared norm of each atom, less what the chosen atoms span
    directions: list[Tensor] = []  # [n, L] each: Gram rows of the orthogonalised atoms
    support, valid = [], []
    for _ in range(k):
        usable = (left > _DEPENDENT * norms) & (residual > 0)
        gain = torch.where(usable, residual**2 / left.clamp(min=torch.finfo(left.dtype).tiny), 0.0)
        best, pick = gain.max(1, keepdim=True)
        chosen = best > 0
        direction = gram[pick[:, 0]]
        for earlier in directions:
            direction = direction - earlier.gather(1, pick) * earlier
        root = left.gather(1, pick).clamp(min=torch.finfo(left.dtype).tiny).sqrt()
        direction = torch.where(chosen, direction / root, 0.0)
        residual = residual - torch.where(chosen, residual.gather(1, pick) / root, 0.0) * direction
        left = left - direction**2
        left.scatter_(1, pick, 0.0)
        directions.append(direction)
        support.append(pick)
        valid.append(chosen)
    return torch.cat(support, 1), torch.cat(valid, 1)


def _nonnegative(similarities: Tensor, gram: Tensor, support: Tensor, valid: Tensor) -> Tensor:
    """Least squares on the support, the most negative weight dropped and the rest solved again until none
    is: [n, K] float64.
    """
    toward = similarities.gather(1, support).double()
    within = gram[support[:, :, None], support[:, None, :]].double()
    identity = torch.eye(support.shape[1], dtype=torch.float64, device=gram.device)
    active = valid
    weights = torch.zeros_like(toward)
    for _ in range(support.shape[1]):
        both = active[:, :, None] & active[:, None, :]
        weights = torch.linalg.solve(torch.where(both, within, identity), torch.where(active, toward, 0.0))
        worst, slot = weights.min(1, keepdim=True)
        if not bool((worst < 0).any()):
            break
        active = active.scatter(1, slot, active.gather(1, slot) & (worst >= 0))
    return weights.clamp(min=0)
