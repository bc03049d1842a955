"""Pictures of fields: functions that draw a view, cameras and frames of videos, and the card of a notebook."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Literal, TypeAlias

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from scoup import raster
from scoup.base import PREVIEW, InputError, card, listed, spread
from scoup.field import Field
from scoup.pictures import (
    Picture,
    as_picture,
    captioned,
    code_basis,
    code_picture,
    heat_map,
    heat_overlay,
    swatch_legend,
)
from scoup.query.ask import answers_of
from scoup.query.edits import best_camera
from scoup.query.field_view import FieldView
from scoup.query.question import Question
from scoup.query.things import Place
from scoup.scene import Camera, Cameras, SparseCodes, estimate_up

AXES = 8  # directions of embedding space among which the three colours are chosen

CODE_LEGEND = "Like meaning, like colour; the same in every view."
LEGEND_ATOMS = 20  # whose colours a code picture lists, if there is room

LEVEL_NAMES = {"s": "s (fine)", "m": "m (medium)", "l": "l (coarse)"}

Draw: TypeAlias = Callable[[FieldView], Picture]
Motion = Literal["path", "turntable"]
MOST_STOPS = 40  # cameras that a path leads through
SHARE = 0.35  # of the picture's height for a thing on a turntable


def drawing(
    field: Field,
    what: Literal["color", "codes", "relevancy"],
    level: str | int | None = None,
    question: Question | None = None,
    plain: bool = False,
) -> Draw:
    """Return a function that draws a view: the splat, the codes of a level (by default the middle one), or the
    relevancy to a question's first text, at the level of its mask; ``plain``, here and below: without title and
    legend."""
    if what == "codes":
        return code_drawing(field, len(field.levels) // 2 if level is None else level, plain)
    answers = None if question is None else answers_of(field, question)

    def draw(view: FieldView) -> Picture:
        rgb = view.renders.colors().cpu()
        if answers is None:
            return as_picture(rgb) if plain else captioned(as_picture(rgb), "colour", view.camera.name)
        seen = view.show(answers)[0]
        if plain:
            return heat_overlay(seen.heat, rgb)
        return heat_map(seen.heat, rgb, seen.text, seen.level, float(seen.heat.max()), view.camera.name)

    return draw


def placed_atoms(atoms: Tensor) -> Tensor:
    """Return places [L, ``AXES``] of atoms [L, D] by their embeddings: colours of places tell meanings apart."""
    return atoms @ torch.linalg.svd(atoms, full_matrices=False).Vh[:AXES].T


def code_drawing(field: Field, level: str | int, plain: bool = False) -> Draw:
    """Return a function that draws the codes of one level as colours, which are the same in every view.

    The legend lists the atoms that lead the codes of most Gaussians, each with the mean colour of these.
    """
    row = field.level_index(level)
    gaussians, basis, leading = field.kept((_code_colors, row), lambda: _code_colors(field, row))
    name = field.levels[row]

    def draw(view: FieldView) -> Picture:
        image = raster.render_values(view.projection, gaussians.to(field.codebook.device))
        picture = code_picture(image, basis)
        if plain:
            return picture
        titled = captioned(picture, f"codes, level {LEVEL_NAMES.get(name, name)}", view.camera.name)
        return swatch_legend(titled, CODE_LEGEND, "most frequent atoms", [*leading.values()], [*leading])

    return draw


def _code_colors(
    field: Field, row: int
) -> tuple[Tensor, tuple[NDArray[np.float64], NDArray[np.float64]], dict[str, tuple[int, int, int]]]:
    """Return the weighted places [N, ``AXES``] of the atoms of each Gaussian; their ``code_basis``, so that colours are
    the same in every view; and the atoms that lead the codes of most Gaussians, with their colours."""
    placed = placed_atoms(field.codebook[row].cpu())
    indices, weights = field.code_indices[:, row].cpu(), field.code_weights[:, row].float().cpu()
    gaussians = SparseCodes(indices, weights, field.n_atoms).to_dense() @ placed  # [N, axes]
    basis = code_basis(gaussians)
    coded = weights.sum(1) > 0
    colors = code_picture(gaussians[None], basis)[0][coded.numpy()]
    atoms = indices.long().gather(1, weights.argmax(1, keepdim=True))[:, 0][coded].numpy()
    counts = np.bincount(atoms)
    leading = {}
    for atom in np.argsort(-counts, kind="stable")[:LEGEND_ATOMS].tolist():
        if counts[atom]:
            red, green, blue = colors[atoms == atom].mean(0).round().astype(int).tolist()
            leading[str(atom)] = red, green, blue
    return gaussians, basis, leading


def moving_cameras(field: Field, place: Place, cameras: Cameras, motion: Motion, count: int) -> Cameras:
    """Return the cameras of a video with ``count`` frames.

    "path" leads through the cameras; "turntable" goes around the thing at ``place``, from the camera that sees most of
    it.
    """
    if motion == "path":
        return camera_path(cameras, count)
    if place.position is None or place.box is None:
        raise InputError(
            f"{place.answer.text}: is not in this scene, so there is nothing to turn around; use a path"
        )
    up = estimate_up(cameras) if field.world.up is None else field.up()
    first = best_camera(field, place.answer.mask, list(cameras))
    size = float(place.box.extent.norm())
    arm = first.position - place.position
    length = float(arm.norm())
    near = size / SHARE / (first.height / first.fy)
    away = max(min(near, length), 0.75 * size) or length  # a single point has no size
    closer = Camera.look_at(
        place.position + arm * (away / (length or 1.0)),
        place.position,
        first.name,
        first.width,
        first.height,
        first.fy,
        up,
    )
    return turntable(closer, place.position, up, count)


def camera_path(cameras: Cameras, count: int) -> Cameras:
    """Return ``count`` cameras on a smooth path through those of a scene (of more than ``MOST_STOPS`` so many, evenly
    spread), in the order of their names, with the lens of the first."""
    from scipy.interpolate import PchipInterpolator
    from scipy.spatial.transform import Rotation, Slerp

    if not len(cameras) or count < 1:
        raise InputError(f"a path of {count} cameras through {len(cameras)} is not possible")
    stops = spread(list(cameras), MOST_STOPS)
    first = stops[0]
    if len(stops) == 1:
        return Cameras(replace(first, name=_frame_name(number), image_path=None) for number in range(count))
    places = np.stack([camera.position.numpy() for camera in stops])
    turns = Rotation.from_matrix(np.stack([camera.viewmat[:3, :3].numpy().T for camera in stops]))
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    # Times follow distances, so that the speed is even; a camera that only turns takes its time, too.
    times = np.concatenate([[0.0], np.cumsum(np.maximum(steps, 0.2 * (steps.mean() or 1.0)))])
    moments = np.linspace(0, times[-1], count)
    between, turned = PchipInterpolator(times, places)(moments), Slerp(times, turns)(moments).as_matrix()
    poses = np.concatenate([turned, between[:, :, None]], axis=2)
    size = (first.width, first.height)
    return Cameras(
        Camera.from_c2w(_frame_name(number), pose, first.K, *size) for number, pose in enumerate(poses)
    )


def turntable(camera: Camera, centre: Tensor | ArrayLike, up: Tensor | ArrayLike, count: int) -> Cameras:
    """Return ``count`` cameras, evenly on a circle around a point [3] and a direction ``up`` [3], which all look at it,
    with the lens and distance of one; they begin there."""
    from scipy.spatial.transform import Rotation

    point, axis = (torch.as_tensor(vector, dtype=torch.float64).numpy() for vector in (centre, up))
    arm = camera.position.numpy() - point
    length = np.linalg.norm(axis)
    if (
        count < 1
        or not length > 0
        or not np.linalg.norm(np.cross(arm, axis)) > 1e-6 * np.linalg.norm(arm) * length
    ):
        raise InputError(
            f"{count} cameras cannot turn around {point.tolist()} from {camera.position.tolist()}"
        )
    angles = np.arange(count) * (2 * math.pi / count)
    arms = Rotation.from_rotvec(angles[:, None] * (axis / length)).apply(arm)
    size = (camera.width, camera.height)
    return Cameras(
        Camera.look_at(point + arm, point, _frame_name(number), *size, camera.fy, axis)
        for number, arm in enumerate(arms)
    )


def _frame_name(number: int) -> str:
    return f"frame_{number:05d}.png"


def heat_frames(
    field: Field, place: Place, cameras: Cameras, motion: Motion, count: int
) -> Iterator[Picture]:
    """Yield heat maps of an answer at its level and with one scale of colours, [H, W, 3] uint8 each, from
    ``moving_cameras``."""
    answer = place.answer
    asked, level = answer.asked, answer.asked.level
    known = field.gaussian_relevancy(asked.query, asked.canonical)[level, 0][
        field.coded_levels()[level]
    ].cpu()
    span = (float(known.median()), float(known.max())) if len(known) else (0.0, 1.0)
    low = span[0]
    remark = f"level {answer.level}, {answer.remark()}"
    for camera in moving_cameras(field, place, cameras, motion, count):
        view = FieldView(field, camera)
        heat = view.relevancy(asked.query, asked.canonical)[level, 0].cpu()
        rgb = view.renders.colors().cpu()
        yield captioned(heat_overlay(torch.nan_to_num(heat, low), rgb, span), answer.text, remark)


def field_card(field: Field) -> str:
    """Return the HTML of the codes in one view and of the field's facts."""
    names = () if field.cameras is None else field.cameras.names
    facts = {
        "levels": ", ".join(field.levels),
        "atoms": field.n_atoms,
        "embeddings": f"{field.dim} dimensions, {field.embedding_model or 'an unnamed model'}",
        "cameras": f"{len(names):,}: {listed(names, 4)}" if names else 0,
        "file": field.path or "not saved",
    }
    return card(f"Language field of {len(field):,} Gaussians", facts, _preview(field))


def _preview(field: Field) -> Picture | None:
    """Return the codes of the middle level in the first camera; None without a camera or geometry."""
    if field.cameras is None or not len(field.cameras) or not len(field):
        return None
    try:
        view = FieldView(field, 0, min(1.0, PREVIEW[0] / field.cameras[0].width))
    except InputError:  # the geometry was moved; show the facts alone
        return None
    return drawing(field, "codes", plain=True)(view)
