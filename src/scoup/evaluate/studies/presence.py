"""Presence on labelled scenes: which signal tells absent things from present ones, and how well a bound on it does on
scenes that it was not chosen on (docs/evaluation.md).

Three kinds of questions are asked of every labelled view: for what is labelled in it (present), for what is labelled in
other views of the scene but not in this one (out of view), and for words of things that the scene does not have
(absent). Then every word is asked of the scene as a whole, through the Gaussians selected for it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from scoup import raster
from scoup.base.errors import InputError
from scoup.base.progress import Progress, no_progress
from scoup.baselines.methods import learn_codes, voted
from scoup.evaluate.datasets import EvalScene
from scoup.evaluate.studies.rasterised import PreparedScene
from scoup.evaluate.tables import Table
from scoup.field.language_field import FieldInfo, LanguageField
from scoup.models.words import with_everyday
from scoup.query.presence import PRESENT_FROM, scene_z_scores, view_z_scores, vote_entropy
from scoup.query.presets import QUERY_PRESETS, QueryPreset
from scoup.query.segment import choose_level, level_masks, segment
from scoup.query.select import select_each
from scoup.uplift.build_settings import BuildSettings

SIGNALS = ("z-score", "peak", "inside", "contrast", "entropy", "vote entropy", "vote weight")
"""All signals measured: the z-score (``scoup.query.presence``); the largest smoothed
relevancy; its mean inside the mask; how far that lies above the mean outside; the mean inside the mask of the entropy
of the stored codes, of that of the whole votes, and of the logarithm of the weight painted."""
PRESENT, OUT_OF_VIEW, ABSENT, IN_SCENE = "present", "out of view", "absent", "in the scene"
_WORDS = "absent.txt"
_LOWEST = -1e3  # z-score where nothing was found: tables and JSON know no infinity


@dataclass(frozen=True)
class Question:
    """One word asked in one view, or of a whole scene.

    Attributes:
        scene, word: which.
        frame: "" for a whole scene.
        kind: ``PRESENT``, ``OUT_OF_VIEW`` or ``ABSENT`` in a view; ``IN_SCENE`` or ``ABSENT`` of a scene.
        signals: in the order of ``SIGNALS``; of a scene, the first alone.
    """

    scene: str
    frame: str
    word: str
    kind: str
    signals: tuple[float, ...]


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
    everyday: Tensor,
    settings: BuildSettings,
    preset: QueryPreset = QUERY_PRESETS["default"],
    progress: Progress = no_progress,
) -> list[Question]:
    """Build a field and ask everything of every labelled view, and of the scene.

    Args:
        scene: rasterised once.
        absent: word -> [D] unit vector, of things the scene does not have.
        everyday: [B, D] unit vectors of everyday words.
        settings: of the build.
        preset: by which answers are made.
        progress: told after each view.
    """
    field, told = _build(scene, settings)
    words = {**scene.asked.vectors, **absent}
    queries = torch.stack(list(words.values()))
    canonical = with_everyday(scene.asked.canonical, everyday)
    questions = []
    progress(f"presence {scene.name}", 0, len(scene.scene.frames))
    for done, (frame, camera) in enumerate(scene.scene.frames, start=1):
        view = field.project(camera)
        extra = [rendered_mean(view, each, field.code_weights.any(-1)) for each in told]
        maps = field.relevancy(camera, queries, canonical, view)
        segmentations = [segment(each, preset) for each in maps.unbind(1)]
        scores = view_z_scores(field, view, segmentations, queries, everyday).clamp(min=_LOWEST).tolist()
        for position, (word, z_score) in enumerate(zip(words, scores, strict=True)):
            found = signals_of(maps[:, position], extra, preset)
            kind = ABSENT if word in absent else PRESENT if word in frame.masks else OUT_OF_VIEW
            questions.append(Question(scene.name, frame.name, word, kind, (z_score, *found)))
        progress(f"presence {scene.name}", done, len(scene.scene.frames))
    selections = select_each(field, queries, canonical)
    scores = scene_z_scores(field, selections, queries, everyday).clamp(min=_LOWEST).tolist()
    for word, z_score in zip(words, scores, strict=True):
        questions.append(Question(scene.name, "", word, ABSENT if word in absent else IN_SCENE, (z_score,)))
    return questions


def _build(scene: PreparedScene, settings: BuildSettings) -> tuple[LanguageField, list[Tensor]]:
    """The field, and what its votes say [N, S] each: entropy of the codes, of the votes, and the weight painted."""
    sums = scene.gathered()
    codes, codebook = learn_codes(scene.embeddings(), settings)
    found = voted(sums, codes, codebook, settings)
    info = FieldInfo(
        tuple(scene.regions.levels),
        "",
        scene.gaussians.fingerprint(),
        len(scene.gaussians),
        scene.raster_preset,
    )
    field = LanguageField(found.indices, found.weights, codebook, info, scene.gaussians)
    whole = voted(sums, codes, codebook, settings, all_kept=True)
    painted = [torch.from_numpy(sums.matrix(level).sum(1)) for level in range(len(codes))]
    told = [
        vote_entropy(field.code_weights),
        vote_entropy(whole.weights),
        torch.log1p(torch.stack(painted, 1)),
    ]
    return field, told


def rendered_mean(view: raster.Projection, values: Tensor, coded: Tensor) -> Tensor:
    """[S, H, W] mean of values [N, S] over the coded Gaussians [N, S] that paint each pixel; 1 where none does."""
    counted = coded.float()
    image, _ = raster.render_channels(view, torch.cat([values.float() * counted, counted], 1))
    summed, weight = image.permute(2, 0, 1).chunk(2)
    return torch.where(weight > 1e-6, summed / weight.clamp(min=1e-6), 1.0)


def signals_of(
    relevancy: Tensor, extra: Sequence[Tensor] = (), preset: QueryPreset = QUERY_PRESETS["default"]
) -> list[float]:
    """Peak, inside, contrast (``SIGNALS``), then the mean of each extra map inside the mask. An empty mask has 0.5, 0
    and, of each extra map, the mean over the view.

    Args:
        relevancy: [S, H, W] of one query.
        extra: maps [S, H, W], such as the entropy of the votes (``rendered_mean``).
        preset: what the answer is by.
    """
    smoothed, masks = level_masks(relevancy, preset)
    level = choose_level(smoothed, masks, preset.level_choice)
    shown, mask = smoothed[level].double(), masks[level]
    inside = float(shown[mask].mean()) if mask.any() else 0.5
    outside = float(shown[~mask].mean()) if not mask.all() else inside
    contrast = inside - outside if mask.any() else 0.0
    more = [float((each[level][mask] if mask.any() else each[level]).double().mean()) for each in extra]
    return [float(shown.max()), inside, contrast, *more]


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
    """The bound midway between two values that tells best, both classes counting alike.

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


def presence_tables(questions: Sequence[Question]) -> tuple[list[Table], dict[str, Any]]:
    """Signals one by one, rules, whole scenes, and the record of all."""
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
        "questions": {kind: sum(q.kind == kind for q in in_views) for kind in (PRESENT, OUT_OF_VIEW, ABSENT)},
        "auc": by_signal,
        "rules": of_rules,
        "scene_rules": in_scene,
        "bounds": bounds,
    }
    return [first, second, third], record


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
        (f"Questions: {counts}.", "0.5 tells nothing; below it, the signal points the other way."),
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
    note = "Bounds chosen on the other scenes tell best there, both kinds counting alike."
    return Table(title, headers[: len(rows[0])], tuple(rows), (note,)), record
