"""Files of other systems, in their own layouts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from scoup.scene.gaussians import Gaussians


def captured(
    gaussians: Gaussians, seed: int = 0, size: int = 8, dim: int = 16, layers: int = 1
) -> tuple[tuple[Any, ...], Tensor, Tensor]:
    """What LangSplatV2's ``GaussianModel.capture(include_feature=True)`` gives, with logits and codebooks."""
    count = len(gaussians)
    random = torch.Generator().manual_seed(seed)
    logits = torch.randn(count, layers * size, generator=random) * 3
    codebooks = torch.randn(layers, size, dim, generator=random)
    parameters = [
        gaussians.means,
        gaussians.sh[:, :1],
        gaussians.sh[:, 1:],
        gaussians.scales.log(),
        gaussians.quats * 2,
        torch.logit(gaussians.opacities)[:, None],
        logits,
        codebooks,
    ]
    optimizer = {"state": {}, "param_groups": [{"lr": 0.0025, "name": "language_feature", "params": [0]}]}
    entries = (
        gaussians.sh_degree,
        *(nn.Parameter(parameter.clone()) for parameter in parameters),
        torch.zeros(count),
        torch.zeros(count, 1),
        torch.zeros(count, 1),
        optimizer,
        np.float64(4.7),
    )
    return entries, logits, codebooks


def save_langsplatv2(gaussians: Gaussians, path: Path, seed: int = 0, **sizes: int) -> tuple[Tensor, Tensor]:
    """A checkpoint; its logits [N, V L] and codebooks [V, L, D]."""
    path.parent.mkdir(parents=True, exist_ok=True)
    entries, logits, codebooks = captured(gaussians, seed, **sizes)
    torch.save((entries, 10000), path)
    return logits, codebooks


class LangSplatAutoencoder(nn.Module):
    """As in LangSplat's autoencoder/model.py."""

    def __init__(self, encoder_dims: list[int], decoder_dims: list[int], dim: int = 512) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        for number, size in enumerate(encoder_dims):
            if number:
                layers += [nn.BatchNorm1d(encoder_dims[number - 1]), nn.ReLU()]
            layers.append(nn.Linear(encoder_dims[number - 1] if number else dim, size))
        self.encoder = nn.ModuleList(layers)
        layers = []
        for number, size in enumerate(decoder_dims):
            if number:
                layers.append(nn.ReLU())
            layers.append(nn.Linear(decoder_dims[number - 1] if number else encoder_dims[-1], size))
        self.decoder = nn.ModuleList(layers)

    def encode(self, rows: Tensor) -> Tensor:
        for layer in self.encoder:
            rows = layer(rows)
        return rows / rows.norm(dim=-1, keepdim=True)

    def decode(self, rows: Tensor) -> Tensor:
        for layer in self.decoder:
            rows = layer(rows)
        return rows / rows.norm(dim=-1, keepdim=True)
