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

from collections.abc import Callable
from functools import wraps
from typing import Concatenate, ParamSpec

import torch
from torch import Tensor

from scoup.base import native_core, required_core
from scoup.scene import check_atoms, code_arrays, float32_products, stable_products

Others = ParamSpec("Others")
Sums = Callable[Concatenate[Tensor, Tensor, Others], Tensor]


def _in_core(plain: Sums[Others]) -> Sums[Others]:
    """Return a function of torch code that calls the function of its name in the compiled core where it can."""
    name = plain.__name__.removeprefix("plain_")

    @wraps(plain)
    def sums(indices: Tensor, weights: Tensor, *others: Others.args, **named: Others.kwargs) -> Tensor:
        core = native_core() if indices.device.type == "cpu" else None
        if core is None or indices.dtype not in (torch.uint8, torch.uint16):
            return plain(indices, weights, *others, **named)
        arrays = [
            item.detach().float().contiguous().numpy() if isinstance(item, Tensor) else item
            for item in others
        ]
        with required_core():
            result = getattr(core, name)(*code_arrays(indices, weights), *arrays, torch.get_num_threads())
        return torch.from_numpy(result)

    return sums


def plain_code_scores(indices: Tensor, weights: Tensor, scores: Tensor) -> Tensor:
    """Return the products W A of codes with columns of scores, [N, S, Q] float32."""
    check_atoms(indices, scores.shape[1])
    levels = [
        (scores[level][indices[:, level].long()] * weights[:, level, :, None].float()).sum(1)
        for level in range(len(scores))
    ]
    return torch.stack(levels, 1)


def plain_inverse_code_norms(indices: Tensor, weights: Tensor, grams: Tensor) -> Tensor:
    """Return 1 / sqrt(W G W^T), the inverse norms of decoded codes from G [S, L, L], [N, S] float32; 0 without a
    code."""
    check_atoms(indices, grams.shape[1])
    squares = torch.zeros(weights.shape[:2], device=weights.device)
    for level, gram in enumerate(grams):
        atoms, values = indices[:, level].long(), weights[:, level].float()
        for one in range(values.shape[1]):
            for other in range(values.shape[1]):
                squares[:, level] += values[:, one] * values[:, other] * gram[atoms[:, one], atoms[:, other]]
    return torch.where(squares > 0, squares.rsqrt(), 0.0)


def plain_best_code_cosines(
    indices: Tensor, weights: Tensor, scores: Tensor, inverse_norms: Tensor
) -> Tensor:
    """Return the largest cosine of each code with Q >= 1 columns of scores, [N, S] float32; 0 without a code."""
    best = torch.full_like(inverse_norms, -torch.inf)
    for column in scores.unbind(-1):  # one by one, which takes less memory
        best = torch.maximum(best, plain_code_scores(indices, weights, column[..., None])[..., 0])
    return best * inverse_norms


def plain_code_relevancy(
    indices: Tensor, weights: Tensor, scores: Tensor, inverse_norms: Tensor, best: Tensor, temperature: float
) -> Tensor:
    """Return sigmoid(temperature * (cosine - best)) of each code and column of scores, [Q, S, N] float32; ``best`` [N,
    S] are cosines of the phrases that queries are compared with, from ``best_code_cosines``."""
    out = torch.empty(scores.shape[2], len(scores), len(weights), device=weights.device)
    for number, column in enumerate(scores.unbind(-1)):
        cosines = plain_code_scores(indices, weights, column[..., None])[..., 0] * inverse_norms
        out[number] = (temperature * (cosines - best)).sigmoid().T
    return out


code_scores = _in_core(plain_code_scores)
inverse_code_norms = _in_core(plain_inverse_code_norms)
best_code_cosines = _in_core(plain_best_code_cosines)
code_relevancy = _in_core(plain_code_relevancy)


def atom_products(atoms: Tensor, vectors: Tensor) -> Tensor:
    """Return the products [L, Q] float32 of atoms [L, D] with vectors [Q, D], the same for any number of threads."""
    products = stable_products if vectors.device.type == "cpu" else float32_products
    return products(atoms, vectors)
