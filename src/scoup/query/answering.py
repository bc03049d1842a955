"""Answers to questions, in one view or in the whole scene."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from numbers import Integral

from torch import Tensor

from scoup import raster
from scoup.base.arguments import check_arguments
from scoup.query.answer import Answer, SceneAnswer
from scoup.query.coded_scene import CodedScene
from scoup.query.localize import averaged_relevancy, best_pixel
from scoup.query.presence import scene_z_scores, view_z_scores, with_evidence
from scoup.query.presets import QUERY_PRESETS, QueryPreset
from scoup.query.question import Question
from scoup.query.segment import Segmentation, main_parts, mask_box, segment
from scoup.query.select import Selection, select_each
from scoup.query.things import thing_fits, thing_of_scene, things_of_view
from scoup.query.view_depth import ViewDepth
from scoup.scene.cameras import Camera


def answer_view(
    field: CodedScene,
    camera: Camera | str | int,
    question: Question,
    projection: raster.Projection | None = None,
) -> list[Answer]:
    """Answer each text in one view; ``field.answer`` calls this and documents the arguments.

    Raises:
        InputError: the vectors do not fit the field, there is no such level, or there are too few everyday words to
            judge presence.
    """
    place = (camera, (Camera, str, Integral))
    check_arguments("answer_view", field=(field, CodedScene), camera=place, question=(question, Question))
    camera = field.camera(camera)
    projection = field.project(camera) if projection is None else projection
    maps = field.relevancy(camera, question.queries, question.canonical, projection).unbind(1)
    found = [_segmented(each, question.preset, question.level) for each in maps]
    judged: list[float | None] = [None] * len(found)
    if question.present_from is not None:
        judged = view_z_scores(field, projection, found, question.queries, question.everyday).tolist()
    fits = thing_fits(field, question) if question.preset.follows_things else None
    if fits is not None:
        seen = things_of_view(fits, projection, [each.mask for each in found], question.level)
        found = [
            each if thing is None else _of_thing(each, relevancy, *thing)
            for each, relevancy, thing in zip(found, maps, seen.masks, strict=True)
        ]
        judged = [
            None if z is None else z + of_things for z, of_things in zip(judged, seen.presence, strict=True)
        ]
    render, depth = partial(_colors, field, camera), ViewDepth(field, camera, projection)
    return [
        replace(
            _answer(field.levels, shape, relevancy, z_score, question.present_from),
            text=text,
            view=camera.name,
            render=render,
            depth=depth,
        )
        for text, shape, relevancy, z_score in zip(question.texts, found, maps, judged, strict=True)
    ]


def answer_scene(field: CodedScene, question: Question) -> list[SceneAnswer]:
    """Answer each text in the scene, without rendering; ``field.select`` and ``field.location`` call this.

    Raises:
        InputError: as ``answer_view``, or ``neighbours`` is below 0.
    """
    check_arguments("answer_scene", field=(field, CodedScene), question=(question, Question))
    answers = []
    for text, (each, z_score) in zip(question.texts, judged_selections(field, question), strict=True):
        presence = _presence(z_score, question.present_from)
        answers.append(
            SceneAnswer(
                mask=each.mask.cpu() & presence,
                relevancy=each.relevancy.cpu().clone(),  # without the other levels
                level=field.levels[each.level],
                score=each.score,
                z_score=z_score,
                presence=presence,
                text=text,
                threshold=each.threshold,
            )
        )
    return answers


def judged_selections(field: CodedScene, question: Question) -> Iterator[tuple[Selection, float | None]]:
    """Yield the selection of each text in the scene, and its z-score.

    Things answer where the field has them, unless the question has rules for the votes: a threshold or neighbours.
    """
    threshold, neighbours = question.threshold, question.neighbours or None
    by_things = threshold is None and neighbours is None and question.rescaled
    fits = thing_fits(field, question) if by_things else None
    found_by_votes = select_each(
        field, question.queries, question.canonical, threshold, neighbours, question.rescaled, question.level
    )
    for number, found in enumerate(found_by_votes):
        query = question.queries[number : number + 1]
        z_score = None
        if question.present_from is not None:
            z_score = float(scene_z_scores(field, [found], query, question.everyday)[0])
        if fits is not None:
            thing = thing_of_scene(fits, number, found.mask, question.level)
            found = found if thing is None else _selected_thing(found, *thing)
            z_score = None if z_score is None else z_score + fits.presence(number)
        yield found, None if z_score is None else with_evidence(z_score, found.mask)


def _segmented(relevancy: Tensor, preset: QueryPreset, level: int | None) -> Segmentation:
    """The mask of the votes in relevancy [S, H, W], at one level if given."""
    if level is None:
        return segment(relevancy, preset)
    return replace(segment(relevancy[level : level + 1], preset), level=level)


def _of_thing(voted: Segmentation, relevancy: Tensor, mask: Tensor, level: int) -> Segmentation:
    """The mask of a thing instead of the votes'."""
    smoothed = 0.5 * (
        relevancy[level] + averaged_relevancy(relevancy[level][None], QUERY_PRESETS["default"])[0]
    )
    coverage = int(mask.sum()) / mask.numel()
    mask = mask.to(smoothed.device)
    return Segmentation(mask, smoothed, level, float(smoothed[mask].max()), coverage, None)


def _selected_thing(voted: Selection, mask: Tensor, level: int) -> Selection:
    """The Gaussians of a thing instead of those that the votes select."""
    relevancy = voted.relevancy
    if level != voted.level:
        assert voted.of_levels is not None
        relevancy = voted.of_levels[level]
    mask = mask.to(relevancy.device)
    return Selection(mask, relevancy, level, float(relevancy[mask].max()) if mask.any() else -math.inf, None)


def _answer(
    levels: tuple[str, ...],
    shape: Segmentation,
    relevancy: Tensor,  # [S, H, W]
    z_score: float | None,
    present_from: float | None,
) -> Answer:
    """Point, box and mask are of one thing at one level."""
    presence = _presence(z_score, present_from)
    mask = shape.mask.cpu() & presence
    heat = relevancy[shape.level].clone().cpu()  # a copy, so that the other levels can be freed
    point = best_pixel(shape.smoothed.cpu(), mask) if presence else None
    parts = mask if point is None else main_parts(mask, point, heat)
    return Answer(
        mask=mask,
        heat=heat,
        main_parts=parts,
        box=mask_box(parts),
        coverage=shape.coverage if presence else 0.0,
        level=levels[shape.level],
        score=shape.score,
        point=point,
        z_score=z_score,
        presence=presence,
        threshold=shape.threshold,
    )


def _colors(field: CodedScene, camera: Camera) -> Tensor:
    return raster.render_colors(field.gaussians, camera, field.project(camera))


def _presence(z_score: float | None, present_from: float | None) -> bool:
    return z_score is None or present_from is None or z_score >= present_from
