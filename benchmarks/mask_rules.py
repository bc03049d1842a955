"""Variants of the rules over masks, on real photographs: what becomes of marked things, and of instances."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

import scoup
from benchmarks.data import data_folder
from benchmarks.extract import FOUND, read_pixels
from benchmarks.mask_instances import Labels, instances
from benchmarks.study import Record, Study
from scoup.base.counts import spread
from scoup.base.errors import InputError
from scoup.extract import Masks, MaskSettings, mask_settings, paint
from scoup.extract.automatic_masks import automatic_masks
from scoup.extract.grids import point_grid
from scoup.extract.overlaps import keep_by_boxes, keep_by_masks
from scoup.models.sam import EncodedImage, PointModel, open_sam
from scoup.scene.regions import LEVELS
from scoup_lab.bench import markdown
from scoup_lab.data.labels import LabelledFrame, match_frames, read_labels
from scoup_lab.evaluate.metrics import bootstrap_interval

FATES = ("swallowed", "split", "missing", "mixed")
"""Of a thing without a region: most of it lies in one region that is mostly something else; most of it lies in regions
that are mostly it; most of it lies in no region; anything else."""
SIZES = (0.005, 0.04)  # shares of the image up to which a mask is of level s, of level m
BASE = "fast"

_FAST = mask_settings("fast")


@dataclass(frozen=True)
class Rule:
    """A variant of the preset ``fast``."""

    settings: MaskSettings = _FAST
    arrange: Callable[[dict[str, Masks], MaskSettings], dict[str, Masks]] = lambda found, _: found
    with_default: bool = False
    best_of_point: bool = False  # all three masks of a point pass if the best of them does


def by_size(found: dict[str, Masks], settings: MaskSettings) -> dict[str, Masks]:
    """Assign levels by area, and suppress duplicates again."""
    size = next(iter(found.values())).size
    masks = Masks.concatenate(size, list(found.values()))
    level = np.searchsorted(np.array(SIZES) * size[0] * size[1], masks.areas())
    result = {}
    for number, name in enumerate(LEVELS):
        mine = masks.select(level == number)
        mine = mine.select(keep_by_boxes(mine.corners(), mine.predicted_iou, settings.box_overlap))
        scores = mine.stability.astype(np.float64) * mine.predicted_iou
        rule = (settings.mask_overlap, settings.least_score, settings.inside, settings.covered)
        result[name] = mine.select(keep_by_masks(mine, scores, *rule))
    return result


def small_on_top(found: dict[str, Masks], _: MaskSettings) -> dict[str, Masks]:
    """Paint small masks over large ones."""
    return {name: masks.select(np.argsort(-masks.areas(), kind="stable")) for name, masks in found.items()}


RULES = {
    BASE: Rule(),
    "all points": Rule(replace(_FAST, skip_covered=False)),
    "with default": Rule(with_default=True),
    "overlaps up to 0.5": Rule(replace(_FAST, box_overlap=0.5, mask_overlap=0.5)),
    "overlaps up to 0.9": Rule(replace(_FAST, box_overlap=0.9, mask_overlap=0.9)),
    "three masks per point": Rule(
        replace(_FAST, stability=0.0, least_score=0.0), best_of_point=True
    ),
    "parts kept, on top": Rule(replace(_FAST, inside=2.0), small_on_top),
    "level by size": Rule(arrange=by_size),
}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class MaskRules(Study):
    """Try variants of the rules over MobileSAM's masks on the real scene desk.

    Every photograph is decoded once, at all 32 x 32 points; each variant chooses among these masks. Regions are those
    that a build reads: painted, one per pixel and level. Variants are chosen on every second labelled photograph, the
    others are held out. Instances are merged from regions alone, without embeddings: for each name the thing, or the
    union of things, that fits the marked object best over all views, which no query can know.
    """

    weights: Path
    """MobileSAM's checkpoint."""
    further: int = 4
    """Photographs without labels, for instances."""

    def check(self) -> None:
        if not (data_folder() / "desk").is_dir():
            raise InputError(f"{data_folder() / 'desk'}: there is no such scene; set SCOUP_TEST_DATA")

    def measure(self, known: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        folder, sam = data_folder() / "desk", open_sam(str(self.weights))
        cameras = scoup.load_cameras(folder)
        labels = {frame.name: frame for frame in read_labels(folder / "label")}
        paths = sorted((folder / "images_2").glob("*.jpg"))
        further = spread([path for path in paths if path.stem not in labels], self.further)
        maps: dict[str, dict[str, dict[str, Labels]]] = {name: {} for name in RULES}
        for path in sorted([*(path for path in paths if path.stem in labels), *further]):
            image = read_pixels(path)
            decoded = Decoded(sam, image)
            for name, rule in RULES.items():
                painted, points = cut(image, decoded, rule)
                maps[name][cameras[path.stem].name] = painted
                if path.stem in labels:
                    yield (
                        f"{name}/{path.stem}",
                        {
                            "points": points,
                            "regions": {level: int(of.max()) + 1 for level, of in painted.items()},
                            "things": fates(painted, labels[path.stem]),
                        },
                    )
        gaussians = scoup.load_gaussians(folder / "point_cloud.splat")
        frames = [
            (frame.resized(camera.width, camera.height), camera)
            for frame, camera in match_frames(list(labels.values()), cameras)
        ]
        for name, of_views in maps.items():
            yield f"{name}/instances", instances(gaussians, cameras, of_views, frames)

    def record(self, rows: dict[str, Any]) -> Record:
        frames = sorted({key.split("/")[1] for key in rows} - {"instances"})
        halves = {"chosen on": frames[::2], "held out": frames[1::2]}
        return {
            "photographs": halves,
            "rows": [
                {"rule": rule, "half": half, **_summary(rows, rule, names)}
                for half, names in halves.items()
                for rule in RULES
            ],
        }

    @staticmethod
    def table(record: Record) -> str:
        """Return one row per rule, of the photographs that are held out."""
        body = []
        for row in record["rows"]:
            if row["half"] == "held out":
                cells = [
                    " / ".join(f"{row[key][level]:.2f}" for level in LEVELS) for key in ("found", *FATES[:3])
                ]
                signed = [
                    "{:+.3f} [{:+.3f}, {:+.3f}]".format(*row["differences"][key]) for key in ("best", "thing")
                ]
                body.append([
                    row["rule"], f"{row['points']:.0f}", f"{row['regions']:.0f}", f"{row['any']:.3f}",
                    f"{row['best']:.3f}", *cells, f"{row['thing']:.3f}", f"{row['union']:.3f}", *signed,
                ])  # fmt: skip
        head = [
            "rule",
            "points",
            "regions",
            "things with a region",
            "IoU of the best",
            "with one at s / m / l",
        ]
        head += [*FATES[:3], "best thing", "best union of things", "best region - fast", "best thing - fast"]
        return markdown(head, body)


class Decoded:
    """A ``PointModel`` of one image that answers points of the grid from memory."""

    def __init__(self, model: PointModel, image: NDArray[np.uint8]) -> None:
        self.model, self.best_of_point, self.asked = model, False, 0  # ``asked``: points
        self.encoded: EncodedImage = model.encode(image)
        grid = point_grid(_FAST.points_per_side)
        size = torch.tensor([image.shape[1], image.shape[0]])
        parts = [self.encoded.predict(part * size) for part in torch.from_numpy(grid).split(64)]
        self.logits, self.iou = (torch.cat(each) for each in zip(*parts, strict=True))
        self.size = size

    def record(self) -> dict[str, Any]:
        return self.model.record()

    def encode(self, image: NDArray[np.uint8]) -> EncodedImage:
        return self

    def predict(self, points: Tensor) -> tuple[Tensor, Tensor]:
        side = _FAST.points_per_side
        columns, rows = (points / self.size * side).long().T
        chosen = rows * side + columns
        self.asked += len(chosen)
        iou = self.iou[chosen]
        if self.best_of_point:
            iou = iou.amax(1, keepdim=True).expand_as(iou)
        return self.logits[chosen], iou

    def without_padding(self, logits: Tensor) -> Tensor:
        return self.encoded.without_padding(logits)

    def upscale(self, logits: Tensor) -> Tensor:
        return self.encoded.upscale(logits)


def cut(image: NDArray[np.uint8], decoded: Decoded, rule: Rule) -> tuple[dict[str, Labels], int]:
    """Return level -> region of each pixel, -1 for none, as an extraction writes it; and the points asked."""
    decoded.asked, decoded.best_of_point = 0, rule.best_of_point
    found = rule.arrange(automatic_masks(image, decoded, rule.settings, rule.with_default), rule.settings)
    painted = {}
    for level in (*LEVELS, *(found.keys() - set(LEVELS))):
        numbers = paint(found[level])
        painted[level] = (np.unique(np.append(-1, numbers), return_inverse=True)[1][1:] - 1).reshape(
            numbers.shape
        )
    return {level: numbers.astype(np.int16) for level, numbers in painted.items()}, decoded.asked


def fates(painted: Mapping[str, Labels], frame: LabelledFrame) -> Record:
    """Return name -> level -> IoU of the best region, and what became of a thing without one."""
    return {
        name: {level: fate(labels, mask.numpy())[1:] for level, labels in painted.items()}
        for name, mask in frame.masks.items()
    }


def fate(labels: NDArray[np.signedinteger], truth: NDArray[np.bool_]) -> tuple[int, float, str]:
    """Return the region of labels [H, W] with the largest IoU with a thing, the IoU, and "found" or its fate."""
    sizes = np.bincount(labels.ravel() + 1, minlength=2)
    inside = np.bincount(labels[truth] + 1, minlength=len(sizes))
    whole, none = int(truth.sum()), int(inside[0])
    sizes, inside = sizes[1:], inside[1:]
    ious = inside / np.maximum(sizes + whole - inside, 1)
    number, largest = int(ious.argmax()), int(inside.argmax())
    mostly = 2 * inside >= sizes
    if ious[number] >= FOUND:
        became = "found"
    elif none > whole / 2:
        became = "missing"
    elif 2 * inside[largest] >= whole and not mostly[largest]:
        became = "swallowed"
    else:
        became = "split" if 2 * inside[mostly].sum() >= whole else "mixed"
    return number, float(ious[number]), became


def _summary(rows: dict[str, Any], rule: str, frames: list[str]) -> Record:
    """Return means over the things of some photographs, and differences from the preset with their intervals."""
    of = [rows[f"{rule}/{frame}"] for frame in frames]
    things = [thing for row in of for thing in row["things"].values()]
    pairs = _pairs(rows, rule, frames)
    base = _pairs(rows, BASE, frames)
    names = [name for frame in frames for name in rows[f"{rule}/{frame}"]["things"]]
    fate = {
        kind: {level: float(np.mean([thing[level][1] == kind for thing in things])) for level in things[0]}
        for kind in ("found", *FATES)
    }
    return {
        "points": float(np.mean([row["points"] for row in of])),
        "regions": float(np.mean([sum(row["regions"].values()) for row in of])),
        "any": float(np.mean(pairs["best"] >= FOUND)),
        **{key: float(values.mean()) for key, values in pairs.items()},
        **fate,
        "differences": {
            key: [each.mean, each.low, each.high]
            for key in pairs
            for each in [bootstrap_interval((pairs[key] - base[key]).tolist(), names)]
        },
    }


def _pairs(rows: dict[str, Any], rule: str, frames: list[str]) -> dict[str, NDArray[np.float64]]:
    """Return the IoU of each pair of photograph and name: best region of any level, best thing, best union."""
    values = []
    for frame in frames:
        ious = rows[f"{rule}/instances"]["ious"][frame]
        for name, thing in rows[f"{rule}/{frame}"]["things"].items():
            values.append([max(iou for iou, _ in thing.values()), *ious[name]])
    return dict(zip(("best", "thing", "union"), np.array(values).T, strict=True))
