"""Segmenters and embedders by name, and the tables of them."""

from __future__ import annotations

from pathlib import Path

import torch

from scoup.base import Registry
from scoup.extract import felzenszwalb
from scoup.extract.automatic_masks import SamSegmenter
from scoup.extract.dense import DenseEmbedder
from scoup.extract.interfaces import Embedder, Segmenter
from scoup.extract.settings import MaskSettings
from scoup.io import RegionManifest
from scoup.models import CONCEPTS, ModelEntry, embedder_table, open_sam, segmenter_table


def _open_sam(
    name: str, revision: str | None, device: torch.device | str, settings: MaskSettings
) -> Segmenter:
    model = open_sam(name, revision, device, settings.half, SEGMENTERS.find(name).model_id(name))
    return SamSegmenter(model, settings)


SEGMENTERS = segmenter_table(_open_sam, felzenszwalb.ENTRY)
EMBEDDERS = embedder_table(DenseEmbedder)


def model_tables() -> dict[str, list[dict[str, str]]]:
    """Return the rows of the tables of segmenters, embedders and models with words, for people."""
    tables = {"segmenters": SEGMENTERS, "embedders": EMBEDDERS, "concepts": CONCEPTS}
    return {title: [entry.cells() for entry in table.values()] for title, table in tables.items()}


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
        same = table.find(name).is_recorded(name, begun.get(table.what))
        return begun.get(f"{table.what}_revision") or None if same else None

    first, second = revision_of(SEGMENTERS, segmenter), revision_of(EMBEDDERS, embedder)
    return open_segmenter(segmenter, settings, first, device), open_embedder(embedder, second, device)
