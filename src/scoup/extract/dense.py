"""Embeddings of regions from one pass over the photograph."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from scoup.extract.masks import Masks
from scoup.models.dense import DenseModel

# Of the model's size, which fill the shorter side of a photograph. With more, smaller things have places of their own;
# the work grows with the square.
WINDOWS = 2
_MASKS_AT_ONCE = 16


class DenseEmbedder:
    """A dense encoder as a ``RegionEmbedder``."""

    def __init__(self, model: DenseModel) -> None:
        self.model = model
        self.name, self.dim, self.device = model.name, model.dim, model.device

    def record(self) -> dict[str, Any]:
        return {**self.model.record(), "embedder_windows": WINDOWS}

    def embed_regions(self, image: Tensor, masks: Mapping[str, Masks]) -> dict[str, Tensor]:
        size = self._scaled_size(image.shape[0], image.shape[1])
        pixels = image.permute(2, 0, 1)[None].float() / 255
        scaled = functional.interpolate(pixels, size, mode="bilinear", antialias=True, align_corners=False)[0]
        tokens = self.model.tokens(scaled)
        return {level: self._pool(tokens, found) for level, found in masks.items()}

    def _scaled_size(self, height: int, width: int) -> tuple[int, int]:
        """Return multiples of the patch such that the shorter side fills the windows."""
        patch, window = self.model.patch, self.model.side // self.model.patch
        factor = WINDOWS * window / min(height, width)
        return round(height * factor) * patch, round(width * factor) * patch

    def _pool(self, tokens: Tensor, found: Masks) -> Tensor:
        numbers = range(len(found))
        parts = [numbers[start : start + _MASKS_AT_ONCE] for start in numbers[::_MASKS_AT_ONCE]]
        rows = [self.model.pool(tokens, self._shares(found.select(part), tokens)).cpu() for part in parts]
        return torch.cat(rows) if rows else torch.zeros(0, self.dim)

    def _shares(self, found: Masks, tokens: Tensor) -> Tensor:
        """Return [N, h, w] the share of each token's area that a mask covers."""
        dense = torch.from_numpy(found.dense()).to(tokens.device)[:, None].float()
        return functional.adaptive_avg_pool2d(dense, (tokens.shape[0], tokens.shape[1]))[:, 0]
