"""Embeddings without a model: colours and edges of a crop. Text cannot be compared with them."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from scoup.models.entry import ModelEntry

COLORS = "colors"
_BINS = 4  # a side of the colour cube
_DIRECTIONS = 8
_SIDE = 64


class PlainColors:
    """The share of each colour (4 x 4 x 4 bins, softly assigned) and of each direction of edges.

    Regions of similar appearance get similar vectors, so that coding, voting and the tools run without a model. No text
    encoder shares this space: a field built from it cannot be queried in words.
    """

    name = COLORS
    dim = _BINS**3 + _DIRECTIONS
    side = _SIDE

    def __init__(self, device: torch.device | str = "cpu") -> None:
        self.device = device

    def to_dict(self) -> dict[str, Any]:
        return {"embedder": COLORS, "bins": _BINS, "directions": _DIRECTIONS}

    def embed(self, crops: Tensor) -> Tensor:
        """See ``CropEmbedder``; black pixels do not count."""
        values = crops.float()
        inside = (crops > 0).any(-1).float().flatten(1)  # [B, P]
        position = (values.flatten(1, 2) / 255 * (_BINS - 1)).clamp(0, _BINS - 1)  # [B, P, 3]
        low = position.floor().clamp(max=_BINS - 2).long()
        share = position - low
        colors = torch.zeros(len(crops), _BINS**3, device=crops.device)
        for corner in range(8):
            steps = torch.tensor([corner >> 2 & 1, corner >> 1 & 1, corner & 1], device=crops.device)
            weight = torch.where(steps == 1, share, 1 - share).prod(-1) * inside
            bin_of = ((low + steps) * torch.tensor([_BINS**2, _BINS, 1], device=crops.device)).sum(-1)
            colors.scatter_add_(1, bin_of, weight)
        grey = values.mean(-1)
        across = grey[:, 1:-1, 2:] - grey[:, 1:-1, :-2]
        down = grey[:, 2:, 1:-1] - grey[:, :-2, 1:-1]
        angle = torch.atan2(down, across) % torch.pi
        direction = (angle / torch.pi * _DIRECTIONS).long().clamp(max=_DIRECTIONS - 1)
        strength = torch.hypot(across, down) * inside.view_as(grey)[:, 1:-1, 1:-1]
        edges = torch.zeros(len(crops), _DIRECTIONS, device=crops.device)
        edges.scatter_add_(1, direction.flatten(1), strength.flatten(1))
        parts = (functional.normalize(colors, dim=1), 0.3 * functional.normalize(edges, dim=1))
        return functional.normalize(torch.cat(parts, dim=1), dim=1)


PLAIN_COLORS = ModelEntry(
    COLORS,
    lambda name, revision, device: PlainColors(device),
    help="no model: colours and edges of a crop; a field of it cannot be queried by text",
)
