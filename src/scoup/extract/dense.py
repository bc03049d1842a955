"""Embeddings of regions out of one pass over the photograph."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from scoup.extract.masks import Masks
from scoup.models.dense import DenseModel

WINDOWS = 2
"""Of the model's size, which fill the shorter side of a photograph. With more, smaller things have places of their own;
the work grows with the square."""
_MASKS_AT_ONCE = 16


class DenseEmbedder:
    """A dense encoder as a ``RegionEmbedder``.

    Args:
        model: from ``models.dense.open_dense_model``.
    """

    def __init__(self, model: DenseModel) -> None:
        self.model = model
        self.name, self.dim, self.device = model.name, model.dim, model.device

    def record(self) -> dict[str, Any]:
        return {**self.model.record(), "embedder_windows": WINDOWS}

    def embed_regions(self, image: Tensor, masks: Mapping[str, Masks]) -> dict[str, Tensor]:
        """Level -> [N, D] float32 unit vectors of masks over an image [H, W, 3] uint8."""
        size = self._scaled(image.shape[0], image.shape[1])
        pixels = image.permute(2, 0, 1)[None].float() / 255
        scaled = functional.interpolate(pixels, size, mode="bilinear", antialias=True, align_corners=False)[0]
        tokens = self.model.tokens(scaled)
        return {level: self._pooled(tokens, found) for level, found in masks.items()}

    def _scaled(self, height: int, width: int) -> tuple[int, int]:
        """Multiples of the patch, so that the shorter side fills the windows."""
        patch, window = self.model.patch, self.model.side // self.model.patch
        factor = WINDOWS * window / min(height, width)
        return round(height * factor) * patch, round(width * factor) * patch

    def _pooled(self, tokens: Tensor, found: Masks) -> Tensor:
        numbers = range(len(found))
        parts = [numbers[start : start + _MASKS_AT_ONCE] for start in numbers[::_MASKS_AT_ONCE]]
        rows = [self.model.pool(tokens, self._shares(found.select(part), tokens)).cpu() for part in parts]
        return torch.cat(rows) if rows else torch.zeros(0, self.dim)

    def _shares(self, found: Masks, tokens: Tensor) -> Tensor:
        """[N, h, w] of each token's area that a mask covers."""
        dense = torch.from_numpy(found.dense()).to(tokens.device)[:, None].float()
        return functional.adaptive_avg_pool2d(dense, (tokens.shape[0], tokens.shape[1]))[:, 0]
