"""Pictures of answers and of fields."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from query.conftest import Queried
from scoup import raster
from scoup.base.errors import InputError
from scoup.pictures import as_picture, heat_map
from scoup.query.answer import answer_view
from scoup.query.drawing import code_drawing, color_drawing, draw_answer, relevancy_drawing


def test_pictures_of_an_answer(queried: Queried) -> None:
    answer = answer_view(queried.field, queried.camera, queried.texts)[0]
    rgb = raster.render_colors(queried.field.gaussians, queried.camera)
    drawn = draw_answer(answer, rgb, "kettle")
    assert list(drawn) == ["heat", "mask", "overlay"]
    assert drawn["mask"] is answer.mask
    absent = draw_answer(replace(answer, presence=False), rgb, "kettle")
    assert np.array_equal(np.asarray(absent["heat"]), np.asarray(drawn["heat"]))
    assert not np.array_equal(np.asarray(absent["overlay"]), np.asarray(drawn["overlay"]))  # the remark


def test_drawings_of_a_view(queried: Queried) -> None:
    field, camera = queried.field, queried.camera
    projection = field.project(camera)
    rgb = raster.render_colors(field.gaussians, camera, projection)
    assert np.array_equal(color_drawing(field)(camera, projection), as_picture(rgb))
    answer = answer_view(field, camera, queried.texts, projection=projection)[0]
    expected = heat_map(answer.heat, rgb, "kettle", answer.level, answer.score)
    assert np.array_equal(relevancy_drawing(field, queried.texts, "kettle")(camera, projection), expected)


def test_the_same_code_has_the_same_colour_in_every_view(queried: Queried) -> None:
    field, camera = queried.field, queried.camera
    draw = code_drawing(field, "m")
    whole = draw(camera, field.project(camera))
    assert whole.shape == (camera.height, camera.width, 3)
    painted = field.render_codes(camera)[1].any(-1)
    assert (whole[~painted.numpy()] == 0).all()
    half = replace(camera, width=camera.width // 2)
    same = np.abs(draw(half, field.project(half)).astype(int) - whole[:, : half.width]) <= 1
    # A narrower view clips Gaussians at its edge, so some pixels differ.
    assert same.mean() > 0.95
    with pytest.raises(InputError, match="no level"):
        code_drawing(field, "x")


def test_a_field_knows_whether_it_is_visible(queried: Queried) -> None:
    field, camera = queried.field, queried.camera
    assert field.is_visible(field.project(camera))
    away = camera.viewmat.clone()
    away[2, 3] = -1000
    assert not field.is_visible(field.project(replace(camera, viewmat=away)))
    bare = type(field)(
        field.code_indices, torch.zeros_like(field.code_weights), field.codebook, field.info, field.gaussians
    )
    assert not bare.is_visible(bare.project(camera))
