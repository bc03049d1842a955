"""The two parts of an extraction: any segmenter and any embedder with these methods."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from scoup.extract.masks import Masks


class Segmenter(Protocol):
    """A model or rule that cuts an image into masks; the properties are those of ``MaskSettings``."""

    @property
    def cut_last(self) -> bool: ...
    @property
    def drop_hidden(self) -> bool: ...

    def to_dict(self) -> dict[str, Any]:
        """Return the settings that decide the result, as plain values for the manifest."""
        ...

    def segment(self, image: NDArray[np.uint8]) -> dict[str, Masks]:
        """Return level -> masks of an image [H, W, 3], in painting order; levels s, m, l, or default, s, m, l."""
        ...


class _AnyEmbedder(Protocol):
    """The part that all embedders share."""

    @property
    def name(self) -> str: ...  # id of the model, as ``TextEncoder.open`` takes it
    @property
    def dim(self) -> int: ...
    @property
    def device(self) -> torch.device | str: ...  # of the images that it takes

    def to_dict(self) -> dict[str, Any]:
        """Return the settings that decide the result, as plain values for the manifest."""
        ...


class CropEmbedder(_AnyEmbedder, Protocol):
    """A model that turns crops into vectors."""

    @property
    def side(self) -> int: ...  # of the crops, in pixels

    def embed(self, crops: Tensor) -> Tensor:
        """Return [B, D] float32 unit vectors of crops [B, side, side, 3] uint8."""
        ...


@runtime_checkable
class RegionEmbedder(_AnyEmbedder, Protocol):
    """A model that looks at a photograph once and turns all of its regions into vectors."""

    def embed_regions(self, image: Tensor, masks: Mapping[str, Masks]) -> dict[str, Tensor]:
        """Return level -> [N, D] float32 unit vectors of masks over an image [H, W, 3] uint8."""
        ...


Embedder = CropEmbedder | RegionEmbedder
