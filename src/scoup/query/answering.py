"""Queries answered: in one view, or in the scene as a whole."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import partial
from numbers import Integral
from typing import TypeAlias

from torch import Tensor

from scoup import raster
from scoup.base.arguments import check_arguments
from scoup.query.answer import Answer, SceneAnswer
from scoup.query.coded_scene import CodedScene
from scoup.query.localize import averaged_relevancy, best_pixel
from scoup.query.presence import scene_z_scores, view_z_scores, with_evidence
from scoup.query.presets import QUERY_PRESETS, QueryPreset
from scoup.query.segment import Segmentation, main_parts, mask_box, segment
from scoup.query.select import Selection, select_each
from scoup.query.text_vectors import TextVectors
from scoup.query.things import ThingFits, thing_of_scene, things_of_view
from scoup.query.view_depth import ViewDepth
from scoup.scene.cameras import Camera


def answer_view(
    field: CodedScene,
    camera: Camera | str | int,
    texts: TextVectors,
    preset: QueryPreset = QUERY_PRESETS["default"],
    present_from: float | None = None,
    projection: raster.Projection | None = None,
    level: str | int | None = None,
) -> list[Answer]:
    """Where each query is in one view, and which pixels are it.

    Args:
        field: to be queried.
        camera: of the view, or its name or position among the field's.
        texts: queries and what they are compared with (``scoup.query.text_vectors.encode_texts``);
            ``texts.with_everyday()`` is what `scoup query` uses.
        preset: how relevancy becomes points and masks.
        present_from: the z-score from which a thing counts as present (``scoup.query.presence.PRESENT_FROM``); None:
            presence is not judged, and something is found always.
        projection: what ``field.project(camera)`` gave, if it is known; keep it for further queries.
        level: the one that answers, its name or position; None: the preset chooses.

    Returns:
        One answer a query, in their order.

    Raises:
        InputError: the vectors do not fit the field, there is no such level, or there are too few everyday words to
            judge presence.
    """
    place = (camera, (Camera, str, Integral))
    check_arguments("answer_view", field=(field, CodedScene), camera=place, texts=(texts, TextVectors))
    camera = field.camera(camera)
    projection = field.project(camera) if projection is None else projection
    maps = field.relevancy(camera, texts.queries, texts.canonical, projection).unbind(1)
    chosen = None if level is None else field.level_index(level)
    found = [_segmented(each, preset, chosen) for each in maps]
    judged: list[float | None] = [None] * len(found)
    if present_from is not None:
        judged = view_z_scores(field, projection, found, texts.queries, texts.everyday).tolist()
    if field.things is not None and preset.follows_things:
        fits = ThingFits.of(field.things, texts)
        seen = things_of_view(fits, projection, [each.mask for each in found], chosen)
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
            _answer(field.levels, shape, relevancy, z_score, present_from),
            text=text,
            view=camera.name,
            render=render,
            depth=depth,
        )
        for text, shape, relevancy, z_score in zip(texts.texts, found, maps, judged, strict=True)
    ]


AnsweredViews: TypeAlias = "Iterator[tuple[Camera, raster.Projection, list[Answer]]]"
"""Views one after the other: camera, the field's projection to it, one answer a query."""


def answer_views(
    field: CodedScene,
    cameras: Iterable[Camera],
    texts: TextVectors,
    preset: QueryPreset = QUERY_PRESETS["default"],
    present_from: float | None = None,
    level: str | int | None = None,
) -> AnsweredViews:
    """``answer_view`` in one view after the other; arguments and errors as there."""
    for camera in cameras:
        projection = field.project(camera)
        yield camera, projection, answer_view(field, camera, texts, preset, present_from, projection, level)


def answer_scene(
    field: CodedScene,
    texts: TextVectors,
    threshold: float | None = None,
    neighbours: int | None = None,
    rescaled: bool = True,
    present_from: float | None = None,
    level: str | int | None = None,
) -> list[SceneAnswer]:
    """Which Gaussians answer each query, without rendering.

    Args:
        field: to be queried.
        texts: as for ``answer_view``.
        threshold, neighbours, rescaled: as for ``scoup.query.select.select``.
        present_from: as for ``answer_view``.
        level: the one that answers, its name or position; None: as ``select`` chooses.

    Returns:
        One answer a query, in their order.

    Raises:
        InputError: as ``answer_view``, or ``neighbours`` is below 1.
    """
    check_arguments("answer_scene", field=(field, CodedScene), texts=(texts, TextVectors))
    found = judged_selections(field, texts, threshold, neighbours, rescaled, present_from, level)
    answers = []
    for text, (each, z_score) in zip(texts.texts, found, strict=True):
        presence = _presence(z_score, present_from)
        answers.append(
            SceneAnswer(
                mask=each.mask.cpu() & presence,
                relevancy=each.relevancy.cpu(),
                level=field.levels[each.level],
                score=each.score,
                z_score=z_score,
                presence=presence,
                text=text,
                threshold=each.threshold,
            )
        )
    return answers


def judged_selections(
    field: CodedScene,
    texts: TextVectors,
    threshold: float | None = None,
    neighbours: int | None = None,
    rescaled: bool = True,
    present_from: float | None = None,
    level: str | int | None = None,
) -> Iterator[tuple[Selection, float | None]]:
    """What each text selects in the scene, one after the other, and how surely it is there; arguments as for
    ``answer_scene``.

    Things answer where the field has them, unless a threshold or neighbours of choice say how the votes are read.
    """
    things = field.things if threshold is None and neighbours is None and rescaled else None
    fits = None if things is None else ThingFits.of(things, texts)
    chosen = None if level is None else field.level_index(level)
    for number, found in enumerate(
        select_each(field, texts.queries, texts.canonical, threshold, neighbours, rescaled, level)
    ):
        query = texts.queries[number : number + 1]
        z_score = None
        if present_from is not None:
            z_score = float(scene_z_scores(field, [found], query, texts.everyday)[0])
        if fits is not None:
            thing = thing_of_scene(fits, number, found.mask, chosen)
            found = found if thing is None else _selected_thing(field, found, query, texts.canonical, *thing)
            z_score = None if z_score is None else z_score + fits.presence(number)
        yield found, None if z_score is None else with_evidence(z_score, found.mask)


def _segmented(relevancy: Tensor, preset: QueryPreset, level: int | None) -> Segmentation:
    """The mask that the votes give in relevancy [S, H, W], of one level if that is given."""
    if level is None:
        return segment(relevancy, preset)
    return replace(segment(relevancy[level : level + 1], preset), level=level)


def _of_thing(voted: Segmentation, relevancy: Tensor, mask: Tensor, level: int) -> Segmentation:
    """The mask of a thing in the place of the votes'."""
    smoothed = 0.5 * (
        relevancy[level] + averaged_relevancy(relevancy[level][None], QUERY_PRESETS["default"])[0]
    )
    coverage = int(mask.sum()) / mask.numel()
    mask = mask.to(smoothed.device)
    return Segmentation(mask, smoothed, level, float(smoothed[mask].max()), coverage, None)


def _selected_thing(
    field: CodedScene, voted: Selection, query: Tensor, canonical: Tensor, mask: Tensor, level: int
) -> Selection:
    """The Gaussians of a thing in the place of those that the votes select."""
    relevancy = voted.relevancy
    if level != voted.level:
        relevancy = field.gaussian_relevancy(query, canonical)[level, 0]
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
