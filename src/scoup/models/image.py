"""CLIP and SigLIP image models: crops to unit vectors, through transformers or open_clip."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from scoup.models.hub import OPEN_CLIP, ModelRequest, Pretrained, load_open_clip, load_pretrained
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
    """Load an image model (folder, hub id or "open_clip:ARCHITECTURE/PRETRAINED"); in 16 bits on a GPU."""
    request = ModelRequest("embedder", name, WITHOUT_MODEL, revision=revision)
    dtype = torch.float16 if torch.device(device).type == "cuda" else torch.float32
    if name.startswith(OPEN_CLIP):
        model, _ = load_open_clip(request, device)
        visual = model.to(dtype).visual
        side = visual.image_size if isinstance(visual.image_size, int) else visual.image_size[0]
        mean, std = getattr(visual, "image_mean", None), getattr(visual, "image_std", None)
        normalization = Normalization(tuple(mean or CLIP.mean), tuple(std or CLIP.std))
        return ImageModel(name, "", model.encode_image, int(side), normalization, device, dtype)

    def load(files: Pretrained) -> tuple[Tower, Normalization, str]:
        tower = load_tower(files, "image")
        return tower, normalization_of(files, tower), files.commit

    tower, normalization, commit = load_pretrained(request, load)
    tower.model.to(device=device, dtype=dtype)
    side = int(tower.config.image_size)

    def encode(pixels: Tensor) -> Tensor:
        return tower.features(pixel_values=pixels)

    return ImageModel(name, commit, encode, side, normalization, device, dtype)
