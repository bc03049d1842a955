"""COCO's JSON of annotated images: masks and boxes of categories (cocodataset.org, "Data format")."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from scoup.base import write_text


@dataclass(frozen=True)
class CocoAnnotations:
    """Annotated images, one added after the other."""

    categories: tuple[str, ...]  # different names, numbered from 1 as COCO does
    images: list[dict[str, Any]] = field(default_factory=list)  # entries of the file, as the next
    annotations: list[dict[str, Any]] = field(default_factory=list)

    def add(self, file_name: str, masks: Sequence[np.ndarray], scores: Sequence[float] | None = None) -> None:
        """Add an image, from a mask [H, W] boolean, and perhaps a score, per category; those without a pixel get no
        annotation."""
        height, width = masks[0].shape
        number = len(self.images) + 1
        self.images.append({"id": number, "file_name": file_name, "width": width, "height": height})
        for category, mask in enumerate(masks, start=1):
            if not mask.any():
                continue
            rows, columns = mask.any(1).nonzero()[0], mask.any(0).nonzero()[0]
            x, y = int(columns[0]), int(rows[0])
            entry = {
                "id": len(self.annotations) + 1,
                "image_id": number,
                "category_id": category,
                "segmentation": {"size": [height, width], "counts": run_lengths(mask)},
                "area": int(mask.sum()),
                "bbox": [x, y, int(columns[-1]) + 1 - x, int(rows[-1]) + 1 - y],
                "iscrowd": 0,
            }
            score = {} if scores is None else {"score": round(scores[category - 1], 4)}
            self.annotations.append(entry | score)

    def write(self, path: str | Path, overwrite: bool = False) -> None:
        """Write the file."""
        content = {
            "images": self.images,
            "annotations": self.annotations,
            "categories": [{"id": number, "name": name} for number, name in enumerate(self.categories, 1)],
        }
        write_text(path, json.dumps(content, separators=(",", ":")), overwrite)


def run_lengths(mask: np.ndarray) -> str:
    """Return a mask [H, W] as COCO's compressed run lengths: down the columns, of pixels outside and inside in turn.

    A length is written as its difference from the one two before it, five bits a character, lowest first; the sixth bit
    says that more follow (``rleToString`` of cocoapi's maskApi.c).
    """
    flat = np.asarray(mask, bool).ravel(order="F")
    ends = np.flatnonzero(flat[1:] != flat[:-1]) + 1
    bounds = np.concatenate([[0], ends, [len(flat)]])
    lengths = np.diff(bounds).tolist()
    if len(flat) and flat[0]:
        lengths = [0, *lengths]  # the first length is of pixels outside
    characters: list[str] = []
    for index, length in enumerate(lengths):
        value = length - lengths[index - 2] if index > 2 else length
        more = True
        while more:
            bits = value & 31
            value >>= 5
            more = value != -1 if bits & 16 else value != 0
            characters.append(chr(48 + (bits | 32 if more else bits)))
    return "".join(characters)
