"""Answers to questions: decided once, in the scene, and drawn in views."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from numbers import Integral

import torch
from torch import Tensor

from scoup import raster
from scoup.base.arguments import check_arguments
from scoup.query.answer import Answer, AskedText, RunnerUp, ViewAnswer
from scoup.query.coded_scene import CodedScene
from scoup.query.instances import find_instances
from scoup.query.presence import LEAST_GAUSSIANS, NullScores, other_words
from scoup.query.question import Question
from scoup.query.select import SampledVotes, select_each
from scoup.query.things import choose_things, compare_things
from scoup.query.view_depth import ViewDepth
from scoup.query.view_masks import main_parts, mask_box, most_relevant_pixel
from scoup.scene.cameras import Camera, Cameras

INSIDE = 0.5
"""A pixel belongs to an answer whose Gaussians contribute more than this share of it."""


def answer_scene(field: CodedScene, question: Question) -> list[Answer]:
    """Answer each text in the scene; every way to ask calls this.

    Things answer where the field has them. The votes of the Gaussians answer in other fields, and where the question
    has a threshold for them.

    Raises:
        InputError: the vectors do not fit the field, or the threshold is not 0 to 1.
    """
    check_arguments("answer_scene", field=(field, CodedScene), question=(question, Question))
    answers = _by_things if question.threshold is None and field.thing_table is not None else _by_votes
    found = []
    for number, answer in enumerate(answers(field, question)):
        presence = question.present_from is None or (
            answer.score is not None
            and answer.score >= question.present_from
            and int(answer.mask.sum()) >= LEAST_GAUSSIANS
        )
        mask = answer.mask if presence else torch.zeros_like(answer.mask)
        asked = (AskedText(question.one(number), field.level_index(answer.level)),)
        kept = {} if presence else {"things": (), "instances": ()}
        found.append(replace(answer, mask=mask, presence=presence, asked=asked, field=field, **kept))
    return found


def _by_things(field: CodedScene, question: Question) -> Iterator[Answer]:
    known = compare_things(field, question)
    if known is None:
        yield from _by_votes(field, question)
        return
    fits = known.fits(question.queries.float().cpu())
    scores = null_scores(question, known.best_fits)
    level = question.level or 0
    for number, found in enumerate(choose_things(known, fits, question.level)):
        text, score = question.texts[number], scores[number]
        if found is None:
            nothing = torch.zeros(len(field), dtype=torch.bool)
            yield Answer(text, nothing, field.levels[level], 0.0 if question.can_judge_presence else None)
            continue
        level = int(known.things.levels[found.things[0]])
        rival = found.runner_up
        yield Answer(
            text=text,
            mask=known.things.members(found.things).cpu(),
            level=field.levels[level],
            score=score(found.fit),
            things=tuple(found.things.tolist()),
            instances=tuple(find_instances(known, fits[:, number], found.things).tolist()),
            runner_up=None if rival is None else RunnerUp(rival, score(float(fits[rival, number]))),
        )


def _by_votes(field: CodedScene, question: Question) -> Iterator[Answer]:
    scores: list[float | None] = [None] * len(question.texts)
    if question.can_judge_presence:
        votes = sampled_votes(field, question)
        null = null_scores(question, votes.best_fits)
        scores = [score(fit) for score, fit in zip(null, votes.fits(question.queries).tolist(), strict=True)]
    for number, (found, score) in enumerate(zip(select_each(field, question), scores, strict=True)):
        text, level = question.texts[number], field.levels[found.level]
        yield Answer(text, found.mask.cpu(), level, score, threshold=found.threshold)


def null_scores(question: Question, best_fits: Tensor) -> list[NullScores]:
    """Return the scores of each text against the best fits of everyday words [B]; none with too few words."""
    queries, words = question.queries.float().cpu(), question.everyday.float().cpu()
    if not question.can_judge_presence:
        return [NullScores(best_fits[:0], torch.zeros(0, dtype=torch.bool))] * len(queries)
    return [NullScores(best_fits, others) for others in other_words(queries, words)]


def sampled_votes(field: CodedScene, question: Question) -> SampledVotes:
    """Return the votes of some Gaussians of a field for everyday words; the last ones are kept."""
    key = SampledVotes.key(field, question)
    found = field.recent.get(key)
    if found is None:
        found = SampledVotes(field, question)
        field.recent.keep(key, found, found.best_fits.nbytes)
    return found


def draw_answers(
    field: CodedScene,
    answers: Sequence[Answer],
    camera: Camera | str | int,
    projection: raster.Projection | None = None,
    scale: float = 1.0,
) -> list[ViewAnswer]:
    """Draw answers of ``answer_scene`` in one view; ``Answer.in_view`` and ``field.answer`` document the arguments."""
    check_arguments("draw_answers", camera=(camera, (Camera, str, Integral)))
    camera = field.camera(camera)
    if scale != 1.0:
        camera = Cameras([camera]).scaled(scale)[0]
    projection = field.project(camera) if projection is None else projection
    masks = answer_masks(field, answers, projection)
    asked = [one for answer in answers for one in answer.asked]
    heats = iter(_heats(field, camera, asked, projection))
    render, depth = partial(_colors, field, camera), ViewDepth(field, camera, projection)
    found = []
    for answer, mask in zip(answers, masks, strict=True):
        heat = torch.stack([next(heats) for _ in answer.asked]).amax(0)
        parts, largest = main_parts(mask)
        point = most_relevant_pixel(heat, largest)
        found.append(
            ViewAnswer(answer, camera.name, mask, heat, parts, mask_box(parts), point, render, depth)
        )
    return found


def answer_masks(field: CodedScene, answers: Sequence[Answer], projection: raster.Projection) -> list[Tensor]:
    """Return the pixels [H, W] boolean of each answer, on the CPU (``ViewAnswer.mask``)."""
    masks = [torch.zeros(projection.height, projection.width, dtype=torch.bool) for _ in answers]
    shown = [number for number, answer in enumerate(answers) if bool(answer.mask.any())]
    if not shown:
        return masks
    wholes: list[Tensor] = []
    places: list[int] = []
    for number in shown:
        whole = counting_gaussians(field, answers[number])
        # Those of most answers are the same, and are rendered once.
        places.append(next((k for k, each in enumerate(wholes) if torch.equal(each, whole)), len(wholes)))
        if places[-1] == len(wholes):
            wholes.append(whole)
    values = torch.stack([*wholes, *(answers[number].mask for number in shown)], 1)
    image = raster.render_values(projection, values.float().to(field.codebook.device)).cpu()
    for column, (number, place) in enumerate(zip(shown, places, strict=True), start=len(wholes)):
        masks[number] = image[..., column] > INSIDE * image[..., place]
    return masks


def counting_gaussians(field: CodedScene, answer: Answer) -> Tensor:
    """Return the Gaussians [N] boolean whose contributions an answer must exceed half of.

    They are those that belong to any thing of its level, or where the votes answer, that have a code there.
    """
    found = answer.mask.clone()
    for part in answer.parts or (answer,):  # of an expression
        level = field.level_index(part.level)
        if field.thing_table is None or part.threshold is not None:
            found |= field.coded_levels()[level].cpu()
        else:
            found |= field.thing_table.owned[level].cpu()
    return found


def _heats(
    field: CodedScene, camera: Camera, asked: Sequence[AskedText], projection: raster.Projection
) -> list[Tensor]:
    """Return the relevancy [H, W] of each text at its level, on the CPU; texts of one question in one pass."""
    heats: list[Tensor] = [torch.empty(0)] * len(asked)
    for canonical in {id(one.question.canonical): one.question.canonical for one in asked}.values():
        mine = [number for number, one in enumerate(asked) if one.question.canonical is canonical]
        queries = torch.cat([asked[number].question.queries for number in mine])
        maps = field.relevancy(camera, queries, canonical, projection)
        for place, number in enumerate(mine):
            # A copy, so that the other levels can be freed.
            heats[number] = maps[asked[number].level, place].clone().cpu()
    return heats


def _colors(field: CodedScene, camera: Camera) -> Tensor:
    return raster.render_colors(field.gaussians, camera, field.project(camera))
