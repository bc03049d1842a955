"""Pictures: shapes, colours that keep their order, and text that stays inside."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from scoup.base.errors import InputError
from scoup.pictures import (
    captioned,
    code_basis,
    code_picture,
    contact_sheet,
    heat_colors,
    heat_map,
    label_colors,
    mask_overlay,
    region_overlay,
    regions_sheet,
)
from scoup.pictures.lettering import PAPER, fitted, text_width
from scoup.pictures.region_sheet import numbered

SIZES = [(1, 1), (1, 300), (300, 1), (36, 48), (180, 240)]


def photo(height: int, width: int) -> np.ndarray:
    return np.random.default_rng(0).random((height, width, 3)).astype(np.float32)


def check(picture: np.ndarray) -> None:
    assert picture.dtype == np.uint8
    assert picture.ndim == 3
    assert picture.shape[2] == 3


@pytest.mark.parametrize(("height", "width"), SIZES)
def test_every_picture_of_every_size(height: int, width: int):
    rng = np.random.default_rng(1)
    rgb, values = photo(height, width), rng.random((height, width))
    shown = heat_map(values, rgb, "a rather long question about a teapot", "m", 0.731)
    check(shown)
    assert shown.shape[1] == max(width, 120)
    assert shown.shape[0] > height
    check(heat_map(torch.from_numpy(values), torch.from_numpy(rgb)))
    plain = mask_overlay(values > 0.5, rgb)
    check(plain)
    assert plain.shape == (height, width, 3)
    check(mask_overlay(values > 0.5, rgb, (0, 0, width, height), (0, 0), "mug", "IoU 0.9"))
    check(region_overlay((values * 7).astype(np.int32) - 1, rgb))
    assert code_picture(rng.random((height, width, 5))).shape == (height, width, 3)
    check(contact_sheet([rgb, rgb], ["one", "two"], columns=2, width=400))


def test_heat_grows_lighter_all_the_way():
    lightness = heat_colors(np.linspace(0, 1, 257)) @ [0.299, 0.587, 0.114]
    assert (np.diff(lightness) > 0).all()
    assert heat_colors(np.array([np.nan, -1.0, 2.0]))[[0, 1]].tolist() == heat_colors(np.zeros(2)).tolist()


def test_regions_are_numbered_where_there_is_room():
    labels = np.full((3, 60, 80), -1)
    labels[0, :, 40:], labels[0, 5, :30] = 1, 0  # a wide region, and a line
    labels[1] = 7
    sheet = regions_sheet(photo(60, 80), labels, ("s", "m", "l"), "view.png", "made by hand", 500)
    check(sheet)
    assert sheet.shape[1] == 500
    plain = region_overlay(labels[0], photo(60, 80))
    drawn = (numbered(plain, labels[0]) != plain).any(-1)
    assert drawn[:, 40:].any()
    assert not drawn[:, :38].any()
    assert (numbered(plain, np.full((60, 80), -1)) == plain).all()


def test_low_relevancy_leaves_the_render_visible():
    rgb = np.full((40, 200, 3), 0.5, np.float32)
    values = np.tile(np.concatenate([np.zeros(120), np.linspace(0, 1, 80)]), (40, 1))
    shown = heat_map(values, rgb, "x")
    middle = shown[shown.shape[0] // 2].astype(int)
    assert np.ptp(middle[:100], axis=1).max() <= 2  # grey
    assert middle[-1, 0] > 200
    assert middle[-1, 0] - middle[-1, 2] > 50  # light yellow


@pytest.mark.parametrize("values", [np.zeros((20, 30)), np.full((20, 30), 0.5), np.full((20, 30), np.nan)])
def test_maps_without_contrast_show_the_render(values: np.ndarray):
    shown = heat_map(values, np.full((20, 30, 3), 0.5, np.float32))
    check(shown)
    assert shown.shape[1] == 120
    middle = shown[2:18, 50:70].astype(int)
    assert np.ptp(middle, axis=2).max() <= 2


def test_a_given_span_makes_pictures_comparable():
    rgb, values = photo(30, 200), np.full((30, 200), 0.6)
    low = heat_map(values, rgb, span=(0.6, 0.9))
    high = heat_map(values, rgb, span=(0.3, 0.6))
    assert high[5:25].mean() > low[5:25].mean() + 50


def test_mask_is_tinted_outlined_and_the_rest_darker():
    rgb = np.full((40, 60, 3), 0.5, np.float32)
    mask = np.zeros((40, 60), bool)
    mask[10:30, 20:50] = True
    shown = mask_overlay(mask, rgb).astype(int)
    assert shown[20, 35, 0] > shown[20, 35, 2] + 40
    assert shown[5, 5].max() < 128
    assert (shown[10, 35] != shown[20, 35]).any()


def test_sizes_that_disagree_are_refused():
    with pytest.raises(InputError, match="does not fit"):
        heat_map(np.zeros((3, 4)), photo(4, 3))
    with pytest.raises(InputError, match="does not fit"):
        mask_overlay(np.zeros((3, 4), bool), photo(4, 3))
    with pytest.raises(InputError, match="does not fit"):
        region_overlay(np.zeros((3, 4), int), photo(4, 3))
    with pytest.raises(InputError, match="H, W, 3"):
        captioned(np.zeros((3, 4), np.uint8), "x")
    with pytest.raises(InputError, match="H, W, L"):
        code_picture(np.zeros((3, 4)))


@pytest.mark.parametrize(
    "text", ["teapot", "a very long question that goes on and on " * 4, "", "überlange Größe", "W" * 200]
)
@pytest.mark.parametrize("width", [20, 60, 120, 480])
def test_text_fits(text: str, width: int):
    shortened, face = fitted(text, width, 18)
    assert text_width(shortened, face) <= width


@pytest.mark.parametrize("width", [120, 240, 960])
def test_captions_are_not_cut_off(width: int):
    shown = captioned(np.zeros((10, width, 3), np.uint8), "Quizzical jelly " * 12, "level m, 0.731")
    strip = shown[:-10]
    ground = np.array(PAPER)
    assert (strip != ground).any()
    for edge in (strip[0], strip[-1], strip[:, 0], strip[:, -1]):
        assert (edge == ground).all()


def test_both_texts_of_a_caption_are_shown():
    alone = captioned(np.zeros((10, 300, 3), np.uint8), "teapot")
    both = captioned(np.zeros((10, 300, 3), np.uint8), "teapot", "IoU 0.83")
    assert (alone[:, :150] == both[:, :150]).all()
    assert (alone[:, 150:] != both[:, 150:]).any()


def test_label_colours_differ_and_last():
    colors = label_colors(60)
    assert len(np.unique(colors, axis=0)) == 60
    assert (label_colors(10) == colors[:10]).all()
    assert label_colors(0).shape == (0, 3)


def test_codes_alike_get_colours_alike():
    codes = np.zeros((4, 9, 8), np.float32)
    for block in range(3):
        codes[:, 3 * block : 3 * block + 3, 2 * block] = 1.0
    codes[0, 0] = 0
    shown = code_picture(codes)
    assert (shown[0, 0] == 0).all()
    assert (shown[1, 0] == shown[3, 2]).all()
    assert np.abs(shown[1, 0].astype(int) - shown[1, 4]).max() > 60
    assert np.abs(shown[1, 4].astype(int) - shown[1, 8]).max() > 60
    part = code_picture(codes[:, :3], code_basis(codes))
    assert (part == shown[:, :3]).all()
    assert (code_picture(np.zeros((2, 2, 4))) == 0).all()


def test_sheets_keep_all_tiles_and_their_width():
    tiles = [np.full((30, 40, 3), 40 * (k + 1), np.uint8) for k in range(5)]
    sheet = contact_sheet(
        tiles, [f"tile {k}" for k in range(5)], 3, 600, "A heading", "A footer. " * 30, ["r"] * 5
    )
    assert sheet.shape[1] == 600
    for k in range(5):
        assert (sheet == 40 * (k + 1)).all(2).sum() > 10_000
    with pytest.raises(InputError, match="titles"):
        contact_sheet(tiles, ["one"])
    with pytest.raises(InputError, match="at least one tile"):
        contact_sheet([])
    with pytest.raises(InputError, match="columns"):
        contact_sheet(tiles * 40, columns=100, width=300)
