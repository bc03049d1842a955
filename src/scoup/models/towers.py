"""The text and image towers of CLIP, SigLIP and TIPS models, loaded through transformers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import torch
from torch import Tensor

from scoup.base import ScoupError
from scoup.models.hub import Pretrained
from scoup.models.normalization import CLIP, HALF, PLAIN, Normalization

Modality = Literal["text", "image"]
Kind = Literal["clip", "siglip", "naflex", "tips"]
# Others are CLIP's, or have SigLIP's interface.
_KINDS: dict[str, Kind] = {"siglip2": "naflex", "tipsv2": "tips"}
_USUAL = {"clip": CLIP, "tips": PLAIN}


@dataclass(frozen=True, eq=False)
class Tower:
    """One half of a CLIP, SigLIP or TIPS model."""

    modality: Modality
    kind: Kind
    model: Any  # of transformers
    config: Any  # of this tower

    @property
    def side(self) -> int:
        """Side of an image, in pixels. NaFlex takes any shape; its positions were learned on a square."""
        if self.kind == "naflex":
            return int(self.config.num_patches**0.5) * int(self.config.patch_size)
        return int(self.config.image_size)

    def image_features(self, pixels: Tensor) -> Tensor:
        """Return [B, D] features of normalised pixels [B, 3, side, side], not normalised."""
        if self.kind != "naflex":
            return self.features(pixel_values=pixels)
        patches, shapes = as_patches(pixels, self.config.patch_size)
        mask = torch.ones(patches.shape[:2], dtype=torch.int32, device=pixels.device)
        return self.features(pixel_values=patches, pixel_attention_mask=mask, spatial_shapes=shapes)

    def features(self, **inputs: Tensor) -> Tensor:
        """Return [B, D] features of token ids or pixels, not normalised."""
        with torch.inference_mode():
            if self.kind == "clip":
                return getattr(self.model(**inputs), f"{self.modality}_embeds").clone()
            features = getattr(self.model, f"get_{self.modality}_features")(**inputs)
            return getattr(features, "pooler_output", features).clone()  # transformers 5 returns an object


def as_patches(pixels: Tensor, patch: int) -> tuple[Tensor, Tensor]:
    """Return images [B, 3, h, w] as NaFlex takes them: patches [B, T, patch * patch * 3], row by row, and shapes [B, 2]
    in patches."""
    # [B, 3, h / patch, w / patch, patch, patch]
    rows = pixels.unfold(2, patch, patch).unfold(3, patch, patch)
    shapes = torch.tensor([rows.shape[2:4]] * len(pixels), device=pixels.device)
    return rows.permute(0, 2, 3, 4, 5, 1).flatten(3).flatten(1, 2), shapes


def load_tower(files: Pretrained, modality: Modality) -> Tower:
    """Load the tower of a model; for CLIP only its weights are read."""
    config = files.config
    half = "text" if modality == "text" else "vision"
    of_half = getattr(config, f"{half}_config", config)
    if config.model_type in ("clip", f"clip_{half}_model"):
        kind = getattr(files.transformers, f"CLIP{half.capitalize()}ModelWithProjection")
        # The size of the projection is written twice, and only the outer one is always right.
        of_half.projection_dim = config.projection_dim
        return Tower(modality, "clip", files.model(kind, config=of_half), of_half)
    model = files.model(files.transformers.AutoModel, config=config)
    if not hasattr(model, f"get_{modality}_features"):
        raise ScoupError(
            f"{config.model_type!r} models have no {modality} features; use CLIP, SigLIP or TIPSv2"
        )
    return Tower(modality, _KINDS.get(config.model_type, "siglip"), model, of_half)


def normalization_of(files: Pretrained, tower: Tower) -> Normalization:
    """Return the normalisation of a tower's images: of the model's files, else the usual one of its kind."""
    return files.normalization() or _USUAL.get(tower.kind, HALF)
