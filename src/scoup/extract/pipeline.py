"""From photographs to region maps with embeddings: view by view, resumable, in bounded memory."""

from __future__ import annotations

import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from scoup.base import Part, Progress, ScoupError, ScoupWarning, check_output, counted, no_progress, share_of
from scoup.extract.crops import mask_crops
from scoup.extract.interfaces import Embedder, RegionEmbedder, Segmenter
from scoup.extract.masks import Masks, paint
from scoup.extract.overlaps import intersections
from scoup.extract.photographs import MAX_HEIGHT, Photograph, Pixels, find_photographs, read_ahead
from scoup.io import RegionManifest, RegionStore, ViewRegions

BITS = 16  # of a stored embedding number
SAME_REGION = 0.95  # 5 to 12 % of the regions of desk, table-20 and fox; nine of ten with a cosine above .997
USUAL_REGIONS = 100  # of a photograph
LEAST_BYTES = 10_000  # of a view: a photograph of few regions


@dataclass
class ExtractReport:
    """The results of an extraction."""

    made: list[str] = field(default_factory=list)
    """Names of the views made in this run."""
    kept: int = 0
    """Views that existed already."""
    skipped: dict[str, str] = field(default_factory=dict)
    """Name -> why a photograph could not be read."""
    regions: int = 0
    """Of the views made."""
    bytes: int = 0
    """Of the views made."""
    seconds: dict[str, float] = field(default_factory=dict)
    """Stage -> seconds; "decode" is only the waiting for it."""

    def add_time(self, stage: str, since: float) -> float:
        """Add the time since a moment to a stage; return the moment now."""
        now = time.perf_counter()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - since
        return now


def extract(
    photographs: Sequence[Photograph],
    folder: str | Path,
    segmenter: Segmenter,
    embedder: Embedder,
    overwrite: bool = False,
    part: Part = Part(),  # noqa: B008 - frozen
    progress: Progress = no_progress,
    chosen: bool = False,
) -> ExtractReport:
    """Make region maps and embeddings of photographs. After an interruption, the same call continues.

    Args:
        folder: of the results; ``load_regions`` reads it.
        overwrite: make existing views again.
        part: of the photographs to extract; several processes may write the parts of one folder.
        chosen: the photographs were chosen among more: keep their names in the manifest.

    Warns:
        ScoupWarning: photographs were skipped because they could not be read; says how many.
    """
    folder = Path(folder)
    settings = {**segmenter.to_dict(), **embedder.to_dict(), "max_height": MAX_HEIGHT}
    manifest = RegionManifest.of(embedder.name, settings, BITS)
    manifest = replace(manifest, views=tuple(item.name for item in photographs) if chosen else ())
    store = RegionStore.create(folder, manifest, overwrite)
    store.check_names(item.name for item in photographs)
    assigned = part.of(photographs)
    report = ExtractReport()
    waiting = [item for item in assigned if overwrite or not store.has(item.name, item.digest())]
    check_output(store.folder / "regions.json", overwrite=True, least=LEAST_BYTES * len(waiting))
    report.kept = done = len(assigned) - len(waiting)
    progress("regions", done, len(assigned))
    moment = time.perf_counter()
    for item, pixels in read_ahead(waiting):
        moment = report.add_time("decode", moment)
        if isinstance(pixels, ScoupError):
            report.skipped[item.name] = str(pixels)
        else:
            masks = segmenter.segment(pixels.image)
            moment = report.add_time("segment", moment)
            regions = describe_masks(item.name, pixels, masks, segmenter, embedder)
            moment = report.add_time("embed", moment)
            if not report.made:  # not before there is something to write
                store.begin(overwrite)
            report.bytes += store.write(regions, overwrite=True)
            moment = report.add_time("write", moment)
            report.made.append(item.name)
            report.regions += len(regions)
        done += 1
        progress("regions", done, len(assigned))
    _warn_of_skipped(report, len(assigned))
    return report


def lacks_views(folder: Path, scene: Path, images: Path | None, embedder: str) -> bool:
    """Return whether a folder of region features is what an interrupted extraction with this embedder left of a
    scene, or is empty."""
    if not any(folder.iterdir()):
        return True
    manifest = RegionManifest.read(folder)
    if manifest is None or manifest.embedding_model != embedder:
        return False
    names = manifest.views or tuple(item.name for item in find_photographs(scene, images))
    return len(RegionStore.open(folder).views(names)) < len(names)


