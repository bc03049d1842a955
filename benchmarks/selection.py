"""The Gaussians selected for a text, against the ground truth."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from statistics import mean
from typing import Any

from benchmarks.answer_scenes import AnswerScene
from benchmarks.answers import difference_cell
from benchmarks.study import Record
from benchmarks.ways import StudyOfScenes, nested
from scoup.models.words import with_everyday
from scoup.query.answering import answer_scene
from scoup.query.question import Question
from scoup.query.select import select_by_relevancy
from scoup.scene.neighbours import Neighbourhood
from scoup_lab.baselines.fitted import FittedField, FittedMethod
from scoup_lab.bench import markdown
from scoup_lab.evaluate.metrics import bootstrap_interval, iou

NEIGHBOURS = 10
RULES = ("0.6", "votes", "10 neighbours", "best level", "asked")
COMPARED = (("votes", "0.6"), ("10 neighbours", "votes"), ("asked", "votes"))


@dataclass(frozen=True, kw_only=True)
class Selections(StudyOfScenes):
    """Compare the Gaussians selected for a text with those that truly are the thing, by intersection over union.

    The silhouette of the 3D-selection protocol says little about the kitchen's splat: haze hides in it, and nothing
    occludes. Here every Gaussian with a code counts alike. All rules compare with everyday words. 0.6: the protocol's
    threshold, with the level of the largest relevancy. votes: the threshold at which the answer changes least. 10
    neighbours: the same with the relevancy of each Gaussian blended half and half with the mean of its 10 nearest. best
    level: votes with the best level for each text. asked: what `scoup select --always` selects, by things where the way
    has them.
    """

    seed: int = 2
    """Of the codebook."""

    def measure(self, known: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        for key, scene, fitted in self.fields(known, self.seed):
            yield key, score(scene, fitted)

    def record(self, rows: dict[str, Any]) -> Record:
        return {"seed": self.seed, "scores": nested(rows)}

    @staticmethod
    def table(record: Record) -> str:
        """Return means by way, rule and scene, and what rules gain on the default, over texts."""
        scores = record["scores"]
        scenes = list(scores["default"])
        body = []
        for way, of in scores.items():
            for rule in RULES:
                means = [mean(of[name][rule]) for name in scenes]
                body.append([way, rule, f"{mean(means):.3f}", *(f"{each:.3f}" for each in means)])
        for better, worse in COMPARED:
            gains = [
                b - a for of in scores["default"].values() for a, b in zip(of[worse], of[better], strict=True)
            ]
            found = bootstrap_interval(gains, list(map(str, range(len(gains)))))
            gain = difference_cell((found.mean, *found.ends))
            body.append(["default", f"{better} - {worse}, over texts", gain, *[""] * len(scenes)])
        return markdown(["way", "rule", "mean", *scenes], body)


def score(scene: AnswerScene, fitted: FittedMethod) -> dict[str, list[float]]:
    """Return per rule the IoU of each text whose Gaussians are known."""
    canonical, coded = with_everyday(scene.canonical, scene.everyday), fitted.coded()
    around = Neighbourhood.of(scene.gaussians.means, coded.any(0), NEIGHBOURS)
    found: dict[str, list[float]] = {rule: [] for rule in RULES}
    for label, query in scene.queries.items():
        truth = scene.members[label] & coded.any(0)
        relevancy = fitted.gaussian_relevancy(query[None], canonical)[:, 0]
        found["0.6"].append(iou(select_by_relevancy(relevancy, coded, threshold=0.6).mask, truth))
        found["votes"].append(iou(select_by_relevancy(relevancy, coded).mask, truth))
        found["10 neighbours"].append(iou(select_by_relevancy(relevancy, coded, around).mask, truth))
        levels = (select_by_relevancy(relevancy[[s]], coded[[s]]).mask for s in range(len(relevancy)))
        found["best level"].append(max(iou(mask, truth) for mask in levels))
        if isinstance(fitted, FittedField):
            fitted.field.attach(scene.gaussians, known=True)
            question = Question((label,), query[None], canonical, scene.everyday, scene.name)
            found["asked"].append(iou(answer_scene(fitted.field, question)[0].mask & coded.any(0), truth))
        else:
            found["asked"].append(found["votes"][-1])
    return found
