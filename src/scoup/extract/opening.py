"""Segmenters and embedders by name."""

from __future__ import annotations

import torch

from scoup.extract import felzenszwalb, plain_colors
from scoup.extract.parts import Embedder, Segmenter
from scoup.extract.settings import MaskSettings


def open_segmenter(
    name: str,
    settings: MaskSettings | None = None,
    revision: str | None = None,
    device: torch.device | str = "cpu",
) -> Segmenter:
    """A segmenter.

    Args:
        name: "felzenszwalb" (no model), a short name of ``sam.SHORT_NAMES`` such as "sam-vit-h", or a folder or hub
            id of a SAM, SAM 2 or SAM 3 model that transformers knows.
        settings: of the masks, for models.
        revision: branch, tag or commit of a hub model.

    Raises:
        ScoupError: the package or the weights that it needs are not there.
    """
    if name == felzenszwalb.NAME:
        return felzenszwalb.Felzenszwalb()
    from scoup.extract.automatic import SamSegmenter
    from scoup.extract.sam import open_point_model

    settings = settings or MaskSettings()
    return SamSegmenter(open_point_model(name, revision, device, settings.half), settings)


def open_embedder(name: str, revision: str | None = None, device: torch.device | str = "cpu") -> Embedder:
    """An embedder.

    Args:
        name: "colors" (no model), a folder or hub id of a CLIP or SigLIP model that transformers knows, or
            "open_clip:ARCHITECTURE/PRETRAINED".
        revision: branch, tag or commit of a hub model.

    Raises:
        ScoupError: the package or the weights that it needs are not there.
    """
    if name == plain_colors.NAME:
        return plain_colors.PlainColors()
    from scoup.extract.image_models import open_image_model

    return open_image_model(name, revision, device)
