"""CLIP and SigLIP image models: crops to unit vectors, through transformers or open_clip."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from scoup.models.hub import ModelRequest, Pretrained, load_open_clip, load_pretrained
from scoup.models.normalization import CLIP, Normalization
from scoup.models.towers import Tower, load_tower, normalization_of

WITHOUT_MODEL = "pass `embedder='colors'`, which needs no model"


@dataclass(eq=False)
class ImageModel:
    """An image tower that embeds crops."""

    name: str  # id of the model, as ``TextEncoder.open`` takes it
    revision: str  # commit it was loaded from, "" if unknown
    encode: Callable[[Tensor], Tensor]  # normalised pixels [B, 3, side, side] in ``dtype`` -> [B, D]
    side: int  # of its images, in pixels
    normalization: Normalization
    device: torch.device | str
    dtype: torch.dtype
    dim: int = field(init=False)

    def __post_init__(self) -> None:
        self.dim = int(self.embed(torch.zeros(1, self.side, self.side, 3, dtype=torch.uint8)).shape[1])

    def to_dict(self) -> dict[str, Any]:
        return {"embedder": self.name, "embedder_revision": self.revision, "embedder_side": self.side}

    def embed(self, crops: Tensor) -> Tensor:
        """Return [B, D] float32 unit vectors of crops [B, side, side, 3] uint8."""
        pixels = crops.to(self.device).permute(0, 3, 1, 2).float() / 255
        with torch.inference_mode():
            features = self.encode(self.normalization(pixels).to(self.dtype))
        return functional.normalize(features.float(), dim=1).clone()


def open_image_model(
    name: str, revision: str | None = None, device: torch.device | str = "cpu"
) -> ImageModel:
    """Load an image model of transformers (folder or hub id); in 16 bits on a GPU, CLIP also on CPUs with bfloat16."""
    request = ModelRequest("embedder", name, WITHOUT_MODEL, revision=revision)

    def load(files: Pretrained) -> tuple[Tower, Normalization, str]:
        tower = load_tower(files, "image")
        return tower, normalization_of(files, tower), files.commit

    tower, normalization, commit = load_pretrained(request, load)
    dtype = usual_dtype(device)
    if tower.kind == "clip" and multiplies_bfloat16(device):
        dtype = torch.bfloat16  # half the time; the cosine with 32 bits is above .999
    tower.model.to(device=device, dtype=dtype)
    return ImageModel(name, commit, tower.image_features, tower.side, normalization, device, dtype)


def open_clip_image_model(
    name: str, revision: str | None = None, device: torch.device | str = "cpu"
) -> ImageModel:
    """Load an image model of open_clip ("open_clip:ARCHITECTURE/PRETRAINED"); in 16 bits on a GPU."""
    dtype = usual_dtype(device)
    model, _ = load_open_clip(ModelRequest("embedder", name, WITHOUT_MODEL, revision=revision), device)
    visual = model.to(dtype).visual
    side = visual.image_size if isinstance(visual.image_size, int) else visual.image_size[0]
    mean, std = getattr(visual, "image_mean", None), getattr(visual, "image_std", None)
    normalization = Normalization(tuple(mean or CLIP.mean), tuple(std or CLIP.std))
    return ImageModel(name, "", model.encode_image, int(side), normalization, device, dtype)


def usual_dtype(device: torch.device | str) -> torch.dtype:
    """Return the type of numbers in which embedders run on a device."""
    return torch.float16 if torch.device(device).type == "cuda" else torch.float32


def multiplies_bfloat16(device: torch.device | str) -> bool:
    """Return whether a device is a CPU that multiplies bfloat16; others take twice the time of 32 bits."""
    is_supported = getattr(torch.cpu, "_is_avx512_bf16_supported", lambda: False)  # a private name of torch
    return torch.device(device).type == "cpu" and is_supported()
