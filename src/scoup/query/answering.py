"""Queries answered: in one view, or in the scene as a whole."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import partial
from numbers import Integral
from typing import TypeAlias

from torch import Tensor

from scoup import raster
from scoup.base.arguments import check_arguments
from scoup.query.answer import Answer, SceneAnswer
from scoup.query.localize import Localization
from scoup.query.presence import scene_z_scores, view_z_scores
from scoup.query.presets import QUERY_PRESETS, QueryPreset
from scoup.query.queried_field import QueriedField
from scoup.query.segment import Segmentation, localize_and_segment, main_parts, mask_box
from scoup.query.select import select_each
from scoup.query.text_vectors import TextVectors
from scoup.query.view_depth import ViewDepth
from scoup.scene.cameras import Camera


def answer_view(
    field: QueriedField,
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
    check_arguments("answer_view", field=(field, QueriedField), camera=place, texts=(texts, TextVectors))
    camera = field.camera(camera)
    projection = field.project(camera) if projection is None else projection
    maps = field.relevancy(camera, texts.queries, texts.canonical, projection).unbind(1)
    chosen = None if level is None else field.level_index(level)
    found = [_found(each, preset, chosen) for each in maps]
    judged: list[float | None] = [None] * len(found)
    if present_from is not None:
        segmentations = [segmentation for _, segmentation in found]
        judged = view_z_scores(field, projection, segmentations, texts.queries, texts.everyday).tolist()
    render, depth = partial(_colors, field, camera), ViewDepth(field, camera, projection)
    return [
        replace(
            _answer(field.levels, *places, relevancy, z_score, present_from),
            text=text,
            view=camera.name,
            render=render,
            depth=depth,
        )
        for text, places, relevancy, z_score in zip(texts.texts, found, maps, judged, strict=True)
    ]


AnsweredViews: TypeAlias = "Iterator[tuple[Camera, raster.Projection, list[Answer]]]"
"""Views one after the other: camera, the field's projection to it, one answer a query."""


def answer_views(
    field: QueriedField,
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
    field: QueriedField,
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
    check_arguments("answer_scene", field=(field, QueriedField), texts=(texts, TextVectors))
    found = list(select_each(field, texts.queries, texts.canonical, threshold, neighbours, rescaled, level))
    judged: list[float | None] = [None] * len(found)
    if present_from is not None:
        judged = scene_z_scores(field, found, texts.queries, texts.everyday).tolist()
    answers = []
    for text, each, z_score in zip(texts.texts, found, judged, strict=True):
        presence = _presence(z_score, present_from)
        mask = each.mask.cpu() & presence
        answers.append(
            SceneAnswer(
                mask=mask,
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


def _found(relevancy: Tensor, preset: QueryPreset, level: int | None) -> tuple[Localization, Segmentation]:
    """Point and mask in relevancy [S, H, W], of one level if that is given."""
    if level is None:
        return localize_and_segment(relevancy, preset)
    place, shape = localize_and_segment(relevancy[level : level + 1], preset)
    return replace(place, level=level), replace(shape, level=level)


def _answer(
    levels: tuple[str, ...],
    place: Localization,
    shape: Segmentation,
    relevancy: Tensor,  # [S, H, W]
    z_score: float | None,
    present_from: float | None,
) -> Answer:
    presence = _presence(z_score, present_from)
    mask = shape.mask.cpu() & presence
    heat = relevancy[shape.level].clone().cpu()  # a copy, so that the other levels can be freed
    parts = main_parts(mask, place.pixel, heat)
    return Answer(
        mask=mask,
        heat=heat,
        main_parts=parts,
        box=mask_box(parts),
        coverage=shape.coverage if presence else 0.0,
        level=levels[shape.level],
        score=shape.score,
        point=place.pixel if presence else None,
        point_level=levels[place.level],
        point_score=place.score,
        z_score=z_score,
        presence=presence,
        threshold=shape.threshold,
    )


def _colors(field: QueriedField, camera: Camera) -> Tensor:
    return raster.render_colors(field.gaussians, camera, field.project(camera))


def _presence(z_score: float | None, present_from: float | None) -> bool:
    return z_score is None or present_from is None or z_score >= present_from
