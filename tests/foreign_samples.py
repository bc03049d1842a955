"""Files of other systems, in their own layouts."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from scoup.scene import SH_C0, Gaussians

CONFIG = """!!python/object:nerfstudio.engine.trainer.TrainerConfig
_target: !!python/name:nerfstudio.engine.trainer.Trainer ''
data: {data}
experiment_name: kitchen
pipeline: !!python/object:nerfstudio.pipelines.base_pipeline.VanillaPipelineConfig
  datamanager: !!python/object:nerfstudio.data.datamanagers.full_images_datamanager.FullImageDatamanagerConfig
    dataparser: !!python/object:nerfstudio.data.dataparsers.{parser}
      data: *id001
"""
PARTS = """&id001 !!python/object/apply:pathlib.PosixPath
{items}"""


def captured(
    gaussians: Gaussians, seed: int = 0, size: int = 8, dim: int = 16, layers: int = 1
) -> tuple[tuple[Any, ...], Tensor, Tensor]:
    """What LangSplatV2's ``GaussianModel.capture(include_feature=True)`` gives, with logits and codebooks."""
    count = len(gaussians)
    random = torch.Generator().manual_seed(seed)
    logits = torch.randn(count, layers * size, generator=random) * 3
    codebooks = torch.randn(layers, size, dim, generator=random)
    colors, opacities = (gaussians.sh[:, :1], gaussians.sh[:, 1:]), torch.logit(gaussians.opacities)[:, None]
    shape = gaussians.scales.log(), gaussians.quats * 2
    parameters = [gaussians.means, *colors, *shape, opacities, logits, codebooks]
    optimizer = {"state": {}, "param_groups": [{"lr": 0.0025, "name": "language_feature", "params": [0]}]}
    entries = (
        gaussians.sh_degree, *(nn.Parameter(parameter.clone()) for parameter in parameters), torch.zeros(count),
        torch.zeros(count, 1), torch.zeros(count, 1), optimizer, np.float64(4.7),
    )  # fmt: skip
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


def some_similarity(seed: int = 3) -> tuple[np.ndarray, float]:
    """[4, 4] rotation and translation, and a scale."""
    generator = np.random.default_rng(seed)
    rotation, _ = np.linalg.qr(generator.normal(size=(3, 3)))
    transform = np.eye(4)
    transform[:3, :3] = rotation * np.sign(np.linalg.det(rotation))
    transform[:3, 3] = generator.normal(size=3)
    return transform, 0.4


def save_splatfacto(gaussians: Gaussians, path: Path, older: bool = False) -> None:
    """What nerfstudio's trainer writes of a step."""
    prefix = "_model." if older else "_model.gauss_params."
    values = {
        "means": gaussians.means, "quats": gaussians.quats * 3, "scales": gaussians.scales.log(),
        "opacities": torch.logit(gaussians.opacities)[:, None],
        "features_dc": gaussians.sh[:, 0] if gaussians.sh_degree else torch.logit(gaussians.sh[:, 0] * SH_C0 + 0.5),
        "features_rest": gaussians.sh[:, 1:],
    }  # fmt: skip
    pipeline = {prefix + name: torch.nn.Parameter(value.clone()) for name, value in values.items()}
    path.parent.mkdir(parents=True, exist_ok=True)
    torch.save(
        {"step": 29999, "pipeline": {**pipeline, "_model.other": torch.zeros(3)}, "optimizers": {}}, path
    )


def save_run(run: Path, data: str, parser: str = "nerfstudio_dataparser.NerfstudioDataParserConfig") -> None:
    """config.yml and dataparser_transforms.json."""
    run.mkdir(parents=True, exist_ok=True)
    items = "".join(
        f"- {part}\n" for part in (["/"] if data.startswith("/") else []) + data.strip("/").split("/")
    )
    (run / "config.yml").write_text(CONFIG.format(data=PARTS.format(items=items), parser=parser))
    transform, scale = some_similarity()
    record = {"transform": transform[:3].tolist(), "scale": scale}
    (run / "dataparser_transforms.json").write_text(json.dumps(record))


def save_results(folder: Path, data: Path, normalise: Any = "true") -> None:
    folder.mkdir(parents=True, exist_ok=True)
    lines = ["data_dir: " + str(data), "data_factor: 4"]
    lines += [] if normalise is None else [f"normalize_world_space: {normalise}"]
    lines += ["strategy: !!python/object:gsplat.strategy.DefaultStrategy", "  refine: 1", ""]
    (folder / "cfg.yml").write_text("\n".join(lines))
