"""The Gaussians selected for a text, against those that truly are the thing: intersection over union of Gaussians.

    python -m benchmarks.selection [--scenes kitchen-11 ...] [--seed 2] [--out docs/benchmarks/selection.json]

The silhouette of the 3D-selection protocol says little about the kitchen's splat: haze hides in it, and nothing
occludes. Here every Gaussian with a code counts alike. "0.6" is the protocol's threshold, with the level of the
largest relevancy; "votes" is the threshold at which the answer changes least; "best level" is that with the best level
for each text; "10 neighbours" is that with the relevancy of each Gaussian blended half and half with the mean of its 10
nearest; "asked" is what `scoup select --always` selects, by things where the way has them. All compare with everyday
words.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from statistics import mean
from typing import Any

import tyro

from benchmarks.answer_scenes import AnswerScene, SceneSize, make_scene
from benchmarks.answers import WAYS
from benchmarks.data import data_folder
from scoup.models.words import with_everyday
from scoup.query.answering import answer_scene
from scoup.query.neighbours import Neighbourhood
from scoup.query.question import Question
from scoup.query.select import select_by_relevancy
from scoup_lab.baselines.fitted import FittedField, FittedMethod
from scoup_lab.baselines.method import MethodSettings
from scoup_lab.bench import describe_environment, markdown, write_json
from scoup_lab.evaluate.metrics import bootstrap_interval, iou

NEIGHBOURS = 10
RULES = ("0.6", "votes", "10 neighbours", "best level", "asked")
COMPARED = (("votes", "0.6"), ("10 neighbours", "votes"), ("asked", "votes"))


@dataclass(frozen=True)
class Arguments:
    scenes: tuple[str, ...] = (
        *(f"kitchen-{seed}" for seed in range(11, 16)),
        "table-1",
        "shelves-1",
        "hall-1",
        "yard-1",
    )
    """As in benchmarks.answers."""
    ways: tuple[str, ...] = ("dense", "default")
    """As there."""
    seed: int = 2
    """Of the codebook."""
    out: Path | None = None
    """Where the figures are written; replaced."""
    data: Path = field(default_factory=data_folder)
    """Folder that holds kitchen/ and clip/."""


def main(arguments: Arguments) -> dict[str, Any]:
    """Print the table and write the figures."""
    scores: dict[str, dict[str, dict[str, list[float]]]] = {way: {} for way in arguments.ways}
    for name in arguments.scenes:
        scene = make_scene(name, arguments.data, SceneSize())
        inputs = scene.inputs()
        for way in arguments.ways:
            fitted = WAYS[way].uplift(inputs, MethodSettings(arguments.seed))
            scores[way][name] = score(scene, fitted)
    print(table(scores))
    record = {
        "what": "benchmarks.selection: IoU of Gaussians, per scene, way and rule",
        "machine": describe_environment(),
        "seed": arguments.seed,
        "scores": scores,
    }
    if arguments.out is not None:
        write_json(arguments.out, record, overwrite=True)
    return record


def table(scores: dict[str, dict[str, dict[str, list[float]]]]) -> str:
    """Means by way, rule and scene, and what the default gains as asked, over texts."""
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
        told = "{:+.3f} [{:+.3f}, {:+.3f}]".format(found.mean, *found.ends)
        body.append(["default", f"{better} - {worse}, over texts", told, *[""] * len(scenes)])
    return markdown(["way", "rule", "mean", *scenes], body)


def score(scene: AnswerScene, fitted: FittedMethod) -> dict[str, list[float]]:
    """Per rule, the IoU of each text whose Gaussians are known."""
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


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
