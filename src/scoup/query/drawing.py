"""Pictures of fields, one view at a time."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
import torch
from torch import Tensor

from scoup import raster
from scoup.pictures import (
    as_picture,
    captioned,
    code_basis,
    code_picture,
    heat_map,
    heat_overlay,
    stacked,
    swatch_legend,
)
from scoup.pictures.colors import Picture
from scoup.query.answering import answer_scene, draw_answers
from scoup.query.coded_scene import CodedScene
from scoup.query.question import Question
from scoup.scene.cameras import Camera
from scoup.scene.codes import SparseCodes

AXES = 8  # directions of embedding space among which the three colours are chosen

CODE_LEGEND = "Like meaning, like colour; the same in every view."
LEGEND_ATOMS = 20  # whose colours a code picture lists, if there is room

LEVEL_NAMES = {"s": "s (fine)", "m": "m (medium)", "l": "l (coarse)"}

Draw: TypeAlias = Callable[[Camera, raster.Projection], Picture]
"""A function that draws one view, given its camera and the field's projection to it."""


def color_drawing(field: CodedScene, plain: bool = False) -> Draw:
    """Return what draws the splat of a field; ``plain``, here and below: without title and legend."""

    def draw(camera: Camera, projection: raster.Projection) -> Picture:
        picture = as_picture(raster.render_colors(field.gaussians, camera, projection))
        return picture if plain else captioned(picture, "colour", camera.name)

    return draw


def relevancy_drawing(field: CodedScene, question: Question, plain: bool = False) -> Draw:
    """Return what draws a heat map of the relevancy to the first text of a question, at the level of its mask."""

    answers = answer_scene(field, question)

    def draw(camera: Camera, projection: raster.Projection) -> Picture:
        shown = draw_answers(field, answers, camera, projection)[0]
        rgb = raster.render_colors(field.gaussians, camera, projection).cpu()
        if plain:
            return heat_overlay(shown.heat, rgb)
        return heat_map(shown.heat, rgb, shown.text, shown.level, float(shown.heat.max()), camera.name)

    return draw


def placed_atoms(atoms: Tensor) -> Tensor:
    """Return places [L, ``AXES``] of atoms [L, D] by their embeddings: colours of places tell meanings apart."""
    return atoms @ torch.linalg.svd(atoms, full_matrices=False).Vh[:AXES].T


def code_drawing(field: CodedScene, level: str | int, plain: bool = False) -> Draw:
    """Return what draws the codes of one level as colours: the same code has the same colour in every view.

    The legend lists the atoms that lead the codes of most Gaussians, each with the mean colour of these.
    """
    row = field.level_index(level)
    # The axes of the colours come from the Gaussians, not from the picture, so that they are those of every view.
    placed = placed_atoms(field.codebook[row].cpu())  # [L, axes]
    indices, weights = field.code_indices[:, row].cpu(), field.code_weights[:, row].float().cpu()
    gaussians = SparseCodes(indices, weights, field.n_atoms).to_dense() @ placed  # [N, axes]
    basis = code_basis(gaussians)
    name = field.levels[row]
    title = f"codes, level {LEVEL_NAMES.get(name, name)}"
    legend = _code_legend(indices, weights, code_picture(gaussians[None], basis)[0])

    def draw(camera: Camera, projection: raster.Projection) -> Picture:
        picture = code_picture(field.render_codes(camera, projection)[row].cpu() @ placed, basis)
        if plain:
            return picture
        titled = captioned(picture, title, camera.name)
        return stacked([titled, legend(titled.shape[1])])

    return draw


def _code_legend(indices: Tensor, weights: Tensor, colors: Picture) -> Callable[[int], Picture]:
    """Return a function that draws the legend of a code picture of a width, from the codes [N, K] and colours [N, 3] of
    the Gaussians."""
    coded = weights.sum(1) > 0
    leading = indices.long().gather(1, weights.argmax(1, keepdim=True))[:, 0][coded].numpy()
    counts = np.bincount(leading)
    most = [int(atom) for atom in np.argsort(-counts, kind="stable")[:LEGEND_ATOMS] if counts[atom]]
    shades = [colors[coded.numpy()][leading == atom].mean(0).round().astype(int).tolist() for atom in most]
    swatches, names = [tuple(shade) for shade in shades], [str(atom) for atom in most]
    return lambda width: swatch_legend(width, CODE_LEGEND, "most frequent atoms", swatches, names)
