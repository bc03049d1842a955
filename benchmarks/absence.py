"""A study of presence: absent things must be refused, and present ones must not."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from statistics import mean
from typing import Any, NamedTuple

import numpy as np
import torch

from benchmarks.answer_scenes import AnswerScene
from benchmarks.study import Record
from benchmarks.ways import LAYOUTS, StudyOfScenes, groups_of, nested
from scoup.models.words import with_everyday
from scoup.query.answering import answer_view
from scoup.query.presence import PRESENT_FROM
from scoup.query.question import Question
from scoup_lab.baselines.fitted import FittedField
from scoup_lab.bench import markdown
from scoup_lab.evaluate.metrics import iou

PRESENT, OUT_OF_VIEW, ABSENT = KINDS = ("present", "out of view", "absent")
BOUNDS = (0.0, 0.5, 1.0, PRESENT_FROM, 2.0, 3.0, 4.0)
MOST = 40  # absent words per scene


@dataclass(frozen=True, kw_only=True)
class Absence(StudyOfScenes):
    """Ask held-out views for what is there and what is not, and judge presence as `scoup query` does.

    Every labelled view is asked for its labels (present), for the scene's other labels (out of view) and for up to 40
    words that nothing in the scene is called (absent). AUC is the chance that the score of a present text is above that
    of an absent one. For each bound: the shares of texts found, and the mIoU that refusals cost. Tuned on desk,
    desk-all, kitchen-1 to -3 of all kinds, 2x2, table-0, hall-0 and yard-0, with codebook seed 0.
    """

    scenes: tuple[str, ...] = (
        *("desk", "desk-all", "kitchen-11-desk", "kitchen-12-desk", "kitchen-11-clip", "kitchen-12-clip"),
        *("kitchen-11", "kitchen-12", "kitchen-13", "kitchen-11x2"),
        *LAYOUTS,
    )
    """Draws of the kitchen, layouts of benchmarks.scenes with a seed, desk and desk-all."""
    ways: tuple[str, ...] = ("default",)
    """The default alone: presence is its rule."""
    seed: int = 2
    """Of the codebook."""

    def measure(self, known: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        for key, scene, fitted in self.fields(known, self.seed):
            assert isinstance(fitted, FittedField)
            yield key, curve(ask(scene, fitted))

    def record(self, rows: dict[str, Any]) -> Record:
        return {"seed": self.seed, "bound": PRESENT_FROM, "scenes": nested(rows)["default"]}

    @staticmethod
    def table(record: Record) -> str:
        """Return means over each kind of scenes: AUCs, then texts found and mIoU lost by the bound."""
        body = []
        for title, names in groups_of(list(record["scenes"])).items():
            of = [record["scenes"][name] for name in names]
            aucs = [_mean(each[name] for each in of) for name in ("AUC", "AUC, out of view")]
            cells = [
                ", ".join(
                    _mean(each["from"][f"{bound:g}"][key] for each in of)
                    for key in (PRESENT, ABSENT, "mIoU lost")
                )
                for bound in BOUNDS
            ]
            body.append([title, *aucs, *cells])
        heads = ["scenes", "AUC, absent", "AUC, out of view", *(f"from {bound:g}" for bound in BOUNDS)]
        return markdown(heads, body)


class Asked(NamedTuple):
    """One text asked in one view: which kind of question it is, the score, and the IoU of the mask (0 if absent)."""

    kind: str
    score: float
    iou: float


def ask(scene: AnswerScene, fitted: FittedField) -> list[Asked]:
    """Ask every view of a scene everything."""
    field = fitted.field
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


def curve(asked: list[Asked]) -> Record:
    """Return what each bound refuses, and AUCs."""
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
    """Return the chance that one of the first is above one of the second, ties half; None without both."""
    if not len(higher) or not len(lower):
        return None
    above = (higher[:, None] > lower).mean() + 0.5 * (higher[:, None] == lower).mean()
    return round(float(above), 4)


def _share(found: np.ndarray) -> float | None:
    return round(float(found.mean()), 4) if len(found) else None


def _mean(values: Iterator[float | None]) -> str:
    known = [value for value in values if value is not None]
    return f"{mean(known):.3f}" if known else ""
