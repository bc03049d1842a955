"""Mean and standard deviation of the images that a model was trained on."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class Normalization:
    """Mean and standard deviation per channel of RGB 0..1; a call normalises pixels [..., 3, H, W]."""

    mean: tuple[float, ...]
    std: tuple[float, ...]

    def __call__(self, pixels: Tensor) -> Tensor:
        mean, std = (torch.tensor(item, device=pixels.device).view(3, 1, 1) for item in (self.mean, self.std))
        return (pixels - mean) / std


IMAGENET = Normalization((0.485, 0.456, 0.406), (0.229, 0.224, 0.225))
CLIP = Normalization((0.48145466, 0.4578275, 0.40821073), (0.26862954, 0.26130258, 0.27577711))
HALF = Normalization((0.5, 0.5, 0.5), (0.5, 0.5, 0.5))
PLAIN = Normalization((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
