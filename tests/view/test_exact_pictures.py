"""Exact pictures, and what is at a pixel."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from view_samples import WORDS, random_field, table, viewed_field

from scoup import raster
from scoup.base import InputError
from scoup.pictures import as_picture, heat_overlay, texts_overlay
from scoup.scene import Camera, Gaussians
from scoup.view.exact import LARGEST_SIDE, PictureMode, what_is_at
from scoup.view.viewed_field import ViewedField
from support import make_camera, unit

BLUE, ORANGE = (64.0, 184.0, 245.0), (245.0, 158.0, 18.0)


@pytest.fixture(scope="module")
def viewed() -> ViewedField:
    return viewed_field(count=200)


@pytest.fixture(scope="module")
def camera(viewed: ViewedField) -> Camera:
    assert viewed.field.cameras is not None
    return viewed.field.cameras[1]


def test_pictures_are_those_of_query(viewed: ViewedField, camera: Camera) -> None:
    rgb = raster.render_colors(viewed.gaussians, camera)
    assert np.array_equal(viewed.picture(camera), as_picture(rgb))
    answer = viewed.field.at(camera).answer(viewed.field.with_encoder(table()).question("thing 3"))
    heat, mask = (viewed.picture(camera, mode, ["thing 3"], [BLUE], 0.6) for mode in ("heat", "mask"))
    assert np.array_equal(heat, heat_overlay(answer.heat, rgb, opacity=0.6))
    assert np.array_equal(mask, texts_overlay([answer.heat], [answer.mask], rgb, [BLUE], 0.6))
    assert viewed.picture(camera, "codes").shape == (camera.height, camera.width, 3)


def test_several_texts_have_a_colour_each(viewed: ViewedField, camera: Camera) -> None:
    texts, colors = ["thing 3", "thing 5", "thing 1"], [BLUE, ORANGE, (90.0, 220.0, 115.0)]
    rgb = raster.render_colors(viewed.gaussians, camera)
    answers = viewed.field.at(camera).answer(viewed.field.with_encoder(table()).question(texts))
    heats, masks = [answer.heat for answer in answers], [answer.mask for answer in answers]
    for mode in ("heat", "mask"):
        shown = viewed.picture(camera, mode, texts, colors, 0.8)
        assert np.array_equal(shown, texts_overlay(heats, masks, rgb, colors, 0.8, mode == "heat"))
        fewer = viewed.picture(camera, mode, texts[:2], colors[:2], 0.8)
        assert not np.array_equal(shown, fewer)


@pytest.mark.parametrize("level", [0, 1])
def test_a_level_and_a_threshold_of_ones_own(viewed: ViewedField, camera: Camera, level: int) -> None:
    answer = viewed.field.at(camera).answer(
        viewed.field.with_encoder(table()).question("thing 3", level=level)
    )
    assert answer.level == viewed.field.levels[level]
    rgb = raster.render_colors(viewed.gaussians, camera)
    asked = {"texts": ["thing 3"], "colors": [BLUE], "level": level}
    assert np.array_equal(viewed.picture(camera, "heat", **asked), heat_overlay(answer.heat, rgb))
    whole, part = (
        viewed.picture(camera, "mask", **asked, threshold=threshold, always=True) for threshold in (0.0, 0.9)
    )
    assert not np.array_equal(whole, part)
    fine, coarse = (viewed.picture(camera, "codes", level=number) for number in (0, 1))
    assert not np.array_equal(fine, coarse)


def test_a_threshold_of_ones_own_leaves_the_level(viewed: ViewedField, camera: Camera) -> None:
    own, by_peak = (
        [answer.level for answer in viewed.field.answer(viewed.question(WORDS, True, threshold=threshold))]
        for threshold in (None, 0.3)
    )
    texts = [text for text, one, other in zip(WORDS, own, by_peak, strict=True) if one != other][:2]
    assert texts  # whose level would be another one
    for text in texts:
        level = viewed.field.level_index(own[WORDS.index(text)])
        of_level, shown = (
            viewed.picture(camera, "heat", [text], [BLUE], level=number, threshold=0.3, always=True)
            for number in (level, None)
        )
        assert np.array_equal(shown, of_level)


def test_the_next_camera_gets_its_own_picture(viewed: ViewedField, camera: Camera) -> None:
    first = viewed.picture(camera)
    viewed.picture(make_camera(20, 20))
    assert np.array_equal(viewed.picture(camera), first)


def test_requests_out_of_range_are_refused(viewed: ViewedField, camera: Camera) -> None:
    with pytest.raises(InputError, match="color, heat, mask, codes"):
        viewed.picture(camera, "depth")  # pyright: ignore[reportArgumentType]
    with pytest.raises(InputError, match="needs a text"):
        viewed.picture(camera, "mask")
    with pytest.raises(InputError, match="expected 2 colors, got 1"):
        viewed.picture(camera, "mask", ["thing 1", "thing 2"], [BLUE])
    with pytest.raises(InputError, match=f"{LARGEST_SIDE} pixels"):
        viewed.picture(make_camera(LARGEST_SIDE + 1, 1))
    with pytest.raises(InputError, match="5,595,136 pixels is too large for 8 texts"):
        viewed.picture(make_camera(LARGEST_SIDE, 1366), "heat", WORDS[:8], [BLUE] * 8)


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
            values = [word["relevancy"] for word in record["words"]]
            torch.testing.assert_close(torch.tensor(values), here[best], atol=2e-3, rtol=0)
            assert 0 < record["confidence"] <= 1


def _wall(depth: float, place: tuple[float, float] = (0.0, 0.0), opacity: float = 0.99) -> list[float]:
    return [place[0], place[1], depth, opacity]


def test_the_position_is_where_half_of_the_light_is_stopped() -> None:
    rows = torch.tensor([_wall(3.0, opacity=0.3), _wall(5.0), _wall(9.0), _wall(4.0, (2.0, 0.0))])
    field = random_field(4)
    count = len(rows)
    field._gaussians = Gaussians(
        rows[:, :3],
        torch.tensor([[1.0, 0, 0, 0]]).repeat(count, 1),
        torch.tensor([[0.4, 0.4, 0.01]]).repeat(count, 1),
        rows[:, 3],
        torch.zeros(count, 1, 3),
    )
    camera = make_camera(41, 31, 40.0)
    confidence = torch.ones(count, 2)
    found = what_is_at(field.at(camera), confidence, (20, 15), None)
    assert found["position"] == pytest.approx([0.0, 0.0, 5.0], abs=1e-6)
    assert found["distance"] == pytest.approx(5.0, abs=1e-6)
    assert all(not level["words"] for level in found["levels"])
    beside = what_is_at(field.at(camera), confidence, (40, 15), None)
    assert beside["position"][2] == pytest.approx(4.0, abs=1e-6)
    assert beside["position"][0] == pytest.approx(4.0 * 20 / 40.0, abs=1e-6)
    nothing = what_is_at(field.at(camera), confidence, (0, 0), None)
    assert nothing == {"position": None, "distance": None, "levels": []}
    with pytest.raises(InputError, match="not in a view of 41 x 31"):
        what_is_at(field.at(camera), confidence, (41, 0), None)


def test_a_click_reads_the_name_of_what_it_hits() -> None:
    field = random_field(2, k=1, n_atoms=9)
    names = table()
    field.codebook[:, 0], field.codebook[:, 1] = unit(names["thing 4"]), unit(names["thing 9"])
    field.code_indices[:] = torch.tensor([0, 1], dtype=torch.uint8)[:, None, None]
    field.code_weights[:] = 1.0
    viewed = ViewedField(field.with_encoder(names))
    gaussians = field.gaussians
    camera = Camera.look_at(
        gaussians.means[0].double() + torch.tensor([0, 0, -0.3]),
        gaussians.means[0].double(),
        "c",
        9,
        9,
        40.0,
        (0, 1, 0),
    )
    gaussians.opacities[:] = torch.tensor([0.99, 0.0])
    found = viewed.what_is_at(camera, (4, 4))
    assert [level["words"][0]["text"] for level in found["levels"]] == ["thing 4"] * 2


def test_a_thumbnail_keeps_the_shape_of_its_view(viewed: ViewedField, camera: Camera) -> None:
    assert viewed.thumbnail(camera).shape == (120, 160, 3)


@pytest.mark.parametrize("mode", ["heat", "mask"])
def test_a_picture_does_not_depend_on_what_was_asked_before(mode: PictureMode) -> None:
    viewed = viewed_field(count=400)
    camera = make_camera(60, 80)
    alone = [
        viewed_field(count=400).picture(camera, mode, [f"thing {number}"], [BLUE]) for number in range(6)
    ]
    for _ in range(2):
        for number, wanted in enumerate(alone):
            assert np.array_equal(viewed.picture(camera, mode, [f"thing {number}"], [BLUE]), wanted)
