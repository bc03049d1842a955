"""Which threshold makes the best masks: fixed ones, Otsu's, and stable ones of several windows and ranges.

    python -m benchmarks.threshold [--scenes kitchen kitchen-1 ...] [--seed 0] [--out docs/benchmarks/threshold.json]

The default's field is built on each scene and asked for every label of every labelled view, beside everyday words. A
threshold is judged by the mIoU of the level whose mask has the largest mean relevancy ("mask"), and of the best level.
The constants of ``scoup.query.stable_threshold`` were chosen on the scenes given here by default;
``benchmarks.answers`` shows others.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from statistics import mean
from typing import Any

import torch
import tyro
from torch import Tensor

from benchmarks.answer_scenes import SceneSize, make_scene
from benchmarks.data import data_folder
from scoup.models.words import with_everyday
from scoup.query.localize import averaged_relevancy
from scoup.query.presets import QUERY_PRESETS
from scoup.query.segment import LevelMasks, choose_level
from scoup.query.smoothing import rescale, smoothed_masks
from scoup.query.stable_threshold import Stability, stable_thresholds
from scoup_lab.baselines.method import MethodSettings
from scoup_lab.baselines.methods import METHODS
from scoup_lab.bench import describe_environment, markdown, write_json
from scoup_lab.evaluate.metrics import iou

Rule = Callable[[Tensor], Tensor]
"""Thresholds [S] of smoothed relevancy [S, M]."""


@dataclass(frozen=True)
class Arguments:
    scenes: tuple[str, ...] = ("kitchen", "kitchen-1", "kitchen-2", "kitchen-2x2", "table-0", "shelves-0")
    """As in benchmarks.answers."""
    seed: int = 0
    """Of the codebook."""
    out: Path | None = None
    """Where the figures are written; replaced."""
    data: Path = field(default_factory=data_folder)
    """Folder that holds kitchen/ and clip/."""


def fixed(threshold: float) -> Rule:
    return lambda smoothed: torch.full((len(smoothed),), threshold)


def stable(**changes: float) -> Rule:
    return lambda smoothed: stable_thresholds(smoothed, stability=Stability(**changes))[0]


def otsu(smoothed: Tensor) -> Tensor:
    """The threshold that leaves the least variance within the two classes (Otsu 1979), of the upper half."""
    found = []
    for row in smoothed:
        values = rescale(row)
        counts = torch.histc(values[values > 0], 100, 0, 1).double()
        at = (torch.arange(100) + 0.5) / 100
        below, total = counts.cumsum(0), counts.sum()
        sums = (counts * at).cumsum(0)
        between = (sums[-1] * below / total - sums).square() / (below * (total - below)).clamp(min=1)
        found.append((int(between.argmax()) + 1) / 100)
    return torch.tensor(found)


RULES: dict[str, Rule] = {
    **{f"fixed {threshold}": fixed(threshold) for threshold in (0.3, 0.45, 0.5, 0.6, 0.7)},
    "Otsu": otsu,
    "stable": stable(),
    "stable, window 0.06": stable(window=0.06),
    "stable, window 0.2": stable(window=0.2),
    "stable, 0.3 to 0.9": stable(lowest=0.3, highest=0.9),
    "stable, 0.52 to 0.76": stable(lowest=0.52, highest=0.76),
    "stable, no pull": stable(pull=0.0),
    "stable, pull 0.2": stable(pull=0.2),
}


def main(arguments: Arguments) -> dict[str, Any]:
    """Print the table and write the figures."""
    scores: dict[str, dict[str, list[list[float]]]] = {name: {} for name in RULES}
    for name in arguments.scenes:
        for rule, pairs in score(name, arguments).items():
            scores[rule][name] = pairs
    found = {
        rule: {
            name: [round(mean(pair[kind] for pair in pairs), 4) for kind in (0, 1)]
            for name, pairs in of_rule.items()
        }
        for rule, of_rule in scores.items()
    }
    print(table(found))
    record = {
        "what": "benchmarks.threshold: mIoU by mask and by the best level, per scene",
        "machine": describe_environment(),
        "seed": arguments.seed,
        "rules": found,
    }
    if arguments.out is not None:
        write_json(arguments.out, record, overwrite=True)
    return record


def table(found: dict[str, dict[str, list[float]]]) -> str:
    """Means over scenes by mask and of the best level, and by mask on each scene."""
    scenes = list(next(iter(found.values())))
    body = [
        [
            rule,
            *(f"{mean(of_rule[name][kind] for name in scenes):.3f}" for kind in (0, 1)),
            *(f"{of_rule[name][0]:.3f}" for name in scenes),
        ]
        for rule, of_rule in found.items()
    ]
    return markdown(["threshold", "mask", "best level", *scenes], body)


def score(name: str, arguments: Arguments) -> dict[str, list[list[float]]]:
    """Per rule and pair, the IoU by mask and of the best level."""
    scene = make_scene(name, arguments.data, SceneSize())
    inputs = scene.inputs()
    fitted = METHODS["sparse"].uplift(inputs, MethodSettings(arguments.seed))
    canonical, preset = with_everyday(scene.canonical, scene.everyday), QUERY_PRESETS["default"]
    found: dict[str, list[list[float]]] = {rule: [] for rule in RULES}
    for frame, view in scene.frames:
        queries = torch.stack([scene.queries[label] for label in frame.labels])
        maps = fitted.relevancy(view, queries, canonical)
        for position, label in enumerate(frame.labels):
            relevancy = maps[:, position]
            averaged = averaged_relevancy(relevancy, preset)
            flat = (0.5 * (relevancy + averaged)).flatten(1)
            for rule, threshold in RULES.items():
                thresholds = threshold(flat).float()
                smoothed, masks = smoothed_masks(relevancy, averaged, thresholds, preset.smoothing)
                levels = LevelMasks(smoothed, masks, thresholds, torch.zeros(len(masks)))
                ious = [iou(mask, frame.masks[label]) for mask in masks]
                found[rule].append([ious[choose_level(levels, "mask")], max(ious)])
    return found


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