def crops_minutes(embedder: Embedder, photographs: int) -> float:
    """Return the minutes that embeddings of crops will take, from four of them; 0 for one pass per photograph."""
    if isinstance(embedder, RegionEmbedder):
        return 0.0
    crops = torch.zeros(4, embedder.side, embedder.side, 3, dtype=torch.uint8)
    started = time.perf_counter()
    embedder.embed(crops)
    return (time.perf_counter() - started) / len(crops) * USUAL_REGIONS * photographs / 60


def describe_masks(
    name: str, photograph: Pixels, masks: dict[str, Masks], segmenter: Segmenter, embedder: Embedder
) -> ViewRegions:
    """Return the regions of a photograph: labels in its stored orientation, and the embedding of each mask."""
    labels: dict[str, NDArray[np.int32]] = {}
    visible_masks: dict[str, Masks] = {}
    for level, level_masks in masks.items():
        painted = _painted(level_masks, photograph)
        if segmenter.drop_hidden or photograph.masked is not None:
            visible = np.zeros(len(level_masks) + 1, np.bool_)
            visible[painted + 1] = True
            level_masks = level_masks.select(visible[1:])
            painted = _painted(level_masks, photograph)
        labels[level] = photograph.as_stored(painted)
        visible_masks[level] = level_masks
    vectors = embed_masks(photograph.image, visible_masks, embedder, segmenter.cut_last)
    arrays = {level: rows.numpy() for level, rows in vectors.items()}
    return ViewRegions(name, labels, arrays, photograph.digest)


def embed_masks(
    image: NDArray[np.uint8], masks: dict[str, Masks], embedder: Embedder, cut_last: bool = True
) -> dict[str, Tensor]:
    """Return level -> [N, D] float32 unit vectors of masks over an image [H, W, 3] uint8.

    A mask that an earlier level has, too, gets the vector of that one: the same mask, or, unless the last row and
    column are cut as LangSplat does, one with an IoU above ``SAME_REGION``.
    """
    pixels = torch.from_numpy(image).to(embedder.device)
    if isinstance(embedder, RegionEmbedder):
        return embedder.embed_regions(pixels, masks)
    every = Masks.concatenate((image.shape[0], image.shape[1]), [*masks.values()])
    shared = intersections(every)
    areas = np.diag(shared).copy()
    union = np.maximum(areas[:, None] + areas - shared, 1)
    alike = (shared == union) if cut_last else (shared > SAME_REGION * union)
    np.fill_diagonal(alike, True)  # of masks without a pixel, too
    own, of_own = np.unique(alike.argmax(1) if len(every) else [], return_inverse=True)
    crops = mask_crops(pixels, every.select(own), embedder.side, cut_last)
    rows = [embedder.embed(some).cpu() for some in crops] or [torch.zeros(0, embedder.dim)]
    return dict(zip(masks, torch.cat(rows)[of_own].split([*map(len, masks.values())]), strict=True))


def embed_image(image: NDArray[np.uint8], embedder: Embedder) -> Tensor:
    """Return the unit vector [D] float32 of a whole image [H, W, 3] uint8."""
    whole = Masks.from_dense(np.ones((1, *image.shape[:2]), np.bool_))
    return embed_masks(image, {"m": whole}, embedder)["m"][0]


def _painted(masks: Masks, photograph: Pixels) -> NDArray[np.int32]:
    labels = paint(masks)
    return labels if photograph.masked is None else np.where(photograph.masked, np.int32(-1), labels)


def _warn_of_skipped(report: ExtractReport, total: int) -> None:
    if not report.skipped:
        return
    first = "; ".join(list(report.skipped.values())[:3])
    if len(report.skipped) == total:
        raise ScoupError(f"{share_of(0, total, 'photograph')} could be read: {first}")
    warnings.warn(
        f"skipped {len(report.skipped)} of {counted(total, 'photograph')} that could not be read: {first}",
        ScoupWarning,
        stacklevel=3,
    )
