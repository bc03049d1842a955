"""Asking and scoring for benchmarks/voting.py: both choices of the level from one set of relevancy maps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from benchmarks.voting_scenes import VotingScene
from scoup import raster
from scoup.baselines.fitted import embedding_cosines, image_relevancy
from scoup.evaluate.metrics import any_inside, iou
from scoup.field.relevancy import relevancy
from scoup.io.labels import LabelledFrame
from scoup.query.localize import localize
from scoup.query.presets import QUERY_PRESETS
from scoup.query.segment import choose_level, level_masks
from scoup.synthetic.faults import LevelSums

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


def score_sparse(scene: VotingScene, indices: Tensor, weights: Tensor, codebook: Tensor) -> Scores:
    """Ask codes [N, S, K] over a codebook [S, L, D] everything."""

    def maps() -> Iterator[Tensor]:
        for frame, view in scene.frames:
            queries = _queries(scene, frame)
            cosines = raster.render_cosines(
                view, indices, weights, codebook, torch.cat([queries, scene.canonical])
            )
            yield relevancy(cosines[:, : len(queries)], cosines[:, len(queries) :])

    return _score(scene, maps())


def score_dense(scene: VotingScene, levels: Sequence[LevelSums]) -> Scores:
    """Ask full embeddings everything. The maps of all frames are kept, the features of one level at a time."""
    by_level = []
    for level in levels:
        features = torch.nn.functional.normalize(level.product(level.embeddings), dim=1)
        by_level.append(
            [
                image_relevancy(
                    raster.render_channels(view, features)[0],
                    embedding_cosines,
                    _queries(scene, frame),
                    scene.canonical,
                )
                for frame, view in scene.frames
            ]
        )
    return _score(scene, (torch.stack(maps) for maps in zip(*by_level, strict=True)))


def _queries(scene: VotingScene, frame: LabelledFrame) -> Tensor:
    return torch.stack([scene.queries[label] for label in frame.labels])


def _score(scene: VotingScene, maps: Iterator[Tensor]) -> Scores:
    """Relevancy [S, Q, H, W] of each frame to scores; the protocol of ``score_frame``, with every level's mask."""
    scores = Scores([], [], [], [])
    for (frame, _), of_frame in zip(scene.frames, maps, strict=True):
        for position, label in enumerate(frame.labels):
            one = of_frame[:, position]
            smoothed, masks = level_masks(one, PRESET)
            ious = [iou(mask, frame.masks[label]) for mask in masks]
            scores.peak.append(ious[choose_level(smoothed, masks, "peak")])
            scores.mask.append(ious[choose_level(smoothed, masks, "mask")])
            scores.best.append(max(ious))
            scores.hit.append(float(any_inside(localize(one, PRESET).pixels, frame.boxes[label])))
    return scores
