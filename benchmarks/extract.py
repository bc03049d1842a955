"""Masks of real photographs on a CPU: the share of things with a region, and the time."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor

from benchmarks.data import data_folder
from benchmarks.study import Record, Study
from scoup.base import InputError, spread
from scoup.extract import Masks, mask_settings
from scoup.extract.automatic_masks import automatic_masks
from scoup.models import EncodedImage, PointModel, open_sam
from scoup.scene import LEVELS
from scoup_lab.bench import markdown
from scoup_lab.data.labels import LabelledFrame, read_labels

_FAST = mask_settings("fast")
ALL_POINTS = "32 x 32 points, all"
WAYS = {
    ALL_POINTS: replace(_FAST, by_need=False),
    "fast": _FAST,
    "fast, 20 x 20 points": replace(_FAST, points_per_side=20),
}
"""How MobileSAM is asked, all points first; the preset fast is the default without a GPU."""
IN_32_BITS = "fast, 32 bits"
FOUND = 0.5  # IoU from which a thing has a region, and a region its like
UNLABELLED = 5  # photographs without labels


@dataclass(frozen=True, kw_only=True)
class Extraction(Study):
    """Cut the photographs of the real scene desk into masks, with real weights.

    Things are those marked by hand in the labelled photographs. In photographs without labels, regions are compared
    with those of all 32 x 32 points. The preset fast was chosen on the labelled photographs; the others are evidence
    for it. Seconds are of the processor, all threads together, which other programs disturb least.
    """

    weights: Path
    """MobileSAM's checkpoint."""

    def check(self) -> None:
        if not (data_folder() / "desk").is_dir():
            raise InputError(f"{data_folder() / 'desk'}: there is no such scene; set SCOUP_TEST_DATA")

    def measure(self, known: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        folder = data_folder() / "desk"
        frames = {frame.name: frame for frame in read_labels(folder / "label")}
        paths = sorted((folder / "images_2").glob("*.jpg"))
        unlabelled = spread([path for path in paths if path.stem not in frames], UNLABELLED)
        sam = open_sam(str(self.weights), half=True)
        ways: dict[str, tuple[Any, Any]] = {name: (sam, settings) for name, settings in WAYS.items()}
        ways[IN_32_BITS] = (open_sam(str(self.weights)), _FAST)
        for path in [*(path for path in paths if path.stem in frames), *unlabelled]:
            if all(f"{path.stem}: {name}" in known for name in ways):
                continue
            image, like = read_pixels(path), None
            for name, (model, settings) in ways.items():
                counted = Counted(model)
                start = time.process_time()
                found = automatic_masks(image, counted, settings)
                seconds = time.process_time() - start
                if path in unlabelled and like is None:
                    like = found
                figures = {
                    "points": counted.points,
                    "seconds": seconds,
                    "regions": {level: len(found[level]) for level in LEVELS},
                    "things": _best(found, frames[path.stem]) if like is None else None,
                    "kept": None if like is None else _kept(found, like),
                }
                yield f"{path.stem}: {name}", figures

    def record(self, rows: dict[str, Any]) -> Record:
        names = list(dict.fromkeys(key.split(": ", 1)[1] for key in rows))
        return {
            "rows": [
                _summary(name, [row for key, row in rows.items() if key.endswith(f": {name}")])
                for name in names
            ],
        }

    @staticmethod
    def table(record: Record) -> str:
        """Return one row per way."""
        body = [
            [
                row["way"], f"{row['points']:.0f}", f"{row['regions']:.0f}", f"{row['things']:.3f}",
                f"{row['iou']:.3f}", *(f"{row[level]:.2f}" for level in LEVELS), f"{row['kept']:.3f}",
                f"{row['seconds']:.1f}",
            ]
            for row in record["rows"]
        ]  # fmt: skip
        head = ["", "points", "regions", "things with a region", "IoU of the best"]
        head += [*(f"at level {level}" for level in LEVELS), "regions as with all points", "CPU seconds"]
        return markdown(head, body)


@dataclass
class Counted:
    """A model that counts the points it is asked for."""

    model: PointModel
    points: int = 0

    def to_dict(self) -> dict[str, Any]:
        return self.model.to_dict()

    def encode(self, image: NDArray[np.uint8]) -> EncodedImage:
        return _CountedImage(self.model.encode(image), self)


@dataclass(frozen=True)
class _CountedImage:
    encoded: EncodedImage
    counted: Counted

    def predict(self, points: Tensor) -> tuple[Tensor, Tensor]:
        self.counted.points += len(points)
        return self.encoded.predict(points)

    def without_padding(self, logits: Tensor) -> Tensor:
        return self.encoded.without_padding(logits)

    def upscale(self, logits: Tensor) -> Tensor:
        return self.encoded.upscale(logits)


def read_pixels(path: Path) -> NDArray[np.uint8]:
    return np.asarray(Image.open(path).convert("RGB"))


def _best(found: dict[str, Masks], frame: LabelledFrame) -> dict[str, list[float]]:
    """Return the IoU of each thing's best region by level."""
    truth = np.stack([mask.numpy() for mask in frame.masks.values()])
    return {level: overlaps(truth, found[level].dense()).max(1, initial=0).tolist() for level in LEVELS}


def _kept(found: dict[str, Masks], like: dict[str, Masks]) -> float:
    """Return the share of other regions that have their like, of the same level."""
    best = [
        overlaps(like[level].dense(), found[level].dense()).max(1, initial=0)
        for level in LEVELS
        if len(like[level])
    ]
    return float((np.concatenate(best) >= FOUND).mean())


def overlaps(first: NDArray[np.bool_], second: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return [A, B] IoU of masks [A, H, W] and [B, H, W]."""
    one, other = (masks.reshape(len(masks), -1).astype(np.float32) for masks in (first, second))
    shared = one @ other.T
    return shared / np.maximum(one.sum(1)[:, None] + other.sum(1)[None] - shared, 1)


def _summary(name: str, rows: list[Record]) -> Record:
    things = {
        level: np.concatenate([row["things"][level] for row in rows if row["things"] is not None])
        for level in LEVELS
    }
    best = np.max(list(things.values()), axis=0)
    return {
        "way": name,
        "photographs": len(rows),
        "points": float(np.mean([row["points"] for row in rows])),
        "regions": float(np.mean([sum(row["regions"].values()) for row in rows])),
        "things": float((best >= FOUND).mean()),
        "iou": float(best.mean()),
        **{level: float((things[level] >= FOUND).mean()) for level in LEVELS},
        "kept": float(np.mean([row["kept"] for row in rows if row["kept"] is not None])),
        "seconds": float(np.mean([row["seconds"] for row in rows])),
    }
