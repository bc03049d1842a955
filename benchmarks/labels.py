"""The word of each Gaussian, one of several, against the ground truth."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from statistics import mean
from typing import Any

import torch
from torch import Tensor

from benchmarks.answer_scenes import AnswerScene
from benchmarks.study import Record
from benchmarks.ways import StudyOfScenes, nested
from scoup.models.words import with_everyday
from scoup.query.label import NONE, label_by_selections
from scoup.query.presence import PRESENT_FROM, mean_embedding, z_scores
from scoup.query.select import Selection, select_by_relevancy
from scoup_lab.baselines.fitted import FittedChannels, FittedField, FittedMethod
from scoup_lab.bench import markdown
from scoup_lab.evaluate.metrics import iou

RULES = ("as labelled", "most relevant", "argmax")
WORDS = ("all words", "half the words")
N_ABSENT = 8
COVERED = 0.5  # share of a name's Gaussians that smaller things own, from which it is the name of a group


@dataclass(frozen=True, kw_only=True)
class Labels(StudyOfScenes):
    """Give each Gaussian one of several words, and compare with the truth: accuracy, mIoU and IoU of each word.

    Words are the names of a scene's things. all words: the names of all things, also of groups of them, which a
    Gaussian has beside its own; the smallest thing that it belongs to is its true one. half the words: every other name
    of a thing that is no group, and eight names of things that the scene lacks, so that "none of these" is the true
    answer for many Gaussians. Every Gaussian with a code counts alike; mIoU is the mean over the words that any
    Gaussian truly has.

    as labelled: what `scoup label` does; of the words that select a Gaussian the one answered at the finer level, then
    the most relevant. most relevant: without the level. argmax: every Gaussian gets its most relevant word, at any
    level, without presence and selection, as point-level protocols do. Tuned on kitchen-1 and table-0.
    """

    seed: int = 2
    """Of the codebook."""

    def measure(self, known: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        for key, scene, fitted in self.fields(known, self.seed):
            yield key, {words: score(scene, fitted, words) for words in WORDS}

    def record(self, rows: dict[str, Any]) -> Record:
        return {"seed": self.seed, "scores": nested(rows)}

    @staticmethod
    def table(record: Record) -> str:
        """Return accuracy / mIoU: means over scenes, and the scenes."""
        body, scores = [], record["scores"]
        scenes = list(next(iter(scores.values())))
        for words in WORDS:
            for way, of in scores.items():
                for rule in RULES:
                    figures = [of[name][words][rule] for name in scenes]
                    pairs = [(each["accuracy"], each["miou"]) for each in figures]
                    means = [mean(each) for each in zip(*pairs, strict=True)]
                    cells = [f"{accuracy:.3f} / {miou:.3f}" for accuracy, miou in (means, *pairs)]
                    body.append([words, way, rule, *cells])
        return markdown(["words", "way", "rule", "mean", *scenes], body)


def score(scene: AnswerScene, fitted: FittedMethod, words: str) -> dict[str, Any]:
    """Return per rule accuracy, mIoU, IoU of each word and of "none"."""
    names, truth = chosen_words(scene, words)
    absent = list(scene.absent[:N_ABSENT]) if words == WORDS[1] else []
    queries = torch.stack([scene.everyday[scene.words.index(name)] for name in (*names, *absent)])
    canonical, coded = with_everyday(scene.canonical, scene.everyday), fitted.coded()
    relevancy = fitted.gaussian_relevancy(queries, canonical)
    selections = [select_by_relevancy(relevancy[:, number], coded) for number in range(len(queries))]
    found = torch.stack([
        selected_embedding(fitted, each, scene.gaussians.opacities) for each in selections
    ])  # fmt: skip
    present = (z_scores(found, queries, scene.everyday) >= PRESENT_FROM).tolist()
    judged = coded.any(0)
    given = dict(labelled(selections, present, relevancy, coded))
    return {
        "words": {"given": len(names), "present": sum(present[: len(names)]), "absent": len(absent),
                  "absent but present": sum(present[len(names) :])},
        **{rule: agreement(truth[judged], ids[judged], names) for rule, ids in given.items()},
    }  # fmt: skip


def chosen_words(scene: AnswerScene, words: str) -> tuple[list[str], Tensor]:
    """Return the names that are given, and [N] the true one of each Gaussian, ``NONE`` for none of them."""
    names = sorted(scene.queries, key=lambda name: int(scene.members[name].sum()))
    if words == WORDS[1]:
        owned = torch.zeros(len(scene.gaussians), dtype=torch.bool)
        things = []
        for name in names:
            members = scene.members[name]
            if int((members & owned).sum()) < COVERED * int(members.sum()):
                things.append(name)
            owned |= members
        names = things[::2]
        # What a name that is not given owns belongs to none, also where a larger thing that is given contains it.
        smaller = [name for name in things if name not in names]
    else:
        smaller = []
    truth = torch.full((len(scene.gaussians),), NONE)
    for name in sorted({*names, *smaller}, key=lambda name: -int(scene.members[name].sum())):
        truth[scene.members[name]] = names.index(name) if name in names else NONE
    return names, truth


def labelled(
    selections: list[Selection], present: list[bool], relevancy: Tensor, coded: Tensor
) -> Iterator[tuple[str, Tensor]]:
    """Yield [N] the word of each Gaussian by each rule."""
    count = relevancy.shape[2]
    yield RULES[0], label_by_selections(zip(selections, present, strict=True), count)[0]
    of_one_level = [replace(each, level=0) for each in selections]
    yield RULES[1], label_by_selections(zip(of_one_level, present, strict=True), count)[0]
    values, ids = relevancy.masked_fill(~coded[:, None], -torch.inf).amax(0).max(0)
    yield RULES[2], torch.where(values > -torch.inf, ids, NONE)


def selected_embedding(fitted: FittedMethod, selection: Selection, opacities: Tensor) -> Tensor:
    """Return [D] the mean embedding of the more relevant half of a selection, as ``scene_z_scores`` takes it."""
    assert isinstance(fitted, (FittedField, FittedChannels))
    inside = selection.mask
    if inside.any():
        inside = inside & (selection.relevancy >= selection.relevancy[inside].median())
    rows = inside.nonzero()[:, 0]
    if isinstance(fitted, FittedField):
        return mean_embedding(fitted.field, selection.level, rows, opacities[rows])
    return (fitted.channels[selection.level][rows] * opacities[rows, None]).sum(0)


def agreement(truth: Tensor, given: Tensor, names: list[str]) -> dict[str, Any]:
    """Return accuracy, mIoU over the words that are true somewhere, and IoU of each of these and of none."""
    numbers = [number for number in range(len(names)) if (truth == number).any()]
    ious = {names[number]: iou(truth == number, given == number) for number in numbers}
    return {
        "accuracy": float((truth == given).float().mean()),
        "miou": mean(ious.values()),
        "none": iou(truth == NONE, given == NONE),
        "ious": ious,
    }
