"""Variants of the preset fast for masks of real photographs: rules over the same masks, other points, another model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch

from benchmarks.decoded import Answer
from scoup.extract import Masks, MaskSettings, mask_settings
from scoup.extract.overlaps import keep_by_boxes, keep_by_masks
from scoup.scene.regions import LEVELS

SIZES = (0.005, 0.04)  # shares of the image up to which a mask is of level s, of level m
BASE = "fast"
MOBILE, SECOND = "MobileSAM", "SAM 2 tiny"

_FAST = mask_settings("fast")
_COARSE = mask_settings("fast", points_per_side=20)


@dataclass(frozen=True)
class Rule:
    """A variant of the preset ``fast``, and the model that it asks."""

    settings: MaskSettings = _FAST
    arrange: Callable[[dict[str, Masks], MaskSettings], dict[str, Masks]] = lambda found, _: found
    with_default: bool = False
    changed: Callable[[Answer], Answer] = lambda answer: answer
    model: str = MOBILE


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


def best_of_point(answer: Answer) -> Answer:
    """Let all three masks of a point pass if the best of them does."""
    logits, iou = answer
    return logits, iou.amax(1, keepdim=True).expand_as(iou)


def smallest_first(answer: Answer) -> Answer:
    """Sort the three masks of each point by area."""
    logits, iou = answer
    order = (logits > 0).sum((-2, -1)).argsort(dim=1, stable=True)
    return torch.take_along_dim(logits, order[:, :, None, None], 1), torch.take_along_dim(iou, order, 1)


_VARIANTS = {
    "with default": Rule(with_default=True),
    "overlaps up to 0.5": Rule(replace(_FAST, box_overlap=0.5, mask_overlap=0.5)),
    "overlaps up to 0.9": Rule(replace(_FAST, box_overlap=0.9, mask_overlap=0.9)),
    "lower bounds": Rule(replace(_FAST, predicted_iou=0.5, stability=0.7, least_score=0.35)),
    "three masks per point": Rule(replace(_FAST, stability=0.0, least_score=0.0), changed=best_of_point),
    "smallest first": Rule(changed=smallest_first),
    "parts kept, on top": Rule(replace(_FAST, inside=2.0), small_on_top),
    "level by size": Rule(arrange=by_size),
}
RULES = {
    BASE: Rule(),
    "all points": Rule(replace(_FAST, skip_covered=False)),
    "with crops": Rule(replace(_FAST, crop_layers=1)),
    "24 x 24 points": Rule(replace(_FAST, points_per_side=24)),
    "20 x 20 points": Rule(_COARSE),
    **_VARIANTS,
    f"{SECOND}, {BASE}": Rule(model=SECOND),
    f"{SECOND}, 20 x 20 points": Rule(_COARSE, model=SECOND),
    **{f"{SECOND}, {name}": replace(rule, model=SECOND) for name, rule in _VARIANTS.items()},
}
