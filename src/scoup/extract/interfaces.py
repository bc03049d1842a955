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
    """Cuts an image into masks.

    Attributes:
        cut_last: as in ``MaskSettings``.
        drop_hidden: as in ``MaskSettings``.
    """

    @property
    def cut_last(self) -> bool: ...
    @property
    def drop_hidden(self) -> bool: ...

    def record(self) -> dict[str, Any]:
        """What decides the result, as plain values for the manifest."""
        ...

    def segment(self, image: NDArray[np.uint8]) -> dict[str, Masks]:
        """Level -> masks of an image [H, W, 3], in painting order; levels s, m, l, or default, s, m, l."""
        ...


class Embeds(Protocol):
    """What all embedders have in common.

    Attributes:
        name: id of the model, as ``TextEncoder.open`` takes it.
        dim: D.
        device: where it wants its images.
    """

    @property
    def name(self) -> str: ...
    @property
    def dim(self) -> int: ...
    @property
    def device(self) -> torch.device | str: ...

    def record(self) -> dict[str, Any]:
        """What decides the result, as plain values for the manifest."""
        ...


class CropEmbedder(Embeds, Protocol):
    """Turns crops into unit vectors.

    Attributes:
        side: of the crops it takes, in pixels.
    """

    @property
    def side(self) -> int: ...

    def embed(self, crops: Tensor) -> Tensor:
        """[B, D] float32 unit vectors of crops [B, side, side, 3] uint8."""
        ...


@runtime_checkable
class RegionEmbedder(Embeds, Protocol):
    """Looks at a photograph once, and turns all of its regions into unit vectors."""

    def embed_regions(self, image: Tensor, masks: Mapping[str, Masks]) -> dict[str, Tensor]:
        """Level -> [N, D] float32 unit vectors of masks over an image [H, W, 3] uint8."""
        ...


Embedder = CropEmbedder | RegionEmbedder
