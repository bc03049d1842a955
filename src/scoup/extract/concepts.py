"""Open-vocabulary detections in photographs, stored for ``build``, which names things by them."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from scoup.base import Part, Progress, ScoupError, no_progress
from scoup.extract.photographs import MAX_HEIGHT, Photograph, Pixels, read_ahead
from scoup.extract.pipeline import ExtractReport
from scoup.io import DetectionStore
from scoup.models import ConceptModel


def extract_concepts(
    photographs: Sequence[Photograph],
    folder: str | Path,
    model: ConceptModel,
    texts: Sequence[str],
    overwrite: bool = False,
    part: Part = Part(),  # noqa: B008 - frozen
    progress: Progress = no_progress,
) -> ExtractReport:
    """Look for texts, without repetitions, in photographs and store where they are: in ``concepts`` beside the regions,
    where ``build`` looks. After an interruption, the same call continues. Other arguments as for ``extract``.

    Raises:
        InputError: the folder contains detections of other texts or of another model.
    """
    settings = {**model.to_dict(), "max_height": MAX_HEIGHT}
    store = DetectionStore.new(Path(folder), texts, settings)
    store.begin(overwrite)
    # Words count anywhere.
    assigned = [replace(item, mask=None, masks_keep="white") for item in part.of(photographs)]
    report, moment = ExtractReport(), time.perf_counter()
    waiting = [item for item in assigned if overwrite or not store.has(item.name, item.digest())]
    report.kept = len(assigned) - len(waiting)
    for done, (item, pixels) in enumerate(read_ahead(waiting), start=report.kept):
        progress("concepts", done, len(assigned))
        if isinstance(pixels, ScoupError):
            report.skipped[item.name] = str(pixels)
            continue
        detections = model.detect(pixels.image, store.texts)
        width, height = pixels.image.shape[1], pixels.image.shape[0]
        stored = (height, width) if pixels.turns % 2 else (width, height)
        boxes = boxes_as_stored(pixels, detections.boxes)
        store.write(item.name, pixels.digest, replace(detections, boxes=boxes, size=stored, masks=None))
        report.made.append(item.name)
        report.regions += len(detections.texts)
    progress("concepts", len(assigned), len(assigned))
    report.add_time("detect", moment)
    return report


def boxes_as_stored(pixels: Pixels, boxes: Tensor) -> Tensor:
    """Return boxes [M, 4] of the upright photograph in the orientation of its file."""
    left, top, right, bottom = boxes.unbind(1)
    height, width = pixels.image.shape[:2]
    if pixels.mirrored:
        left, right = width - right, width - left
    for _ in range(pixels.turns):  # a quarter turn with the clock
        left, top, right, bottom = height - bottom, left, height - top, right
        width, height = height, width
    return torch.stack([left, top, right, bottom], 1)
