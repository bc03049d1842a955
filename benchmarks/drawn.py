"""Answers of ways of building a field, once in the scene, and their masks in views: one rule for all ways."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from benchmarks.answer_scenes import AnswerScene
from scoup import raster
from scoup.query import Question, constants, select_by_relevancy
from scoup.query.ask import each_answer
from scoup.query.field_view import counting_gaussians
from scoup_lab.baselines.fitted import FittedField, FittedMethod


@dataclass(frozen=True, eq=False)
class DrawnAnswer:
    """The Gaussians that answer a text."""

    mask: Tensor  # [N] boolean
    counting: Tensor  # [N] boolean, those whose contributions it must exceed half of
    score: float | None = None  # None of ways that are no field
    runner_up: DrawnAnswer | None = None  # that is named beside it
    thing: int | None = None  # number of the first


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
            first = answer.things[0] if answer.things else None
            found[answer.text] = DrawnAnswer(answer.mask, counting, answer.score, other, first)
        return found
    coded, found = fitted.coded(), {}
    for text, query in zip(texts, question.queries, strict=True):
        selected = select_by_relevancy(fitted.gaussian_relevancy(query[None], everyday)[:, 0], coded)
        found[text] = DrawnAnswer(selected.mask, coded[selected.level])
    return found


def mask_ious(scene: AnswerScene, answers: Mapping[str, DrawnAnswer]) -> list[list[float]]:
    """Return the IoU of the mask of each (frame, label) pair, in the order of ``AnswerScene.pairs``, by each name of
    the label that has an answer."""
    found = overlaps(scene, answers)
    return [
        [1.0 if either == 0 else both / either for both, either in (of[number] for of in found[label])]
        for number, (frame, _) in enumerate(scene.frames)
        for label in frame.labels
    ]


def object_ious(scene: AnswerScene, answers: Mapping[str, DrawnAnswer]) -> list[float]:
    """Return the IoU of each label over all scored views together, in the order of ``AnswerScene.queries``: also over
    those without it, and times the share of the answer's Gaussians that any of them shows."""
    shown = torch.stack([camera.shows(scene.gaussians.means) for camera in scene.cameras]).any(0)
    found = []
    for label, (of_label, *_) in overlaps(scene, answers).items():
        both, either = (sum(numbers) for numbers in zip(*of_label, strict=True))
        seen = float((answers[label].mask & shown).sum() / answers[label].mask.sum().clamp(min=1))
        found.append(seen * both / max(1, either))
    return found


def overlaps(
    scene: AnswerScene, answers: Mapping[str, DrawnAnswer]
) -> dict[str, list[list[tuple[int, int]]]]:
    """Return, of each label by each of its names that has an answer, the pixels in both and in either of the answer's
    mask and the truth, in each labelled view."""
    known = scene.known_overlaps
    keys = {
        name: (label, answers[name].mask.numpy().tobytes(), answers[name].counting.numpy().tobytes())
        for label, names in scene.names.items()
        for name in names
        if name in answers
    }
    new = {key: name for name, key in keys.items() if key not in known}  # names may have the same answer
    for frame, view in scene.frames if new else ():
        nothing = torch.zeros(view.height, view.width, dtype=torch.bool)
        for key, mask in zip(new, drawn_masks([answers[name] for name in new.values()], view), strict=True):
            truth = frame.masks.get(key[0], nothing)
            known.setdefault(key, []).append((int((mask & truth).sum()), int((mask | truth).sum())))
    return {
        label: [known[keys[name]] for name in names if name in keys] for label, names in scene.names.items()
    }


def drawn_masks(answers: Sequence[DrawnAnswer], view: raster.Projection) -> list[Tensor]:
    """Return the pixels [H, W] boolean of each answer (``scoup.query.field_view.FieldView.masks``)."""
    values = torch.stack([part for answer in answers for part in (answer.mask, answer.counting)], 1)
    image = raster.render_values(view, values.float())
    return [
        mask > constants.PIXEL_SHARE * whole
        for mask, whole in image.unflatten(2, (-1, 2)).permute(2, 3, 0, 1)
    ]
