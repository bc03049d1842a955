"""Embeddings of regions from one pass over the photograph."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from scoup.extract.masks import Masks
from scoup.models import open_dense_model

# Windows of the model's size along the shorter side of a photograph. More resolve smaller things; the work grows with
# the square.
WINDOWS = 2
_MASKS_AT_ONCE = 64


class DenseEmbedder:
    """A dense encoder as a ``RegionEmbedder``."""

    def __init__(self, name: str, revision: str | None, device: torch.device | str) -> None:
        model = self.model = open_dense_model(name, revision, device)
        self.name, self.dim, self.device = model.name, model.dim, model.device

    def to_dict(self) -> dict[str, Any]:
        return {**self.model.to_dict(), "embedder_windows": WINDOWS}

    def embed_regions(self, image: Tensor, masks: Mapping[str, Masks]) -> dict[str, Tensor]:
        height, width = image.shape[:2]
        patch, window = self.model.patch, self.model.side // self.model.patch
        factor = WINDOWS * window / min(height, width)  # the shorter side fills the windows
        size = round(height * factor) * patch, round(width * factor) * patch
        pixels = image.permute(2, 0, 1)[None].float() / 255
        scaled = functional.interpolate(pixels, size, mode="bilinear", antialias=True, align_corners=False)[0]
        tokens = self.model.tokens(scaled)
        pooled = {}
        for level, of_level in masks.items():
            shares = area_shares(of_level, tokens.shape[0], tokens.shape[1]).to(tokens.device)
            rows = [self.model.pool(tokens, chunk).cpu() for chunk in shares.split(_MASKS_AT_ONCE)]
            pooled[level] = torch.cat(rows) if len(of_level) else torch.zeros(0, self.dim)
        return pooled


def area_shares(masks: Masks, rows: int, columns: int) -> Tensor:
    """Return [N, rows, columns] float32, the share of each cell of a grid over the image that a mask covers."""
    down, across = _averages(masks.size[0], rows), _averages(masks.size[1], columns)
    shares = torch.zeros(len(masks), rows, columns)
    for number in range(len(masks)):
        y, x = masks.place(number)
        shares[number] = down[:, y] @ torch.from_numpy(masks.crop(number)).float() @ across[:, x].T
    return shares


def _averages(length: int, cells: int) -> Tensor:
    """Return [cells, length] weights of pixels in the mean of each cell; cells include pixels that they cut."""
    starts = torch.arange(cells) * length // cells
    stops = -((torch.arange(cells) + 1) * -length // cells)
    pixels = torch.arange(length)
    inside = ((pixels >= starts[:, None]) & (pixels < stops[:, None])).float()
    return inside / inside.sum(1, keepdim=True)
