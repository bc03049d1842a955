"""Presence on labelled scenes: which signal tells absent things from present ones, and how well a model calibrated on
other scenes does (docs/evaluation.md).

Three kinds of questions are asked of every labelled view: for what is labelled in it (present), for what is labelled in
other views of the scene but not in this one (out of view), and for words of things that the scene does not have
(absent).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from scoup import raster
from scoup.baselines.methods import coded_field
from scoup.coding import fit_codes
from scoup.errors import InputError
from scoup.evaluate.datasets import EvalScene
from scoup.evaluate.prepared import PreparedScene
from scoup.evaluate.tables import Table
from scoup.pipeline import BuildSettings
from scoup.presence import SIGNALS, PresenceModel, fit_presence, rendered_mean, signals_of, vote_entropy
from scoup.progress import Progress, no_progress
from scoup.query import PRESETS, QueryPreset
from scoup.rounds import accumulate
from scoup.uplifting import top_k

WITH_VOTES = (*SIGNALS, "entropy", "vote entropy", "vote weight")
"""All signals measured: the mean inside the mask of the entropy of the stored codes, of that of the whole votes and
of the logarithm of their weight; the last two need the accumulators, which fields seldom keep."""
PRESENT, OUT_OF_VIEW, ABSENT = "present", "out of view", "absent"
_WORDS = "absent.txt"


@dataclass(frozen=True)
class Question:
    """One word asked in one view.

    Attributes:
        scene, frame, word: which.
        kind: ``PRESENT``, ``OUT_OF_VIEW`` or ``ABSENT``.
        signals: in the order of ``WITH_VOTES``.
        painted: whether the protocol's rule paints anything.
    """

    scene: str
    frame: str
    word: str
    kind: str
    signals: tuple[float, ...]
    painted: bool


def absent_words(scene: EvalScene, others: Sequence[EvalScene]) -> list[str]:
    """Words of things that a scene does not have: the lines of its ``absent.txt``, or what other scenes are labelled
    with.

    Raises:
        InputError: there are none.
    """
    path = scene.folder / _WORDS
    if path.is_file():
        found = [line.strip() for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]
    else:
        found = sorted({label for other in others for label in other.labels})
    found = [word for word in dict.fromkeys(found) if word not in scene.labels]
    if not found:
        raise InputError(f"{scene.folder}: no word is known to be absent; list some in {_WORDS}, one a line")
    return found


def ask_scene(
    scene: PreparedScene,
    absent: dict[str, Tensor],
    settings: BuildSettings,
    preset: QueryPreset = PRESETS["default"],
    progress: Progress = no_progress,
) -> list[Question]:
    """Build a field and ask everything of every labelled view.

    Args:
        scene: rasterised once.
        absent: word -> [D] unit vector, of things the scene does not have.
        settings: of the build.
        preset: by which answers are made.
        progress: told after each view.
    """
    books = [
        fit_codes(rows, settings.n_atoms, settings.k, settings.solver, settings.seed, settings.epochs)
        for rows in scene.embeddings()
    ]
    codebook = torch.stack([book.atoms for book in books])
    keep = settings.keep or None
    codes = [book.codes for book in books]
    accumulators = accumulate(scene.gathered(), codes, codebook, settings.rounds, keep or settings.k)
    indices, weights = top_k(accumulators, keep)
    weights = weights.half()
    made = coded_field(indices, weights, codebook)
    coded = (weights > 0).any(-1)
    values = [vote_entropy(weights), vote_entropy(accumulators), torch.log1p(accumulators.sum(-1))]

    words = {**scene.asked.vectors, **absent}
    queries = torch.stack(list(words.values()))
    questions = []
    progress(f"presence {scene.name}", 0, len(scene.scene.frames))
    for done, (frame, camera) in enumerate(scene.scene.frames, start=1):
        view = raster.look(scene.gaussians, camera, scene.raster_preset)
        extra = [rendered_mean(view, each, coded) for each in values]
        maps = made.relevancy(view, queries, scene.asked.canonical)
        for position, word in enumerate(words):
            found = signals_of(maps[:, position], extra, preset)
            kind = ABSENT if word in absent else PRESENT if word in frame.masks else OUT_OF_VIEW
            # The rescaling paints something unless the map is constant.
            painted = bool(found[2] != 0)
            questions.append(Question(scene.name, frame.name, word, kind, tuple(found.tolist()), painted))
        progress(f"presence {scene.name}", done, len(scene.scene.frames))
    return questions


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
        precision, recall: of "present", the kinds weighed as they were asked.
        absent_refused, out_of_view_refused: share of these questions that get nothing; NaN where none was asked.
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
    hits = int((said & (kinds == PRESENT)).sum())

    def refused(kind: str) -> float:
        return float((~said[kinds == kind]).mean()) if (kinds == kind).any() else float("nan")

    return PresenceScore(
        hits / max(1, int(said.sum())),
        hits / max(1, int((kinds == PRESENT).sum())),
        refused(ABSENT),
        refused(OUT_OF_VIEW),
    )


def calibrated(questions: Sequence[Question], names: Sequence[str] = SIGNALS) -> PresenceModel:
    """A model fitted to all questions, with the threshold for whole scenes: the one that tells best, both classes
    alike, by the largest probability over views."""
    chosen = [WITH_VOTES.index(name) for name in names]
    rows = torch.tensor([question.signals for question in questions]).double()[:, chosen]
    present = torch.tensor([question.kind == PRESENT for question in questions])
    scenes = sorted({question.scene for question in questions})
    told = f"{len(questions)} questions in {len(scenes)} scenes ({', '.join(scenes)})"
    model = fit_presence(rows, present, names, told)
    peaks: dict[tuple[str, str], float] = {}
    truths: dict[tuple[str, str], bool] = {}
    for question, chance in zip(questions, model.probability(rows).tolist(), strict=True):
        key = question.scene, question.word
        peaks[key] = max(peaks.get(key, 0.0), chance)
        truths[key] = truths.get(key, False) or question.kind != ABSENT
    values, truth = np.array(list(peaks.values())), np.array(list(truths.values()))
    return replace(model, scene_threshold=_best_threshold(values, truth))


def _best_threshold(values: np.ndarray, truth: np.ndarray) -> float:
    """The threshold midway between two values that tells best, both classes counting alike; 0.5 where one is empty."""
    if truth.all() or not truth.any():
        return 0.5
    ordered = np.unique(values)
    candidates = np.concatenate([[0.0], (ordered[1:] + ordered[:-1]) / 2, [1.0]])
    gains = [(values[truth] >= bound).mean() + (values[~truth] < bound).mean() for bound in candidates]
    return float(candidates[int(np.argmax(gains))])


def held_out_answers(questions: Sequence[Question], names: Sequence[str] = SIGNALS) -> np.ndarray:
    """[M] boolean: what a model says that was calibrated on all other scenes.

    Raises:
        InputError: there is one scene only.
    """
    scenes = sorted({question.scene for question in questions})
    if len(scenes) < 2:
        raise InputError("a model must be judged on other scenes than it was calibrated on; give two or more")
    chosen = [WITH_VOTES.index(name) for name in names]
    rows = torch.tensor([question.signals for question in questions]).double()[:, chosen]
    said = np.zeros(len(questions), bool)
    for scene in scenes:
        mine = np.array([question.scene == scene for question in questions])
        model = calibrated([q for q, out in zip(questions, mine, strict=True) if not out], names)
        said[mine] = (model.probability(rows[torch.from_numpy(mine)]) >= model.threshold).numpy()
    return said


RULES: dict[str, tuple[str, ...]] = {
    "peak alone": ("peak",),
    "peak, inside, contrast": SIGNALS,
    "and entropy of the stored codes": (*SIGNALS, "entropy"),
    "and votes (needs accumulators)": WITH_VOTES,
}
"""Models compared, by the signals they take."""


def presence_tables(questions: Sequence[Question]) -> tuple[list[Table], dict[str, Any]]:
    """Signals one by one, rules on held-out scenes, and the record of both."""
    kinds = {kind: [q for q in questions if q.kind == kind] for kind in (PRESENT, OUT_OF_VIEW, ABSENT)}
    rows, by_signal = [], {}
    for number, name in enumerate(WITH_VOTES):
        values = {kind: np.array([q.signals[number] for q in of_kind]) for kind, of_kind in kinds.items()}
        found = {
            kind: auc(values[PRESENT], values[kind]) if len(values[kind]) else float("nan")
            for kind in (ABSENT, OUT_OF_VIEW)
        }
        by_signal[name] = {kind: None if np.isnan(value) else value for kind, value in found.items()}
        rows.append((name, *(f"{value:.3f}" for value in found.values())))
    counts = ", ".join(f"{len(of_kind)} {kind}" for kind, of_kind in kinds.items())
    first = Table(
        "Presence: signals one by one",
        ("signal", "AUC, present against absent", "AUC, present against out of view"),
        tuple(rows),
        (f"Questions: {counts}.", "0.5 tells nothing; below it, the signal points the other way."),
    )
    rules = {"the protocols' rule (paints always)": np.array([question.painted for question in questions])}
    rules |= {name: held_out_answers(questions, names) for name, names in RULES.items()}
    rows, record = [], {}
    for name, said in rules.items():
        score = presence_score(questions, said)
        record[name] = {
            "precision": score.precision,
            "recall": score.recall,
            "f1": score.f1,
            "absent_refused": None if np.isnan(score.absent_refused) else score.absent_refused,
            "out_of_view_refused": None if np.isnan(score.out_of_view_refused) else score.out_of_view_refused,
        }
        figures = (score.precision, score.recall, score.f1, score.absent_refused, score.out_of_view_refused)
        rows.append((name, *(f"{figure:.3f}" for figure in figures)))
    second = Table(
        "Presence: calibrated on other scenes",
        ("rule", "precision", "recall", "F1", "absent refused", "out of view refused"),
        tuple(rows),
        (
            "Each scene is judged by a model calibrated on all the others; both classes count alike in the fit.",
        ),
    )
    return [first, second], {
        "questions": {k: len(v) for k, v in kinds.items()},
        "auc": by_signal,
        "rules": record,
    }
