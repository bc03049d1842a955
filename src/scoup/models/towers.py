"""The text and image towers of CLIP and SigLIP models, loaded through transformers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import torch
from torch import Tensor

from scoup.base.errors import ScoupError
from scoup.models.hub import Pretrained
from scoup.models.normalization import CLIP, HALF, Normalization

Modality = Literal["text", "image"]


@dataclass(frozen=True, eq=False)
class Tower:
    """One half of a CLIP or SigLIP model."""

    modality: Modality
    is_clip: bool  # otherwise SigLIP or a model with the same interface
    model: Any  # of transformers
    config: Any  # of this tower

    def features(self, **inputs: Tensor) -> Tensor:
        """Return [B, D] features of token ids or pixels, not normalised."""
        with torch.inference_mode():
            if self.is_clip:
                return getattr(self.model(**inputs), f"{self.modality}_embeds").clone()
            features = getattr(self.model, f"get_{self.modality}_features")(**inputs)
            return getattr(features, "pooler_output", features).clone()  # transformers 5 returns an object


def load_tower(files: Pretrained, modality: Modality) -> Tower:
    """Load the tower of a model; for CLIP only its weights are read."""
    config = files.config
    half = "text" if modality == "text" else "vision"
    of_half = getattr(config, f"{half}_config", config)
    if config.model_type in ("clip", f"clip_{half}_model"):
        kind = getattr(files.transformers, f"CLIP{half.capitalize()}ModelWithProjection")
        # The size of the projection is written twice, and only the outer one is always right.
        of_half.projection_dim = config.projection_dim
        return Tower(modality, True, files.model(kind, config=of_half), of_half)
    model = files.model(files.transformers.AutoModel, config=config)
    if not hasattr(model, f"get_{modality}_features"):
        raise ScoupError(f"{config.model_type!r} models have no {modality} features; use CLIP or SigLIP")
    if modality == "image" and not hasattr(of_half, "image_size"):  # SigLIP 2 NaFlex
        raise ScoupError(
            f"{config.model_type!r} models take images of any shape, which is not supported; use one of a fixed "
            "size, such as google/siglip2-base-patch16-224"
        )
    return Tower(modality, False, model, of_half)


def normalization_of(files: Pretrained, tower: Tower) -> Normalization:
    """Return the normalisation of a tower's images: of the model's files, else the usual one of its kind."""
    return files.normalization() or (CLIP if tower.is_clip else HALF)
