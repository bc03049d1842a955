"""Pictures of answers and of fields."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from messages import refuses
from query.conftest import Queried
from scoup import raster
from scoup.pictures import as_picture, heat_map, heat_overlay
from scoup.query.drawings import code_drawing, color_drawing, relevancy_drawing
from scoup.query.field_view import FieldView
from support import altered


def test_pictures_of_an_answer(queried: Queried) -> None:
    answer = queried.field.at(queried.camera).answer(queried.texts)[0]
    rgb = raster.render_colors(queried.field.gaussians, queried.camera)
    drawn = answer.pictures(rgb)
    assert list(drawn) == ["heat", "mask", "overlay"]
    assert drawn["mask"] is answer.mask
    absent = replace(answer, answer=replace(answer.answer, presence=False)).pictures(rgb)
    assert np.array_equal(np.asarray(absent["heat"]), np.asarray(drawn["heat"]))
    assert not np.array_equal(np.asarray(absent["overlay"]), np.asarray(drawn["overlay"]))  # the remark


def test_drawings_of_a_view(queried: Queried) -> None:
    field, camera = queried.field, queried.camera
    rgb = raster.render_colors(field.gaussians, camera, field.project(camera))
    assert np.array_equal(color_drawing(plain=True)(field.at(camera)), as_picture(rgb))
    answer = field.at(camera).answer(queried.texts)[0]
    expected = heat_map(answer.heat, rgb, "word 0", answer.level, float(answer.heat.max()), camera.name)
    assert np.array_equal(relevancy_drawing(field, queried.texts)(field.at(camera)), expected)
    plain = relevancy_drawing(field, queried.texts, plain=True)(field.at(camera))
    assert np.array_equal(plain, heat_overlay(answer.heat, rgb))


def test_the_same_code_has_the_same_colour_in_every_view(
    queried: Queried, monkeypatch: pytest.MonkeyPatch
) -> None:
    field, camera = queried.field, queried.camera
    monkeypatch.delattr(FieldView, "render_codes")  # takes gigabytes for a large view
    draw = code_drawing(field, "m", plain=True)
    whole = draw(field.at(camera))
    assert whole.shape == (camera.height, camera.width, 3)
    painted = field.render_codes(camera)[1].any(-1)
    assert (whole[~painted.numpy()] == 0).all()
    half = replace(camera, width=camera.width // 2)
    same = np.abs(draw(field.at(half)).astype(int) - whole[:, : half.width]) <= 1
    # A narrower view clips Gaussians at its edge, so some pixels differ.
    assert same.mean() > 0.95
    with refuses():
        code_drawing(field, "x")


def test_swatches_have_the_colours_of_the_picture(queried: Queried) -> None:
    field, camera = queried.field, replace(queried.camera, width=200)
    view = field.at(camera)
    plain = code_drawing(field, "m", plain=True)(view)
    titled = code_drawing(field, "m")(view)
    assert titled.shape[1] == 200
    top = next(y for y in range(len(titled)) if (titled[y : y + len(plain)] == plain).all())
    colors, counts = np.unique(titled[top + len(plain) :].reshape(-1, 3), axis=0, return_counts=True)
    vivid = colors[(np.ptp(colors.astype(int), axis=1) > 20) & (counts > 50)].astype(int)
    assert len(vivid) >= 2
    shown = plain[plain.any(2)].astype(int)
    assert min(np.abs(shown - color).max(1).min() for color in vivid) < 40


def test_a_field_knows_whether_it_is_visible(queried: Queried) -> None:
    field, camera = queried.field, queried.camera
    assert field.at(camera).is_visible()
    away = camera.viewmat.clone()
    away[2, 3] = -1000
    assert not field.at(replace(camera, viewmat=away)).is_visible()
    assert not altered(field, code_weights=0 * field.code_weights).at(camera).is_visible()
