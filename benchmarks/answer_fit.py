"""The constants of the answer: chosen on all scenes, and what those chosen on the others reach on each."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from statistics import mean
from typing import Any

import torch

from benchmarks.answer_scenes import AnswerScene
from benchmarks.drawn import DrawnAnswer, drawn_masks, question_of
from benchmarks.real_scenes import place_of
from benchmarks.study import Record
from scoup.models.words import with_everyday
from scoup.query.matching import ChoiceRule, ComparedTable, choose_things
from scoup_lab.baselines.fitted import FittedField, FittedMethod
from scoup_lab.bench import markdown
from scoup_lab.evaluate.metrics import iou

HUB_SHARES, RIVALS, AGREEMENTS = (0.4, 0.5, 0.6, 0.75), (0.0, 1.0, 2.0, 3.0), (0.0, 0.25, 0.5, 0.75)
AT_A_TIME = 16  # answers drawn together


def fit_row(scene: AnswerScene, fitted: FittedMethod) -> dict[str, float]:
    """Return the mIoU of a scene by the constants, "hub share/rival/agreement"."""
    assert isinstance(fitted, FittedField)
    assert fitted.field.thing_table is not None
    table, labels = fitted.field.thing_table, tuple(scene.queries)
    question = question_of(scene, labels, with_everyday(scene.canonical, scene.everyday))
    chosen: dict[tuple[str, tuple[int, ...]], list[float]] = {}
    by_constants: dict[str, list[tuple[str, tuple[int, ...]]]] = {}
    for hub_share in HUB_SHARES:
        known = ComparedTable.of(table, question.everyday.float(), hub_share)
        fits = known.fits(question.queries.float())
        for rival, agreement in product(RIVALS, AGREEMENTS):
            found = choose_things(known, fits, None, ChoiceRule(rival, agreement))
            keys = [
                (label, tuple(sorted(each.things.tolist())) if each else ())
                for label, each in zip(labels, found, strict=True)
            ]
            by_constants[f"{hub_share}/{rival}/{agreement}"] = keys
            chosen |= {key: [] for key in keys}
    answers = {things: _answer(table, things) for _, things in chosen}
    for frame, view in scene.frames:
        mine = [key for key in chosen if key[0] in frame.labels]
        for start in range(0, len(mine), AT_A_TIME):
            part = mine[start : start + AT_A_TIME]
            masks = drawn_masks([answers[things] for _, things in part], view)
            for key, mask in zip(part, masks, strict=True):
                chosen[key].append(iou(mask, frame.masks[key[0]]))
    return {
        constants: round(mean(found for key in keys for found in chosen[key]), 4)
        for constants, keys in by_constants.items()
    }


def _answer(table: Any, things: tuple[int, ...]) -> DrawnAnswer:
    if not things:
        nothing = torch.zeros(len(table.owners), dtype=torch.bool)
        return DrawnAnswer(nothing, nothing)
    members = table.members(torch.tensor(things))
    return DrawnAnswer(members, table.owned[int(table.levels[things[0]])])


def fit_record(rows: Mapping[str, Mapping[str, float]]) -> Record:
    """Return the best constants of all scenes, and per scene what the best of all other scenes reach; both poolings of
    a scene count as one.
    """
    scores = {key.split("/")[1]: of for key, of in rows.items()}
    left_out = {}
    for name, of in scores.items():
        others = [each for other, each in scores.items() if place_of(other) != place_of(name)] or [of]
        constants = _best(others)
        left_out[name] = {"constants": constants, "mIoU": of[constants], "best": max(of.values())}
    return {
        "constants": _best(list(scores.values())),
        "left out": left_out,
        "means": {
            key: round(mean(of[key] for of in scores.values()), 4) for key in next(iter(scores.values()))
        },
    }


def fit_table(record: Record) -> str:
    """Return what was chosen, per scene left out."""
    body = [
        [name, of["constants"], f"{of['mIoU']:.3f}", f"{of['best']:.3f}"]
        for name, of in record["left out"].items()
    ]
    chosen = record["constants"]
    body.append(["all", chosen, f"{record['means'][chosen]:.3f}", f"{max(record['means'].values()):.3f}"])
    means = [mean(of["mIoU"] for of in record["left out"].values())]
    body.append(["mean of the scenes left out", "", f"{means[0]:.3f}", ""])
    heads = [
        "scene left out",
        "hub share / rival / agreement chosen on the others",
        "mIoU",
        "best of the grid",
    ]
    return markdown(heads, body)


def _best(scores: list[Mapping[str, float]]) -> str:
    """Return the constants with the largest mean over neighbours in the grid, too: a lone peak is luck."""
    means = {key: mean(of[key] for of in scores) for key in scores[0]}

    def smoothed(key: str) -> float:
        own = tuple(map(float, key.split("/")))
        near = [
            value
            for other, value in means.items()
            if sum(
                _steps(axis, a, b)
                for axis, a, b in zip(_AXES, own, map(float, other.split("/")), strict=True)
            )
            <= 1
        ]
        return mean(near)

    return max(means, key=smoothed)


_AXES = (HUB_SHARES, RIVALS, AGREEMENTS)


def _steps(axis: tuple[float, ...], one: float, other: float) -> int:
    return abs(axis.index(one) - axis.index(other))
