"""Asking and scoring for benchmarks/voting.py: both choices of the level from one set of relevancy maps."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from benchmarks.voting_scenes import VotingScene
from scoup.baselines.fitted import FittedMethod
from scoup.evaluate.metrics import any_inside, iou
from scoup.query.localize import localize
from scoup.query.presets import QUERY_PRESETS
from scoup.query.segment import choose_level, level_masks

PRESET = QUERY_PRESETS["scoup"]


@dataclass(frozen=True)
class Scores:
    """One number a (frame, label) pair.

    Attributes:
        peak, mask: IoU by the choice of the level.
        best: IoU of the level that is best: what a perfect choice would give.
        hit: 1 where the point is right.
    """

    peak: list[float]
    mask: list[float]
    best: list[float]
    hit: list[float]


def score(scene: VotingScene, fitted: FittedMethod) -> Scores:
    """Query a fitted method for everything: the protocol of ``score_frame``, with every level's mask."""
    scores = Scores([], [], [], [])
    for frame, view in scene.frames:
        queries = torch.stack([scene.queries[label] for label in frame.labels])
        of_frame = fitted.relevancy(view, queries, scene.canonical)  # [S, Q, H, W]
        for position, label in enumerate(frame.labels):
            one = of_frame[:, position]
            found = level_masks(one, PRESET)
            ious = [iou(mask, frame.masks[label]) for mask in found.masks]
            scores.peak.append(ious[choose_level(found, "peak")])
            scores.mask.append(ious[choose_level(found, "mask")])
            scores.best.append(max(ious))
            scores.hit.append(float(any_inside(localize(one, PRESET).pixels, frame.boxes[label])))
    return scores
