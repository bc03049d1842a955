"""Are absent things refused, and present ones not? Presence as `scoup query` judges it, in views of held-out scenes.

    python -m benchmarks.absence [--scenes desk ... kitchen-11 ... table-1 ...] [--seed 2]
        [--out docs/benchmarks/absence.json]

Every labelled view is asked for its labels (present), for the scene's other labels (out of view) and for up to ``MOST``
words that nothing in the scene is called (absent). AUC is the chance that the score of a present text is above that of
an absent one. For each bound the shares of texts found, and the mIoU that refusals cost. The rule and its bound were
tuned on desk, desk-all, kitchen-1 to -3 of all kinds, 2x2, table-0, hall-0 and yard-0, with codebook seed 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from statistics import mean
from typing import Any, NamedTuple

import numpy as np
import torch
import tyro

from benchmarks.answer_scenes import AnswerScene, SceneSize, make_scene
from benchmarks.answers import groups_of
from benchmarks.data import data_folder
from scoup.models.words import with_everyday
from scoup.query.answering import answer_view
from scoup.query.presence import PRESENT_FROM
from scoup.query.question import Question
from scoup_lab.baselines.method import MethodSettings
from scoup_lab.baselines.methods import METHODS
from scoup_lab.baselines.sparse import SparseUplift
from scoup_lab.bench import describe_environment, markdown, write_json
from scoup_lab.evaluate.metrics import iou

PRESENT, OUT_OF_VIEW, ABSENT = KINDS = ("present", "out of view", "absent")
BOUNDS = (0.0, 0.5, 1.0, PRESENT_FROM, 2.0, 3.0, 4.0)
MOST = 40


@dataclass(frozen=True)
class Arguments:
    scenes: tuple[str, ...] = (
        *("desk", "desk-all", "kitchen-11-desk", "kitchen-12-desk", "kitchen-11-clip", "kitchen-12-clip"),
        *("kitchen-11", "kitchen-12", "kitchen-13", "kitchen-11x2"),
        *("table-1", "shelves-1", "hall-1", "yard-1"),
    )
    """As in benchmarks.answers."""
    seed: int = 2
    """Of the codebook."""
    out: Path | None = None
    """Where the figures are written; replaced."""
    data: Path = field(default_factory=data_folder)
    """Folder that contains kitchen/ and clip/, and desk/ for its scenes."""


class Asked(NamedTuple):
    """One text asked in one view: which kind of question it is, the score, and the IoU of the mask (0 if absent)."""

    kind: str
    score: float
    iou: float


def main(arguments: Arguments) -> dict[str, Any]:
    """Print the table and write the figures."""
    scenes = {
        name: curve(ask(make_scene(name, arguments.data, SceneSize()), arguments.seed))
        for name in arguments.scenes
    }
    print(table(scenes))
    record = {
        "what": "benchmarks.absence: AUC of presence; per bound the share of texts found and the mIoU lost",
        "machine": describe_environment(),
        "seed": arguments.seed,
        "bound": PRESENT_FROM,
        "scenes": scenes,
    }
    if arguments.out is not None:
        write_json(arguments.out, record, overwrite=True)
    return record


def ask(scene: AnswerScene, seed: int) -> list[Asked]:
    """Ask every view of a scene everything."""
    uplift = METHODS["sparse"].uplift
    assert isinstance(uplift, SparseUplift)
    field = uplift(scene.inputs(), MethodSettings(seed)).field
    field.attach(scene.gaussians, known=True)
    words = (*scene.queries, *scene.absent[:MOST])
    queries = torch.stack([scene.everyday[scene.words.index(word)] for word in words])
    canonical = with_everyday(scene.canonical, scene.everyday)
    question = Question(words, queries, canonical, scene.everyday, scene.name, present_from=-math.inf)
    found = []
    for (frame, view), camera in zip(scene.frames, scene.cameras, strict=True):
        for answer in answer_view(field, camera, question, view):
            assert answer.z_score is not None
            kind = OUT_OF_VIEW if answer.text in scene.queries else ABSENT
            truth = frame.masks.get(answer.text)
            right = 0.0 if truth is None else iou(answer.mask, truth)
            found.append(Asked(kind if truth is None else PRESENT, answer.z_score, right))
    return found


def curve(asked: list[Asked]) -> dict[str, Any]:
    """What each bound refuses, and AUCs."""
    scores = {kind: np.array([each.score for each in asked if each.kind == kind]) for kind in KINDS}
    present = [each for each in asked if each.kind == PRESENT]
    bounds = {
        f"{bound:g}": {
            **{kind: _share(scores[kind] >= bound) for kind in KINDS},
            "mIoU lost": round(mean(each.iou * (each.score < bound) for each in present), 4),
        }
        for bound in BOUNDS
    }
    return {
        "questions": {kind: len(values) for kind, values in scores.items()},
        "AUC": auc(scores[PRESENT], scores[ABSENT]),
        "AUC, out of view": auc(scores[PRESENT], scores[OUT_OF_VIEW]),
        "mIoU always": round(mean(each.iou for each in present), 4),
        "from": bounds,
    }


def auc(higher: np.ndarray, lower: np.ndarray) -> float | None:
    """The chance that one of the first is above one of the second, ties half; None without both."""
    if not len(higher) or not len(lower):
        return None
    above = (higher[:, None] > lower).mean() + 0.5 * (higher[:, None] == lower).mean()
    return round(float(above), 4)


def _share(found: np.ndarray) -> float | None:
    return round(float(found.mean()), 4) if len(found) else None


def table(scenes: dict[str, Any]) -> str:
    """Means over each kind of scenes: AUCs, then texts found and mIoU lost by the bound."""
    body = []
    for title, names in groups_of(list(scenes)).items():
        of = [scenes[name] for name in names]
        cells = [
            f"{_mean(each['from'][f'{bound:g}'][PRESENT] for each in of)}, "
            f"{_mean(each['from'][f'{bound:g}'][ABSENT] for each in of)}, "
            f"{_mean(each['from'][f'{bound:g}']['mIoU lost'] for each in of)}"
            for bound in BOUNDS
        ]
        aucs = [_mean(each[name] for each in of) for name in ("AUC", "AUC, out of view")]
        body.append([title, *aucs, *cells])
    return markdown(["scenes", "AUC, absent", "AUC, out of view", *(f"from {b:g}" for b in BOUNDS)], body)


def _mean(values: Any) -> str:
    known = [value for value in values if value is not None]
    return f"{mean(known):.3f}" if known else ""


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
