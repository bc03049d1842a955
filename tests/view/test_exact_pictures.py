"""Exact pictures, and what is at a pixel."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from view_samples import WORDS, random_field, table, viewed_field

from messages import refuses
from scoup import raster
from scoup.pictures import as_picture, heat_overlay, texts_overlay
from scoup.scene import Camera, Gaussians
from scoup.view.exact import LARGEST_SIDE, PictureMode, what_is_at
from scoup.view.viewed_field import ViewedField
from support import make_camera

BLUE = (64.0, 184.0, 245.0)
OF_TEXTS: tuple[PictureMode, ...] = ("heat", "mask")


@pytest.fixture(scope="module")
def viewed() -> ViewedField:
    return viewed_field(count=200)


@pytest.fixture(scope="module")
def camera(viewed: ViewedField) -> Camera:
    return viewed.field.camera(1)


def test_pictures_are_those_of_query(viewed: ViewedField, camera: Camera) -> None:
    rgb = raster.render_colors(viewed.gaussians, camera)
    assert np.array_equal(viewed.picture(camera), as_picture(rgb))
    field, at_camera = viewed.field.with_encoder(table()), viewed.field.at(camera)
    for level in (None, 0, 1):
        answer = at_camera.answer(field.question("thing 3", level=level))
        assert level is None or answer.level == field.levels[level]
        heat, mask = (viewed.picture(camera, mode, ["thing 3"], [BLUE], 0.6, level) for mode in OF_TEXTS)
        assert np.array_equal(heat, heat_overlay(answer.heat, rgb, opacity=0.6))
        assert np.array_equal(mask, texts_overlay([answer.heat], [answer.mask], rgb, [BLUE], 0.6))
    texts, colors = ["thing 3", "thing 5", "thing 1"], [BLUE, (245.0, 158.0, 18.0), (90.0, 220.0, 115.0)]
    answers = at_camera.answer(field.question(texts))
    heats, masks = [answer.heat for answer in answers], [answer.mask for answer in answers]
    for mode in OF_TEXTS:
        shown = viewed.picture(camera, mode, texts, colors, 0.8)
        assert np.array_equal(shown, texts_overlay(heats, masks, rgb, colors, 0.8, mode == "heat"))
        assert not np.array_equal(shown, viewed.picture(camera, mode, texts[:2], colors[:2], 0.8))
    masks = [viewed.picture(camera, "mask", ["thing 3"], [BLUE], 1, 0, each, True) for each in (0.0, 0.9)]
    for one, other in (masks, [viewed.picture(camera, "codes", level=level) for level in (0, 1)]):
        assert one.shape == (camera.height, camera.width, 3)
        assert not np.array_equal(one, other)
    # A threshold of one's own leaves the level.
    own, by_peak = (
        [answer.level for answer in viewed.field.answer(viewed.question(WORDS, True, threshold=threshold))]
        for threshold in (None, 0.3)
    )
    row = next(row for row, level in enumerate(own) if level != by_peak[row])
    of_level, shown = (
        viewed.picture(camera, "heat", [WORDS[row]], [BLUE], 1, level, 0.3, True)
        for level in (viewed.field.level_index(own[row]), None)
    )
    assert np.array_equal(shown, of_level)


def test_requests_out_of_range_are_refused(viewed: ViewedField, camera: Camera) -> None:
    requests: list[tuple[Any, ...]] = [
        (camera, "depth"), (camera, "mask"), (camera, "mask", ["thing 1", "thing 2"], [BLUE]),
        (make_camera(LARGEST_SIDE + 1, 1),), (make_camera(LARGEST_SIDE, 1366), "heat", WORDS[:8], [BLUE] * 8),
    ]  # fmt: skip
    for request in requests:
        with refuses():
            viewed.picture(*request)


def test_what_is_at_a_pixel_is_what_a_render_of_codes_says(viewed: ViewedField, camera: Camera) -> None:
    words = viewed.vocabulary()
    assert words is not None
    relevancy = viewed.field.relevancy(camera, words.queries, words.canonical)  # [S, V, H, W]
    for pixel in ((20, 15), (0, 0), (39, 29), (11, 22)):
        found = viewed.what_is_at(camera, pixel)
        for level, record in enumerate(found["levels"]):
            here = relevancy[level, :, pixel[1], pixel[0]]
            if not record["words"]:
                assert torch.allclose(here, torch.tensor(0.5), atol=1e-4)
                continue
            best = here.argsort(descending=True)[:5]
            values = torch.tensor([word["relevancy"] for word in record["words"]])
            named = [words.texts.index(word["text"]) for word in record["words"]]
            assert len(set(named)) == 5
            for wanted in (best, named):
                torch.testing.assert_close(values, here[wanted], atol=2e-3, rtol=0)
            assert 0 < record["confidence"] <= 1


def test_the_position_is_where_half_of_the_light_is_stopped() -> None:
    means = torch.tensor([[0.0, 0, 3], [0, 0, 5], [0, 0, 9], [2, 0, 4]])
    field, scales = random_field(4), torch.tensor([[0.4, 0.4, 0.01]]).repeat(4, 1)
    quats, opacities = torch.eye(4)[[0] * 4], torch.tensor([0.3, 0.99, 0.99, 0.99])
    field._gaussians = Gaussians(means, quats, scales, opacities, torch.zeros(4, 1, 3))
    camera = make_camera(41, 31, 40.0)

    def at(*pixel: int) -> dict[str, Any]:
        return what_is_at(field.at(camera), torch.ones(4, 2), (pixel[0], pixel[1]), None)

    found = at(20, 15)
    assert found["position"] == pytest.approx([0.0, 0.0, 5.0], abs=1e-6)
    assert found["distance"] == pytest.approx(5.0, abs=1e-6)
    assert all(not level["words"] for level in found["levels"])
    assert at(40, 15)["position"][::2] == pytest.approx([4.0 * 20 / 40.0, 4.0], abs=1e-6)
    assert at(0, 0) == {"position": None, "distance": None, "levels": []}
    with refuses():
        at(41, 0)


def test_a_picture_does_not_depend_on_what_was_asked_before(viewed: ViewedField, camera: Camera) -> None:
    other = make_camera(60, 80)
    asked: list[tuple[Any, ...]] = [(camera,)]
    asked += [(other, mode, [text], [BLUE]) for mode in OF_TEXTS for text in WORDS[:6]]
    alone = [viewed_field(count=200).picture(*request) for request in asked]
    for _ in range(2):
        for request, wanted in zip(asked, alone, strict=True):
            assert np.array_equal(viewed.picture(*request), wanted)
