"""Segmenters and embedders by name."""

from __future__ import annotations

from pathlib import Path

import torch

from scoup.base.errors import InputError, UnknownNameError
from scoup.extract import felzenszwalb, plain_colors
from scoup.extract.interfaces import Embedder, Segmenter
from scoup.extract.settings import MaskSettings
from scoup.io.regions.manifest import read_manifest


def open_segmenter(
    name: str,
    settings: MaskSettings | None = None,
    revision: str | None = None,
    device: torch.device | str = "cpu",
    with_default: bool = False,
) -> Segmenter:
    """The segmenter of a name.

    Args:
        name: "felzenszwalb" (no model), "mobile-sam" or the path of its checkpoint (.pt), a short name of
            ``sam.SHORT_NAMES`` such as "sam-vit-h", a folder or hub id of a SAM, SAM 2 or SAM 3 model that
            transformers knows, or "onnx:FOLDER" (see ``onnx_sam``).
        settings: of the masks, for models.
        revision: branch, tag or commit of a hub model.
        with_default: also make LangSplat's level "default" (models only).

    Raises:
        ScoupError: the package or the weights that it needs are missing.
    """
    if name == felzenszwalb.NAME:
        if with_default:
            raise InputError(f"{name} has no level default: it does not predict masks from points")
        return felzenszwalb.Felzenszwalb()
    from scoup.extract.automatic_masks import SamSegmenter
    from scoup.models import onnx_sam, sam

    settings = settings or MaskSettings()
    if name.startswith(onnx_sam.PREFIX):
        return SamSegmenter(onnx_sam.open_onnx_sam(name), settings, with_default)
    if not (name in sam.NAMES or "/" in name or name.endswith(".pt") or Path(name).exists()):
        known = (felzenszwalb.NAME, *sam.NAMES, f"{onnx_sam.PREFIX}FOLDER", "OWNER/MODEL of a hub")
        raise UnknownNameError("segmenter", name, known)
    return SamSegmenter(sam.open_sam(name, revision, device, settings.half), settings, with_default)


def open_embedder(name: str, revision: str | None = None, device: torch.device | str = "cpu") -> Embedder:
    """The embedder of a name.

    Args:
        name: "colors" (no model), a folder or hub id of a CLIP or SigLIP model that transformers knows, or
            "open_clip:ARCHITECTURE/PRETRAINED"; or "dense:" and the folder or hub id, for one pass over each
            photograph.
        revision: branch, tag or commit of a hub model.

    Raises:
        ScoupError: the package or the weights that it needs are missing.
    """
    from scoup.extract.dense import DenseEmbedder
    from scoup.models import dense

    if name == plain_colors.NAME:
        return plain_colors.PlainColors(device)
    if name.startswith(dense.PREFIX):
        return DenseEmbedder(dense.open_dense_model(name, revision, device))
    from scoup.models.image import open_image_model

    return open_image_model(name, revision, device)


def open_pair(
    segmenter: str,
    embedder: str,
    settings: MaskSettings,
    revisions: tuple[str | None, str | None] = (None, None),
    device: torch.device | str = "cpu",
    resumed: Path | None = None,
    with_default: bool = False,
) -> tuple[Segmenter, Embedder]:
    """A segmenter and an embedder; where a folder is resumed, of the commits it was begun with.

    A hub model that has changed meanwhile would otherwise be another model for the rest of the views.

    Args:
        revisions: of both, where the user names them.
        resumed: folder that may hold views already.
        with_default: as in ``open_segmenter``.
    """
    manifest = read_manifest(resumed) if resumed is not None and resumed.is_dir() else None
    begun = manifest.settings if manifest is not None else {}

    def revision_of(role: str, name: str, given: str | None) -> str | None:
        same = begun.get(role) in (name, _full_name(name))
        return given or (begun.get(f"{role}_revision") or None if same else None)

    first = revision_of("segmenter", segmenter, revisions[0])
    second = revision_of("embedder", embedder, revisions[1])
    return (
        open_segmenter(segmenter, settings, first, device, with_default),
        open_embedder(embedder, second, device),
    )


def _full_name(name: str) -> str:
    """As the manifest names the model."""
    from scoup.models import dense
    from scoup.models.sam import SHORT_NAMES

    return SHORT_NAMES.get(name, name.removeprefix(dense.PREFIX))
