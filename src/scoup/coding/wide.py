"""Wide codes: how regions vote with every atom that explains them, not only with the few that a code may hold.

A region's embedding is its thing's plus noise. The K atoms that fit it best fit the noise too, and take all of it. Non-
negative least squares over all atoms spreads the noise over many small weights, different ones in every view, while
what the views share stays with the same few atoms. The vote adds up, and its top-K step drops what is small. Own;
measured in docs/answers.md. The paper's vote takes the K-sparse codes themselves (method.md, stage 2).
"""

from __future__ import annotations

import torch
from torch import Tensor

from scoup.base.native import native_core
from scoup.scene.codes import SparseCodes, index_dtype, stable_products

SWEEPS = 30
TOLERANCE = 1e-3
"""Coordinate descent stops after so many sweeps over the atoms, or once no weight moves further in a sweep."""


def wide_codes(rows: Tensor, atoms: Tensor, k: int) -> SparseCodes:
    """Codes of the K largest weights that non-negative least squares gives each row over all atoms.

    Args:
        rows: [R, D] float32, unit norm or zero; rows of norm zero get empty codes.
        atoms: [L, D] float32, any norm; atoms of norm zero are never used.
        k: K, atoms kept of each row; the codes have K columns even if there are fewer atoms.

    Returns:
        Codes on the device of the rows. The atoms are those of the whole solution, the weights solved for again with
        these atoms alone: what the others had explained would be missing.
    """
    atoms = atoms.detach().float().to(rows.device)
    similarities = stable_products(rows.detach().float(), atoms)
    gram = stable_products(atoms, atoms)
    weights = _weights(similarities, gram)
    kept = min(k, len(atoms))
    # A stable sort: of equal weights the first atoms are kept, on every device.
    order = weights.argsort(dim=1, descending=True, stable=True)[:, :kept]
    indices = torch.zeros(len(rows), k, dtype=torch.long, device=rows.device)
    largest = torch.zeros(len(rows), k, device=rows.device)
    indices[:, :kept] = order
    largest[:, :kept] = weights.gather(1, order)
    largest = _solved_again(largest, indices, similarities, gram)
    order = largest.argsort(dim=1, descending=True, stable=True)
    indices, largest = indices.gather(1, order), largest.gather(1, order)
    indices[largest == 0] = 0
    return SparseCodes(indices.to(index_dtype(len(atoms))), largest, len(atoms))


def _solved_again(weights: Tensor, indices: Tensor, similarities: Tensor, gram: Tensor) -> Tensor:
    """[R, K] non-negative least squares over the atoms [R, K] with a weight, by coordinate descent."""
    used = weights > 0
    wanted = similarities.gather(1, indices)  # [R, K]
    products = gram[indices[:, :, None], indices[:, None, :]]  # [R, K, K]
    weights = weights.clone()
    for _ in range(2 * SWEEPS):
        for place in range(weights.shape[1]):
            own = products[:, place, place].clamp(min=1e-12)
            rest = wanted[:, place] - (products[:, place] * weights).sum(1)
            better = (weights[:, place] + rest / own).clamp(min=0)
            weights[:, place] = torch.where(used[:, place], better, 0.0)
    return weights


def _weights(similarities: Tensor, gram: Tensor) -> Tensor:
    core = native_core() if similarities.device.type == "cpu" else None
    if core is None:
        return plain_weights(similarities, gram)
    arrays = similarities.contiguous().numpy(), gram.contiguous().numpy()
    return torch.from_numpy(core.wide_weights(*arrays, SWEEPS, TOLERANCE, torch.get_num_threads()))


def plain_weights(
    similarities: Tensor, gram: Tensor, sweeps: int = SWEEPS, tolerance: float = TOLERANCE
) -> Tensor:
    """[R, L] float32 non-negative least squares by coordinate descent, in torch: the specification of the core.

    Args:
        similarities: [R, L] of rows and atoms.
        gram: [L, L] of the atoms.
        sweeps, tolerance: see ``SWEEPS``.
    """
    # A copy even where one row or atom leaves nothing to transpose.
    residual = similarities.T.clone(memory_format=torch.contiguous_format)  # [L, R]
    weights = torch.zeros_like(residual)
    moving = torch.ones(residual.shape[1], dtype=torch.bool, device=residual.device)
    usable = (gram.diagonal() > 0).tolist()
    for _ in range(sweeps):
        furthest = torch.zeros(residual.shape[1], device=residual.device)
        for atom, products in enumerate(gram):
            if not usable[atom]:
                continue
            better = (weights[atom] + residual[atom] / products[atom]).clamp(min=0)
            step = torch.where(moving, better - weights[atom], 0.0)
            weights[atom] = torch.where(moving, better, weights[atom])
            residual -= products[:, None] * step
            furthest = torch.maximum(furthest, step.abs())
        moving = moving & (furthest > tolerance)
        if not moving.any():
            break
    return weights.T.contiguous()
