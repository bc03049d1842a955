"""Answers of ways of building a field, once in the scene, and their masks in views: one rule for all ways."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from benchmarks.answer_scenes import AnswerScene
from scoup import raster
from scoup.query import Question, constants, select_by_relevancy
from scoup.query.answer_scene import each_answer
from scoup.query.field_view import counting_gaussians
from scoup_lab.baselines.fitted import FittedField, FittedMethod
from scoup_lab.evaluate.metrics import iou


@dataclass(frozen=True, eq=False)
class DrawnAnswer:
    """The Gaussians that answer a text."""

    mask: Tensor  # [N] boolean
    counting: Tensor  # [N] boolean, those whose contributions it must exceed half of
    score: float | None = None  # None of ways that are no field
    runner_up: DrawnAnswer | None = None  # that is named beside it


def question_of(scene: AnswerScene, texts: Sequence[str], everyday: Tensor) -> Question:
    """Return the question of some words of a scene; presence is scored and not judged."""
    queries = torch.stack([scene.everyday[scene.words.index(text)] for text in texts])
    return Question(tuple(texts), queries, everyday, scene.everyday, scene.name)


def answers_of(
    scene: AnswerScene, fitted: FittedMethod, texts: Sequence[str], everyday: Tensor
) -> dict[str, DrawnAnswer]:
    """Return the answer to each word: a field's own, and of other ways the Gaussians that their relevancy selects.

    ``everyday``: [P, D] canonical phrases and the mean of everyday words.
    """
    question = question_of(scene, texts, everyday)
    if isinstance(fitted, FittedField):
        field = fitted.field
        field.attach(scene.gaussians, known=True)
        found, table = {}, field.thing_table
        for answer in list(each_answer(field, question)):
            rival = answer.runner_up
            other = None
            if rival is not None and table is not None:
                owned = table.owned[int(table.levels[rival.thing])].cpu()
                other = DrawnAnswer(table.members(torch.tensor([rival.thing])).cpu(), owned)
            counting = counting_gaussians(field, answer)
            found[answer.text] = DrawnAnswer(answer.mask, counting, answer.score, other)
        return found
    coded, found = fitted.coded(), {}
    for text, query in zip(texts, question.queries, strict=True):
        selected = select_by_relevancy(fitted.gaussian_relevancy(query[None], everyday)[:, 0], coded)
        found[text] = DrawnAnswer(selected.mask, coded[selected.level])
    return found


def mask_ious(scene: AnswerScene, answers: Mapping[str, DrawnAnswer]) -> list[float]:
    """Return the IoU of the mask of each (frame, label) pair, in the order of ``AnswerScene.pairs``."""
    found = []
    for frame, view in scene.frames:
        masks = drawn_masks([answers[label] for label in frame.labels], view)
        found += [iou(mask, frame.masks[label]) for label, mask in zip(frame.labels, masks, strict=True)]
    return found


def object_ious(scene: AnswerScene, answers: Mapping[str, DrawnAnswer]) -> list[float]:
    """Return the IoU of each label over all scored views together, in the order of ``AnswerScene.queries``: also over
    those without it, and times the share of the answer's Gaussians that any of them shows."""
    labels, both, either = (
        list(scene.queries),
        torch.zeros(len(scene.queries)),
        torch.zeros(len(scene.queries)),
    )
    for frame, view in scene.frames:
        nothing = torch.zeros(view.height, view.width, dtype=torch.bool)
        for place, mask in enumerate(drawn_masks([answers[label] for label in labels], view)):
            truth = frame.masks.get(labels[place], nothing)
            both[place] += (mask & truth).sum()
            either[place] += (mask | truth).sum()
    shown = torch.stack([camera.shows(scene.gaussians.means) for camera in scene.cameras]).any(0)
    seen = [
        float((answers[label].mask & shown).sum() / answers[label].mask.sum().clamp(min=1))
        for label in labels
    ]
    return [share * value for share, value in zip(seen, (both / either.clamp(min=1)).tolist(), strict=True)]


def drawn_masks(answers: Sequence[DrawnAnswer], view: raster.Projection) -> list[Tensor]:
    """Return the pixels [H, W] boolean of each answer (``scoup.query.field_view.FieldView.masks``)."""
    values = torch.stack([part for answer in answers for part in (answer.mask, answer.counting)], 1)
    image = raster.render_values(view, values.float())
    return [
        mask > constants.PIXEL_SHARE * whole
        for mask, whole in image.unflatten(2, (-1, 2)).permute(2, 3, 0, 1)
    ]
