"""Pictures of answers and of fields, one view at a time."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
import torch
from torch import Tensor

from scoup import raster
from scoup.pictures import as_picture, code_basis, code_picture, heat_map, mask_overlay
from scoup.pictures.colors import Picture
from scoup.query.answer import Answer, answer_view
from scoup.query.queried_field import QueriedField
from scoup.query.text_vectors import TextVectors
from scoup.scene.cameras import Camera
from scoup.scene.codes import SparseCodes

AXES = 8  # directions of embedding space among which the three colours are chosen

Draw: TypeAlias = Callable[[Camera, raster.Projection], Picture]
"""Draws one view, given its camera and the field's projection to it."""


def draw_answer(answer: Answer, rgb: Tensor, text: str) -> dict[str, np.ndarray | Tensor]:
    """The pictures of an answer, by their kind.

    Args:
        answer: to a text in one view.
        rgb: [H, W, 3] float 0..1, the colour render of the view.
        text: written above.

    Returns:
        "heat": the relevancy over the render, [.., .., 3] uint8; "mask": [H, W] boolean; "overlay": mask, box and
        point over the render, [.., W, 3] uint8.
    """
    remark = "not in this view"
    if answer.presence:
        remark = f"level {answer.level}, {answer.coverage:.1%} of the view"
    return {
        "heat": heat_map(answer.heat, rgb, text, answer.level, answer.score),
        "mask": answer.mask,
        "overlay": mask_overlay(answer.mask, rgb, answer.box, answer.point, text, remark),
    }


def color_drawing(field: QueriedField) -> Draw:
    """Draws the splat of a field."""
    return lambda camera, projection: as_picture(raster.render_colors(field.gaussians, camera, projection))


def relevancy_drawing(field: QueriedField, texts: TextVectors, text: str) -> Draw:
    """Draws a heat map of the relevancy to the first query of ``texts``, at the level of its mask.

    Args:
        field: to be queried.
        texts: as for ``answer_view``.
        text: of the query, written above.
    """

    def draw(camera: Camera, projection: raster.Projection) -> Picture:
        answer = answer_view(field, camera, texts, projection=projection)[0]
        rgb = raster.render_colors(field.gaussians, camera, projection).cpu()
        return heat_map(answer.heat, rgb, text, answer.level, answer.score)

    return draw


def code_drawing(field: QueriedField, level: str | int) -> Draw:
    """Draws the codes of one level as colours: the same code has the same colour in every view.

    Raises:
        InputError: there is no such level.
    """
    row = field.level_index(level)
    # Colours should tell meanings apart, so atoms are placed by their embeddings; and the axes come from the
    # Gaussians, not from the picture, so that they are those of every view.
    atoms = field.codebook[row].cpu()
    directions = torch.linalg.svd(atoms, full_matrices=False).Vh[:AXES].T  # [D, axes]
    placed = atoms @ directions  # [L, axes]
    indices, weights = field.code_indices[:, row].cpu(), field.code_weights[:, row].float().cpu()
    basis = code_basis(SparseCodes(indices, weights, field.n_atoms).to_dense() @ placed)
    return lambda camera, projection: code_picture(
        field.render_codes(camera, projection)[row].cpu() @ placed, basis
    )
