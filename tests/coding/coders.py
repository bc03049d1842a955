"""The exact coder in all its forms under one signature, problems to give it, and what holds for its codes."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from types import ModuleType

import torch
from torch import Tensor

from scoup.coding.backends import RowCodes
from scoup.coding.reference import code

Coder = Callable[..., RowCodes]
"""``coder(similarities, gram, k, swap_passes=0, warm=None)``, all float32 but the warm supports."""


def reference_coder(
    similarities: Tensor, gram: Tensor, k: int, swap_passes: int = 0, warm: Tensor | None = None
) -> RowCodes:
    return code(similarities, gram, k, swap_passes, warm)


def native_coder(core: ModuleType) -> Coder:
    def run(
        similarities: Tensor, gram: Tensor, k: int, swap_passes: int = 0, warm: Tensor | None = None
    ) -> RowCodes:
        start = None if warm is None else warm.int().numpy()
        arrays = core.code_similarities(
            similarities.contiguous().numpy(), gram.contiguous().numpy(), k, swap_passes, start
        )
        support, weights, cosines = (torch.from_numpy(array) for array in arrays)
        return RowCodes(support.long(), weights.double(), cosines.double())

    return run


def clip_like(count: int, dim: int = 32, objects: int = 12, seed: int = 0) -> Tensor:
    """[count, dim] unit rows around objects that share a mean, as CLIP embeddings do."""
    generator = torch.Generator().manual_seed(seed)
    centres = torch.randn(objects, dim, generator=generator) + 1.0
    rows = centres[torch.randint(objects, (count,), generator=generator)]
    rows = rows + 0.7 * torch.randn(count, dim, generator=generator)
    return torch.nn.functional.normalize(rows, dim=1)


def clusters(of_each: int) -> tuple[Tensor, Tensor]:
    """[6, 16] centres at right angles, and unit rows around them."""
    generator = torch.Generator().manual_seed(0)
    centres = torch.linalg.qr(torch.randn(16, 6, generator=generator)).Q.T
    rows = centres.repeat_interleave(of_each, 0)
    rows = rows + 0.05 * torch.randn(rows.shape, generator=generator)
    return centres, torch.nn.functional.normalize(rows, dim=1)


def assert_one_at_each(centres: Tensor, atoms: Tensor) -> None:
    nearest = (centres @ atoms.T).max(1)
    assert sorted(nearest.indices.tolist()) == list(range(len(centres)))
    assert float(nearest.values.min()) > 0.99


def problem(count: int, n_atoms: int, dim: int = 32, seed: int = 0) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Unit rows, unit atoms, their similarities and the Gram matrix."""
    rows = clip_like(count, dim, max(2, n_atoms // 2), seed)
    atoms = clip_like(n_atoms, dim, max(2, n_atoms // 2), seed + 1000)
    return rows, atoms, rows @ atoms.T, atoms @ atoms.T


def dense(coded: RowCodes, n_atoms: int) -> Tensor:
    """[n, L] float64 weights."""
    weights = torch.zeros(len(coded.support), n_atoms, dtype=torch.float64)
    return weights.scatter_add_(1, coded.support.clamp(min=0), coded.weights)


def best_of_all_supports(similarities: Tensor, gram: Tensor, k: int) -> Tensor:
    """[n] the greatest cosine over all supports of at most k atoms, by trying each."""
    best = torch.zeros(len(similarities), dtype=torch.float64)
    for size in range(1, k + 1):
        for support in itertools.combinations(range(len(gram)), size):
            chosen = list(support)
            toward = similarities[:, chosen].double()
            within = gram[chosen][:, chosen].double()
            weights = torch.linalg.lstsq(within, toward.T).solution.T
            explained = (weights * toward).sum(1).clamp(min=0).sqrt()
            # A non-negative optimum has positive weights on some support, and is the solution without signs there.
            best = torch.where((weights >= 0).all(1), torch.maximum(best, explained), best)
    return best


def assert_valid(coded: RowCodes, similarities: Tensor, gram: Tensor, k: int) -> None:
    """Codes are well formed, and their weights optimal for the atoms used."""
    used = coded.support >= 0
    assert coded.support.shape == coded.weights.shape == (len(similarities), k)
    assert bool((coded.support < len(gram)).all())
    assert bool((used == (coded.weights > 0)).all())
    assert bool((coded.weights[:, :-1] >= coded.weights[:, 1:]).all())
    assert all(len(set(row)) == len(row) for row in (s[s >= 0].tolist() for s in coded.support))
    weights = dense(coded, len(gram))
    pull = similarities.double() - weights @ gram.double()
    scale = similarities.abs().amax().double().clamp(min=1e-30)
    torch.testing.assert_close(
        pull[weights > 0] / scale, torch.zeros_like(pull[weights > 0]), atol=3e-5, rtol=0
    )
    explained = (weights * similarities.double()).sum(1).clamp(min=0).sqrt()
    torch.testing.assert_close(coded.cosines, explained, atol=1e-6, rtol=1e-5)
