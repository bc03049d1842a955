"""Segmenters and embedders by name, and the table of them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import torch

from scoup.base.errors import InputError, UnknownNameError
from scoup.extract import felzenszwalb, plain_colors
from scoup.extract.interfaces import Embedder, Segmenter
from scoup.extract.settings import MaskSettings
from scoup.io.regions.manifest import read_manifest
from scoup.models import dense, mobile_sam, onnx_dense, onnx_sam, sam
from scoup.models.hub import ONNX, OPEN_CLIP, is_cached


@dataclass(frozen=True)
class Choice:
    """A row of the table of segmenters and embedders."""

    name: str
    what: str
    size: str = "-"  # of the weights in 32 bits
    licence: str = "-"  # of the weights, or of the package where there are none
    seconds: float | None = (
        None  # of a CPU per photograph: docs/benchmarks/extract.json (preset fast), embed.json; None: not measured
    )
    extra: str = ""  # of scoup, which brings the packages that it needs
    file: tuple[str, str] | None = (
        None  # hub id, and the file of the weights; None where the user names the weights
    )

    def cells(self) -> dict[str, str]:
        """Return column -> text, of all but ``what`` and ``weights``."""
        return {
            "name": self.name,
            "size": self.size,
            "licence": self.licence,
            "CPU seconds": "-" if self.seconds is None else f"{self.seconds:.1f}",
            "needs": f"scoup[{self.extra}]" if self.extra else "-",
        }

    def weights(self) -> str:
        """Return "here" or "not here" for weights of a hub, "-" where there are none or the user names them."""
        if self.file is None:
            return "-"
        return "here" if is_cached(*self.file) else "not here"


def _sam(name: str, what: str, size: str, licence: str = "Apache-2.0") -> Choice:
    file = (sam.SHORT_NAMES[name], "model.safetensors")
    return Choice(name, what, size, licence, None, "models", file)


_CLIP = "laion/CLIP-ViT-B-16-laion2B-s34B-b88K"
SEGMENTERS = (
    Choice(
        sam.MOBILE_SAM, "MobileSAM: the default without a GPU", "41 MB", "Apache-2.0", 10.6, "models",
        (mobile_sam.HUB_ID, mobile_sam.FILE),
    ),
    _sam("sam-vit-b", "SAM ViT-B", "375 MB"),
    _sam("sam-vit-l", "SAM ViT-L", "1.2 GB"),
    _sam("sam-vit-h", "SAM ViT-H, as LangSplat: the default on a GPU", "2.6 GB"),
    _sam("sam2.1-tiny", "SAM 2.1 Hiera-T", "156 MB"),
    _sam("sam2.1-small", "SAM 2.1 Hiera-S", "184 MB"),
    _sam("sam2.1-base-plus", "SAM 2.1 Hiera-B+", "323 MB"),
    _sam("sam2.1-large", "SAM 2.1 Hiera-L", "898 MB"),
    _sam("sam3", "the tracker of SAM 3, which takes points", "1.8 GB", "SAM License"),
    Choice("FOLDER or hub id", "any SAM, SAM 2 or SAM 3 of transformers", extra="models"),
    Choice(
        f"{ONNX}FOLDER", "SAM or SAM 2 exported to ONNX, on the CPU (seconds: SAM 2 tiny)", seconds=45.7,
        extra="onnx",
    ),
    Choice(
        felzenszwalb.NAME, "no model: regions of even colour at three scales", licence="BSD-3-Clause",
        extra="segment",
    ),
)  # fmt: skip
EMBEDDERS = (
    Choice(
        _CLIP, "CLIP ViT-B/16, as LangSplat: the default", "598 MB", "MIT", 47.6, "models",
        (_CLIP, "model.safetensors"),
    ),
    Choice("FOLDER or hub id", "any CLIP or SigLIP of transformers", extra="models"),
    Choice(
        f"{dense.PREFIX}MODEL", "the same models in one pass per photograph instead of one per region", seconds=2.4,
        extra="models",
    ),
    Choice(
        f"{dense.PREFIX}{ONNX}FILE", "a dense encoder exported to ONNX (RADIO, dino.txt), on the CPU",
        extra="onnx",
    ),
    Choice(f"{OPEN_CLIP}ARCHITECTURE/PRETRAINED", "open_clip", extra="open-clip"),
    Choice(plain_colors.NAME, "no model: colours and edges of a crop; a field of it cannot be queried by text"),
)  # fmt: skip


def open_segmenter(
    name: str,
    settings: MaskSettings | None = None,
    revision: str | None = None,
    device: torch.device | str = "cpu",
    with_default: bool = False,
) -> Segmenter:
    """Open a segmenter by name.

    Args:
        name: of ``SEGMENTERS``, or the path of MobileSAM's checkpoint (.pt).
        settings: of the masks, for models.
        revision: branch, tag or commit of a hub model.
        with_default: also make LangSplat's level "default" (models only).
    """
    if name == felzenszwalb.NAME:
        if with_default:
            raise InputError(f"{name} has no level default: it does not predict masks from points")
        return felzenszwalb.Felzenszwalb()
    from scoup.extract.automatic_masks import SamSegmenter

    settings = settings or MaskSettings()
    if name.startswith(ONNX):
        return SamSegmenter(onnx_sam.open_onnx_sam(name), settings, with_default)
    if not (name in sam.NAMES or "/" in name or name.endswith(".pt") or Path(name).exists()):
        known = (felzenszwalb.NAME, *sam.NAMES, f"{ONNX}FOLDER", "OWNER/MODEL of a hub")
        raise UnknownNameError("segmenter", name, known)
    return SamSegmenter(sam.open_sam(name, revision, device, settings.half), settings, with_default)


def open_embedder(name: str, revision: str | None = None, device: torch.device | str = "cpu") -> Embedder:
    """Open an embedder by name.

    Args:
        name: of ``EMBEDDERS``.
        revision: branch, tag or commit of a hub model.
    """
    if name == plain_colors.NAME:
        return plain_colors.PlainColors(device)
    if name.startswith(dense.PREFIX):
        from scoup.extract.dense import DenseEmbedder

        model = name.removeprefix(dense.PREFIX)
        if model.startswith(ONNX):
            return DenseEmbedder(onnx_dense.open_onnx_dense(model))
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
    """Open a segmenter and an embedder; in a folder that is resumed, of the commits it was begun with.

    A hub model that has changed meanwhile would otherwise be another model for the rest of the views.

    Args:
        revisions: of both, where the user names them.
        resumed: folder that may contain views already.
    """
    manifest = read_manifest(resumed) if resumed is not None and resumed.is_dir() else None
    begun = manifest.settings if manifest is not None else {}

    def revision_of(role: str, name: str, given: str | None) -> str | None:
        # The manifest names a model by its hub id.
        same = begun.get(role) in (name, sam.SHORT_NAMES.get(name, name.removeprefix(dense.PREFIX)))
        return given or (begun.get(f"{role}_revision") or None if same else None)

    first = revision_of("segmenter", segmenter, revisions[0])
    second = revision_of("embedder", embedder, revisions[1])
    return (
        open_segmenter(segmenter, settings, first, device, with_default),
        open_embedder(embedder, second, device),
    )
