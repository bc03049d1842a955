"""How well signals separate absent things from present ones, and how well a bound on a signal does on scenes that it
was not chosen on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from scoup.base.errors import InputError
from scoup.evaluate.studies.presence import ABSENT, IN_SCENE, OUT_OF_VIEW, PRESENT, SIGNALS, Question
from scoup.evaluate.studies.study_report import StudyReport
from scoup.evaluate.tables import Table
from scoup.query.presence import PRESENT_FROM


def auc(present: np.ndarray, absent: np.ndarray) -> float:
    """Chance that a present question has the larger value than an absent one; ties count half."""
    both = np.concatenate([present, absent])
    order = np.argsort(both, kind="stable")
    values = both[order]
    starts = np.flatnonzero(np.diff(values, prepend=np.nan) != 0)
    ends = np.append(starts[1:], len(values))
    ranks = np.empty(len(values))
    for start, end in zip(starts, ends, strict=True):
        ranks[order[start:end]] = (start + end - 1) / 2
    wins = ranks[: len(present)].sum() - len(present) * (len(present) - 1) / 2
    return float(wins / (len(present) * len(absent)))


@dataclass(frozen=True)
class PresenceScore:
    """Of a rule that says present or not.

    Attributes:
        precision, recall: of "present", the kinds weighed as often as they occur.
        absent_refused, out_of_view_refused: share of these questions that get nothing; NaN where there are none.
    """

    precision: float
    recall: float
    absent_refused: float
    out_of_view_refused: float

    @property
    def f1(self) -> float:
        total = self.precision + self.recall
        return 2 * self.precision * self.recall / total if total else 0.0


def presence_score(questions: Sequence[Question], said: np.ndarray) -> PresenceScore:
    """Of the answers ``said`` [M] boolean."""
    kinds = np.array([question.kind for question in questions])
    there = np.isin(kinds, (PRESENT, IN_SCENE))
    hits = int((said & there).sum())

    def refused(kind: str) -> float:
        return float((~said[kinds == kind]).mean()) if (kinds == kind).any() else float("nan")

    return PresenceScore(
        hits / max(1, int(said.sum())),
        hits / max(1, int(there.sum())),
        refused(ABSENT),
        refused(OUT_OF_VIEW),
    )


def best_bound(values: np.ndarray, present: np.ndarray) -> float:
    """The bound midway between two values that separates best, both classes counting alike.

    Raises:
        InputError: a class is empty.
    """
    if present.all() or not present.any():
        raise InputError("to choose a bound one needs answers of both kinds, present and absent")
    ordered = np.unique(values)
    candidates = np.concatenate([[ordered[0]], (ordered[1:] + ordered[:-1]) / 2])
    gains = [(values[present] >= bound).mean() + (values[~present] < bound).mean() for bound in candidates]
    return float(candidates[int(np.argmax(gains))])


def held_out_answers(questions: Sequence[Question], signal: str) -> np.ndarray:
    """[M] boolean: what a bound on a signal says that was chosen on all other scenes.

    Raises:
        InputError: there is one scene only.
    """
    scenes = sorted({question.scene for question in questions})
    if len(scenes) < 2:
        raise InputError("a bound must be judged on other scenes than it was chosen on; give two or more")
    values = np.array([question.signals[SIGNALS.index(signal)] for question in questions])
    present = np.array([question.kind in (PRESENT, IN_SCENE) for question in questions])
    said = np.zeros(len(questions), bool)
    for scene in scenes:
        mine = np.array([question.scene == scene for question in questions])
        said[mine] = values[mine] >= best_bound(values[~mine], present[~mine])
    return said


def presence_report(questions: Sequence[Question], settings: dict[str, Any]) -> StudyReport:
    """Tables of the signals one by one, of rules in views and of rules in whole scenes; the record of all, with the
    ``settings``."""
    in_views = [question for question in questions if question.frame]
    of_scenes = [question for question in questions if not question.frame]
    first, by_signal = _signal_table(in_views)
    rules = {"the protocols' rule (paints always)": np.ones(len(in_views), bool)}
    rules[f"z-score, {PRESENT_FROM:g} or more (the default)"] = _z_scores(in_views) >= PRESENT_FROM
    rules |= {
        f"{signal}, bound chosen on the other scenes": held_out_answers(in_views, signal)
        for signal in ("z-score", "inside", "peak")
    }
    second, of_rules = _rule_table(in_views, rules, "Presence in a view")
    rules = {"always there": np.ones(len(of_scenes), bool)}
    rules[f"z-score, {PRESENT_FROM:g} or more (the default)"] = _z_scores(of_scenes) >= PRESENT_FROM
    rules["z-score, bound chosen on the other scenes"] = held_out_answers(of_scenes, "z-score")
    third, in_scene = _rule_table(of_scenes, rules, "Presence in a scene, by the Gaussians selected")
    bounds = {
        name: best_bound(_z_scores(part), np.array([q.kind in (PRESENT, IN_SCENE) for q in part]))
        for name, part in (("query", in_views), ("select", of_scenes))
    }
    record = {
        **settings,
        "questions": {kind: sum(q.kind == kind for q in in_views) for kind in (PRESENT, OUT_OF_VIEW, ABSENT)},
        "auc": by_signal,
        "rules": of_rules,
        "scene_rules": in_scene,
        "bounds": bounds,
        "z_scores": [[q.scene, q.frame, q.word, q.kind, round(q.signals[0], 3)] for q in questions],
    }
    return StudyReport("presence", "Presence", [first, second, third], record)


def _z_scores(questions: Sequence[Question]) -> np.ndarray:
    return np.array([question.signals[0] for question in questions])


def _signal_table(questions: Sequence[Question]) -> tuple[Table, dict[str, Any]]:
    kinds = {kind: [q for q in questions if q.kind == kind] for kind in (PRESENT, OUT_OF_VIEW, ABSENT)}
    rows, by_signal = [], {}
    for number, name in enumerate(SIGNALS):
        values = {kind: np.array([q.signals[number] for q in of_kind]) for kind, of_kind in kinds.items()}
        found = {
            kind: auc(values[PRESENT], values[kind]) if len(values[kind]) else float("nan")
            for kind in (ABSENT, OUT_OF_VIEW)
        }
        by_signal[name] = {kind: None if np.isnan(value) else value for kind, value in found.items()}
        rows.append((name, *(f"{value:.3f}" for value in found.values())))
    counts = ", ".join(f"{len(of_kind)} {kind}" for kind, of_kind in kinds.items())
    table = Table(
        "Presence: signals one by one",
        ("signal", "AUC, present against absent", "AUC, present against out of view"),
        tuple(rows),
        (f"Questions: {counts}.", "0.5 says nothing; below it, the signal points the other way."),
    )
    return table, by_signal


def _rule_table(
    questions: Sequence[Question], rules: dict[str, np.ndarray], title: str
) -> tuple[Table, dict[str, Any]]:
    rows, record = [], {}
    for name, said in rules.items():
        score = presence_score(questions, said)
        refused = [score.absent_refused]
        if any(question.kind == OUT_OF_VIEW for question in questions):
            refused.append(score.out_of_view_refused)
        figures = (score.precision, score.recall, score.f1, *refused)
        names = ("precision", "recall", "f1", "absent_refused", "out_of_view_refused")
        record[name] = dict(zip(names, figures, strict=False))
        rows.append((name, *(f"{figure:.3f}" for figure in figures)))
    headers = ("rule", "precision", "recall", "F1", "absent refused", "out of view refused")
    note = "Bounds chosen on the other scenes separate best there, both kinds counting alike."
    return Table(title, headers[: len(rows[0])], tuple(rows), (note,)), record
