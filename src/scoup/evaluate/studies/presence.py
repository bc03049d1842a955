"""Presence on labelled scenes: signals that may separate absent things from present ones (docs/evaluation.md).

Every labelled view is queried for three kinds of words: labels of the view (present), labels of other views of the
scene (out of view), and things that the scene does not have (absent). Then the scene as a whole is queried for every
word, by the Gaussians selected for it. ``presence_scores`` judges the signals.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from scoup import raster
from scoup.base.errors import InputError
from scoup.base.progress import Progress, no_progress
from scoup.baselines.method import MethodSettings
from scoup.baselines.rasterised_scene import RasterisedScene
from scoup.baselines.sparse import SparseUplift, vote_codes, vote_entropy
from scoup.evaluate.data_sets import LabelledScene
from scoup.evaluate.studies.study_scene import StudyScene
from scoup.field.language_field import LanguageField
from scoup.models.words import with_everyday
from scoup.query.presence import scene_z_scores, view_z_scores
from scoup.query.presets import QUERY_PRESETS, QueryPreset
from scoup.query.segment import choose_level, level_masks, segment
from scoup.query.select import select_each
from scoup.query.text_vectors import TextVectors
from scoup.uplift.build_settings import BuildSettings

SIGNALS = ("z-score", "peak", "inside", "contrast", "entropy", "vote entropy", "vote weight")
"""All signals measured: the z-score of the query against everyday words (``scoup.query.presence``); the largest
smoothed relevancy; its mean inside the mask; how far that lies above the mean outside; the mean inside the mask of the
entropy of the stored codes, of that of the whole votes, and of the logarithm of the weight painted."""
PRESENT, OUT_OF_VIEW, ABSENT, IN_SCENE = "present", "out of view", "absent", "in the scene"
_WORDS = "absent.txt"
_LOWEST = -1e3  # z-score where nothing was found: tables and JSON know no infinity


@dataclass(frozen=True)
class Question:
    """One word queried in one view, or in a whole scene.

    Attributes:
        scene, word: which.
        frame: "" for a whole scene.
        kind: ``PRESENT``, ``OUT_OF_VIEW`` or ``ABSENT`` in a view; ``IN_SCENE`` or ``ABSENT`` in a scene.
        signals: in the order of ``SIGNALS``; for a scene the first alone.
    """

    scene: str
    frame: str
    word: str
    kind: str
    signals: tuple[float, ...]


def absent_words(scene: LabelledScene, others: Sequence[LabelledScene]) -> list[str]:
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


def query_scene(
    scene: StudyScene,
    absent: TextVectors,
    settings: BuildSettings,
    preset: QueryPreset = QUERY_PRESETS["default"],
    progress: Progress = no_progress,
) -> list[Question]:
    """Build a field and query every labelled view, and the scene, for all words.

    Args:
        scene: rasterised once.
        absent: words of things that the scene does not have.
        settings: of the build.
        preset: by which answers are made.
        progress: called after each view.
    """
    field, vote_values = _field(scene.rasterised, settings)
    words, queries = (*scene.vectors.texts, *absent.texts), torch.cat([scene.vectors.queries, absent.queries])
    everyday = absent.everyday
    canonical = with_everyday(scene.vectors.canonical, everyday)
    questions = []
    frames = scene.labelled.frames
    progress(f"presence {scene.name}", 0, len(frames))
    for done, (frame, camera) in enumerate(frames, start=1):
        projection = field.project(camera)
        extra = [rendered_mean(projection, each, field.code_weights.any(-1)) for each in vote_values]
        maps = field.relevancy(camera, queries, canonical, projection)
        answers = [segment(each, preset) for each in maps.unbind(1)]
        z_scores = view_z_scores(field, projection, answers, queries, everyday).clamp(min=_LOWEST).tolist()
        for position, (word, z_score) in enumerate(zip(words, z_scores, strict=True)):
            found = signals_of(maps[:, position], extra, preset)
            kind = ABSENT if word in absent.texts else PRESENT if word in frame.masks else OUT_OF_VIEW
            questions.append(Question(scene.name, frame.name, word, kind, (z_score, *found)))
        progress(f"presence {scene.name}", done, len(frames))
    selections = select_each(field, queries, canonical)
    z_scores = scene_z_scores(field, selections, queries, everyday).clamp(min=_LOWEST).tolist()
    for word, z_score in zip(words, z_scores, strict=True):
        kind = ABSENT if word in absent.texts else IN_SCENE
        questions.append(Question(scene.name, "", word, kind, (z_score,)))
    return questions


def _field(scene: RasterisedScene, settings: BuildSettings) -> tuple[LanguageField, list[Tensor]]:
    """The field, and values [N, S]: entropy of the codes, of the whole votes, and the weight painted."""
    field = SparseUplift()(scene.inputs(), MethodSettings(settings.seed, settings)).field
    field.attach(scene.gaussians, known=True)
    sums = scene.region_sums()
    whole, _ = vote_codes(scene.inputs(), settings, all_kept=True)
    painted = [torch.from_numpy(sums.matrix(level).sum(1)) for level in range(len(field.levels))]
    entropies = vote_entropy(field.code_weights), vote_entropy(whole.weights)
    return field, [*entropies, torch.log1p(torch.stack(painted, 1))]


def rendered_mean(projection: raster.Projection, values: Tensor, coded: Tensor) -> Tensor:
    """[S, H, W] mean of values [N, S] over the coded Gaussians [N, S] that paint each pixel; 1 where none does."""
    counted = coded.float()
    image, _ = raster.render_channels(projection, torch.cat([values.float() * counted, counted], 1))
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
        preset: by which the answer is made.
    """
    found = level_masks(relevancy, preset)
    level = choose_level(found, preset.level_choice)
    shown, mask = found.smoothed[level].double(), found.masks[level]
    inside = float(shown[mask].mean()) if mask.any() else 0.5
    outside = float(shown[~mask].mean()) if not mask.all() else inside
    contrast = inside - outside if mask.any() else 0.0
    more = [float((each[level][mask] if mask.any() else each[level]).double().mean()) for each in extra]
    return [float(shown.max()), inside, contrast, *more]
