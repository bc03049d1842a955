"""Segmenters and embedders by name, and the tables of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import torch

from scoup.base import Registry
from scoup.extract import felzenszwalb, plain_colors
from scoup.extract.automatic_masks import SamSegmenter
from scoup.extract.dense import DenseEmbedder
from scoup.extract.interfaces import Embedder, Segmenter
from scoup.extract.settings import MaskSettings
from scoup.io import RegionManifest
from scoup.models import (
    ANY_OPEN_CLIP,
    CONCEPTS,
    DENSE_PREFIX,
    GROUP,
    HUB,
    MOBILE_SAM,
    MOBILE_SAM_FILE,
    OPEN_CLIP,
    HubEntry,
    ModelEntry,
    open_image_model,
    open_sam,
)


def _open_sam(
    name: str, revision: str | None, device: torch.device | str, settings: MaskSettings
) -> Segmenter:
    model = open_sam(name, revision, device, settings.half, SEGMENTERS.find(name).model_id(name))
    return SamSegmenter(model, settings)


def _sam(name: str, hub_id: str, help: str, size: str, licence: str = "Apache-2.0") -> ModelEntry:
    file = (f"facebook/{hub_id}", "model.safetensors")
    return ModelEntry(name, _open_sam, size=size, file=file, help=help, licence=licence, extra="models")


_CLIP = "laion/CLIP-ViT-B-16-laion2B-s34B-b88K"
_NAFLEX = "google/siglip2-base-patch16-naflex"
_TIPS = "google/tipsv2-b14"
SEGMENTERS = Registry("segmenter", "scoup.segmenters", ModelEntry, (
    ModelEntry(
        MOBILE_SAM, _open_sam, size="41 MB", seconds=5.1, file=MOBILE_SAM_FILE,
        help="MobileSAM: the default without a GPU (8.5 s without AVX-512 BF16)", licence="Apache-2.0", extra="models",
    ),
    _sam("sam-vit-b", "sam-vit-base", "SAM ViT-B", "375 MB"),
    _sam("sam-vit-l", "sam-vit-large", "SAM ViT-L", "1.2 GB"),
    _sam("sam-vit-h", "sam-vit-huge", "SAM ViT-H, as LangSplat: the default on a GPU", "2.6 GB"),
    _sam("sam2.1-tiny", "sam2.1-hiera-tiny", "SAM 2.1 Hiera-T", "156 MB"),
    _sam("sam2.1-small", "sam2.1-hiera-small", "SAM 2.1 Hiera-S", "184 MB"),
    _sam("sam2.1-base-plus", "sam2.1-hiera-base-plus", "SAM 2.1 Hiera-B+", "323 MB"),
    _sam("sam2.1-large", "sam2.1-hiera-large", "SAM 2.1 Hiera-L", "898 MB"),
    _sam("sam3", "sam3", "the tracker of SAM 3, which takes points", "1.8 GB", "SAM License"),
    HubEntry("FOLDER or hub id", _open_sam, help="any SAM, SAM 2 or SAM 3 of transformers", extra="models"),
    felzenszwalb.ENTRY,
))  # fmt: skip
EMBEDDERS = Registry("embedder", GROUP, ModelEntry, (
    ModelEntry(
        _CLIP, open_image_model, size="598 MB", seconds=47.6, file=(_CLIP, "model.safetensors"),
        help="CLIP ViT-B/16, as LangSplat: the default", licence="MIT", extra="models",
    ),
    ModelEntry(
        f"{DENSE_PREFIX}{_TIPS}", DenseEmbedder, size="784 MB", file=(_TIPS, "model.safetensors"),
        help="TIPSv2 B/14: patches aligned with text; l14, so400m14, g14 are larger", licence="Apache-2.0, CC-BY-4.0",
        extra="models",
    ),
    ModelEntry(
        _NAFLEX, open_image_model, size="1.5 GB", file=(_NAFLEX, "model.safetensors"),
        help="SigLIP 2 NaFlex, on squares of 256 patches", licence="Apache-2.0", extra="models",
    ),
    HUB,
    ModelEntry(
        f"{DENSE_PREFIX}MODEL", DenseEmbedder, seconds=2.4, extra="models",
        help="the same models in one pass per photograph instead of one per region",
    ),
    replace(
        ANY_OPEN_CLIP, name=f"{OPEN_CLIP}MobileCLIP2-S2/dfndr2b", size="398 MB", licence="Apple AMLR (research)",
        help="MobileCLIP2 S2: small and fast; S0, B, S3, S4, too",
    ),
    replace(
        ANY_OPEN_CLIP, name=f"{OPEN_CLIP}PE-Core-B-16/meta", size="1.7 GB", licence="Apache-2.0",
        help="Perception Encoder B/16; PE-Core-L-14-336, PE-Core-bigG-14-448 are larger",
    ),
    ANY_OPEN_CLIP,
    plain_colors.ENTRY,
))  # fmt: skip


def model_tables() -> dict[str, list[dict[str, str]]]:
    """Return the rows of the tables of segmenters, embedders and models with words, for people."""
    tables = {"segmenters": SEGMENTERS, "embedders": EMBEDDERS, "concepts": CONCEPTS}
    return {
        title: [{**one.cells(), "weights": one.weights(), "what it is": one.help} for one in table.values()]
        for title, table in tables.items()
    }


def open_segmenter(
    name: str,
    settings: MaskSettings | None = None,
    revision: str | None = None,
    device: torch.device | str = "cpu",
) -> Segmenter:
    """Open a segmenter of ``SEGMENTERS``, or of the path of MobileSAM's checkpoint (.pt); a hub model at a revision
    (branch, tag or commit)."""
    return SEGMENTERS.find(name).open(name, revision, device, settings or MaskSettings())


def open_embedder(name: str, revision: str | None = None, device: torch.device | str = "cpu") -> Embedder:
    """Open an embedder of ``EMBEDDERS``; a hub model at a revision."""
    return EMBEDDERS.find(name).open(name, revision, device)


def open_pair(
    segmenter: str,
    embedder: str,
    settings: MaskSettings,
    device: torch.device | str = "cpu",
    resumed: Path | None = None,
) -> tuple[Segmenter, Embedder]:
    """Open a segmenter and an embedder; in a folder that is resumed, of the commits it was begun with.

    A hub model that has changed meanwhile would otherwise be another model for the rest of the views.
    """
    manifest = RegionManifest.read(resumed) if resumed is not None and resumed.is_dir() else None
    begun = manifest.settings if manifest is not None else {}

    def revision_of(table: Registry[ModelEntry], name: str) -> str | None:
        # The manifest names a model by its hub id.
        same = begun.get(table.what) in (
            name,
            name.removeprefix(DENSE_PREFIX),
            table.find(name).model_id(name),
        )
        return begun.get(f"{table.what}_revision") or None if same else None

    first, second = revision_of(SEGMENTERS, segmenter), revision_of(EMBEDDERS, embedder)
    return open_segmenter(segmenter, settings, first, device), open_embedder(embedder, second, device)
