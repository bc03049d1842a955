"""The exact coder in all its forms under one signature, and rows and problems to give it."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType

import torch
from torch import Tensor

from scoup.coding.backends import RowCodes

Coder = Callable[..., RowCodes]
"""``coder(similarities, gram, k, swap_passes=0, warm=None)``, all float32 but the warm supports, as
``scoup.coding.reference.code``."""


def native_coder(core: ModuleType) -> Coder:
    def run(
        similarities: Tensor, gram: Tensor, k: int, swap_passes: int = 0, warm: Tensor | None = None
    ) -> RowCodes:
        start = None if warm is None else warm.int().numpy()
        arrays = similarities.contiguous().numpy(), gram.contiguous().numpy()
        coded = core.code_similarities(*arrays, k, swap_passes, start)
        support, weights, cosines = (torch.from_numpy(array) for array in coded)
        return RowCodes(support.long(), weights.double(), cosines.double())

    return run


def clip_like(count: int, dim: int = 32, objects: int = 12, seed: int = 0) -> Tensor:
    """[count, dim] unit rows around objects that share a mean, as CLIP embeddings do."""
    generator = torch.Generator().manual_seed(seed)
    centres = torch.randn(objects, dim, generator=generator) + 1.0
    rows = centres[torch.randint(objects, (count,), generator=generator)]
    rows = rows + 0.7 * torch.randn(count, dim, generator=generator)
    return torch.nn.functional.normalize(rows, dim=1)


def problem(count: int, n_atoms: int, dim: int = 32, seed: int = 0) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Unit rows, unit atoms, their similarities and the Gram matrix."""
    rows = clip_like(count, dim, max(2, n_atoms // 2), seed)
    atoms = clip_like(n_atoms, dim, max(2, n_atoms // 2), seed + 1000)
    return rows, atoms, rows @ atoms.T, atoms @ atoms.T
