"""Sums over the sparse codes of single Gaussians: scores, norms, cosines and relevancy, without decoding.

The cosine of a decoded code with a vector is W A / sqrt(W G W^T) with A = C T^T and G = C C^T (docs/method.md, stage
3): a gather of K coefficients per Gaussian and level. The compiled core does it on a CPU. The torch code
(``plain_...``) is its specification, and is used without the core, on other devices and for other types.

Common arguments:
    indices: [N, S, K] atoms, each below L.
    weights: [N, S, K] float16 or float32.
    scores: [S, L, Q] float32, the product A of each atom with each vector.
    inverse_norms: [N, S] float32, from ``inverse_code_norms``.

All raise InputError if an index is not below L.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from scoup.base import native_core, required_core
from scoup.scene import check_atoms, code_arrays, float32_products, stable_products


def code_scores(indices: Tensor, weights: Tensor, scores: Tensor) -> Tensor:
    """Return the products W A of codes with columns of scores, [N, S, Q] float32."""
    products = _native("code_scores", indices, weights, scores)
    return plain_code_scores(indices, weights, scores) if products is None else products


def plain_code_scores(indices: Tensor, weights: Tensor, scores: Tensor) -> Tensor:
    """``code_scores`` in torch."""
    check_atoms(indices, scores.shape[1])
    levels = [
        (scores[level][indices[:, level].long()] * weights[:, level, :, None].float()).sum(1)
        for level in range(len(scores))
    ]
    return torch.stack(levels, 1)


def inverse_code_norms(indices: Tensor, weights: Tensor, codebook: Tensor) -> Tensor:
    """Return 1 / sqrt(W G W^T), the inverse norms of decoded codes over a codebook [S, L, D], [N, S] float32; 0 without
    a code."""
    grams = torch.stack([atom_products(atoms, atoms) for atoms in codebook.float()])
    norms = _native("inverse_code_norms", indices, weights, grams)
    return plain_inverse_code_norms(indices, weights, grams) if norms is None else norms


def plain_inverse_code_norms(indices: Tensor, weights: Tensor, grams: Tensor) -> Tensor:
    """``inverse_code_norms`` in torch, from G [S, L, L]."""
    check_atoms(indices, grams.shape[1])
    squares = torch.zeros(weights.shape[:2], device=weights.device)
    for level, gram in enumerate(grams):
        atoms, values = indices[:, level].long(), weights[:, level].float()
        for one in range(values.shape[1]):
            for other in range(values.shape[1]):
                squares[:, level] += values[:, one] * values[:, other] * gram[atoms[:, one], atoms[:, other]]
    return torch.where(squares > 0, squares.rsqrt(), 0.0)


def best_code_cosines(indices: Tensor, weights: Tensor, inverse_norms: Tensor, scores: Tensor) -> Tensor:
    """Return the largest cosine of each code with Q >= 1 columns of scores, [N, S] float32; 0 without a code."""
    cosines = _native("best_code_cosines", indices, weights, scores, inverse_norms)
    return plain_best_code_cosines(indices, weights, inverse_norms, scores) if cosines is None else cosines


def plain_best_code_cosines(
    indices: Tensor, weights: Tensor, inverse_norms: Tensor, scores: Tensor
) -> Tensor:
    """``best_code_cosines`` in torch."""
    best = torch.full_like(inverse_norms, -torch.inf)
    for column in scores.unbind(-1):  # one by one, which takes less memory
        best = torch.maximum(best, plain_code_scores(indices, weights, column[..., None])[..., 0])
    return best * inverse_norms


def code_relevancy(
    indices: Tensor, weights: Tensor, inverse_norms: Tensor, best: Tensor, scores: Tensor, temperature: float
) -> Tensor:
    """Return sigmoid(temperature * (cosine - best)) of each code and column of scores, [S, Q, N] float32; ``best`` [N,
    S] are cosines of the phrases that queries are compared with, from ``best_code_cosines``."""
    relevancy = _native("code_relevancy", indices, weights, scores, inverse_norms, best, temperature)
    if relevancy is not None:
        return relevancy.transpose(0, 1)  # what belongs to one column is contiguous
    return plain_code_relevancy(indices, weights, inverse_norms, best, scores, temperature)


def plain_code_relevancy(
    indices: Tensor, weights: Tensor, inverse_norms: Tensor, best: Tensor, scores: Tensor, temperature: float
) -> Tensor:
    """``code_relevancy`` in torch."""
    out = torch.empty(scores.shape[2], len(scores), len(weights), device=weights.device)
    for number, column in enumerate(scores.unbind(-1)):
        cosines = plain_code_scores(indices, weights, column[..., None])[..., 0] * inverse_norms
        out[number] = (temperature * (cosines - best)).sigmoid().T
    return out.transpose(0, 1)


def atom_products(atoms: Tensor, vectors: Tensor) -> Tensor:
    """Return the products [L, Q] float32 of atoms [L, D] with vectors [Q, D], the same for any number of threads."""
    products = stable_products if vectors.device.type == "cpu" else float32_products
    return products(atoms, vectors)


def _native(name: str, indices: Tensor, weights: Tensor, *others: Any) -> Tensor | None:
    """Return the result of the compiled core; None if it cannot be used."""
    core = native_core() if indices.device.type == "cpu" else None
    if core is None or indices.dtype not in (torch.uint8, torch.uint16):
        return None
    arrays = [
        item.detach().float().contiguous().numpy() if isinstance(item, Tensor) else item for item in others
    ]
    with required_core():
        result = getattr(core, name)(*code_arrays(indices, weights), *arrays, torch.get_num_threads())
    return torch.from_numpy(result)
