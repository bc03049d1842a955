"""Pictures: shapes, colours that keep their order, text that stays inside, and animations."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image, ImageDraw

from messages import refuses
from scoup.pictures import (
    answer_overlay,
    captioned,
    code_basis,
    code_picture,
    contact_sheet,
    heat_legend,
    heat_map,
    heat_overlay,
    label_colors,
    mask_overlay,
    region_overlay,
    regions_sheet,
    swatch_legend,
)
from scoup.pictures.animation import save_animation
from scoup.pictures.colors import heat_colors
from scoup.pictures.legends import scale_ends
from scoup.pictures.lettering import INK, PAPER, lines_of, text_width
from scoup.pictures.overlays import eroded
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
    check(heat_overlay(torch.from_numpy(values), torch.from_numpy(rgb)))
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
    shown, written = numbered(plain, labels[0])
    drawn = (shown != plain).any(-1)
    assert written == 1
    assert drawn[:, 40:].any()
    assert not drawn[:, :38].any()
    shown, written = numbered(plain, np.full((60, 80), -1))
    assert written == 0
    assert (shown == plain).all()


def test_numbers_stay_inside_their_regions():
    rows, columns = np.mgrid[:600, :900]
    labels = rows // 20 * 30 + columns // 30  # 900 regions of 20 x 30
    labels[:, :450] = 900 + (rows // 5 * 45 + columns // 10)[:, :450]  # and many that are too small
    plain = np.full((600, 900, 3), 90, np.uint8)
    shown, written = numbered(plain, labels)
    assert written == len(np.unique(labels[:, 450:]))
    drawn = (shown != plain).any(-1)
    assert not drawn[:, :450].any()
    border = (np.diff(labels, axis=1, prepend=-1) != 0) | (np.diff(labels, axis=0, prepend=-1) != 0)
    assert not (drawn & border).any()


def test_low_relevancy_leaves_the_render_visible():
    rgb = np.full((40, 200, 3), 0.5, np.float32)
    values = np.tile(np.concatenate([np.zeros(120), np.linspace(0, 1, 80)]), (40, 1))
    shown = heat_overlay(values, rgb)
    middle = shown[shown.shape[0] // 2].astype(int)
    assert np.ptp(middle[:100], axis=1).max() <= 2  # grey
    assert middle[-1, 0] > 200
    assert middle[-1, 0] - middle[-1, 2] > 50  # light yellow


@pytest.mark.parametrize("values", [np.zeros((20, 30)), np.full((20, 30), 0.5), np.full((20, 30), np.nan)])
def test_maps_without_contrast_show_the_render(values: np.ndarray):
    shown = heat_map(values, np.full((20, 30, 3), 0.5, np.float32), "x", "m", 0.5)
    check(shown)
    assert shown.shape[1] == 120
    shown = heat_overlay(values, np.full((20, 30, 3), 0.5, np.float32))
    assert np.ptp(shown.astype(int), axis=2).max() <= 2


def test_a_given_span_makes_pictures_comparable():
    rgb, values = photo(30, 200), np.full((30, 200), 0.6)
    low = heat_overlay(values, rgb, (0.6, 0.9))
    high = heat_overlay(values, rgb, (0.3, 0.6))
    assert high.mean() > low.mean() + 50


@pytest.mark.parametrize("width", [120, 288, 960, 1640])
@pytest.mark.parametrize(("low", "high"), [(0.48, 0.59), (0.1, 0.95), (0.5, 0.5)])
def test_ticks_and_colours_of_the_legend_stand_at_their_relevancy(width: int, low: float, high: float):
    legend = heat_legend(np.zeros((1, width, 3), np.uint8), low, high)[1:].astype(int)
    first, last = scale_ends(width)
    bar = next(y for y in range(len(legend)) if (legend[y, first:last] != PAPER).any(1).all()) + 1
    bottom = max(y for y in range(len(legend)) if (legend[y, first:last] != PAPER).any(1).all())
    ticks = np.flatnonzero((legend[bottom + 1] == INK).all(1))
    assert ticks.tolist() == [first, first + round(0.5 * (last - first)), last]
    # A pixel of a map of this relevancy has the colour that the bar has there.
    for relevancy in np.linspace(low, high, 7)[1:-1] if high > low else ():
        column = first + round(relevancy * (last - first))
        exact = (column - first) / (last - first)
        shown = heat_overlay(np.full((1, 1), exact), np.full((1, 1, 3), 0.5), (low, high))[0, 0]
        assert np.abs(legend[bar, column] - shown).max() <= 4
    beyond = first + round((high + 1) / 2 * (last - first))
    assert (legend[bar, beyond] == PAPER).all() or width >= 288  # or a text stands there


def test_the_legend_says_what_a_draw_is(monkeypatch: pytest.MonkeyPatch):
    texts = []
    monkeypatch.setattr(ImageDraw.ImageDraw, "text", lambda self, at, text, *a, **k: texts.append(text))
    for width in (960, 120):
        heat_legend(np.zeros((1, width, 3), np.uint8), 0.48, 0.59)
    wide = ["0", "1", "0.5: draw with the canonical phrases", "clear below 0.48", "largest 0.59"]
    assert texts == [*wide, "0", "1", "0.5: draw"]


def test_swatches_are_as_many_as_fit():
    colors = [(200, 30, 30), (30, 200, 30), (30, 30, 200)]
    wide = swatch_legend(
        np.zeros((1, 600, 3), np.uint8), "what colours mean", "some of them", colors, ["7", "12", "130"]
    )
    assert all((wide == color).all(2).sum() > 20 for color in colors)
    narrow = swatch_legend(
        np.zeros((1, 120, 3), np.uint8), "what colours mean", "some of them", colors * 9, ["100"] * 27
    )
    assert narrow.shape[1] == 120
    assert (narrow[1:, -3:] == PAPER).all()


def test_an_answer_over_the_heat():
    rgb = np.full((60, 80, 3), 0.5, np.float32)
    mask = np.zeros((60, 80), bool)
    mask[20:40, 30:50] = True
    heat = heat_overlay(mask * 0.7, rgb, (0.5, 0.7))
    shown = answer_overlay(mask * 0.7, mask, rgb, (0.5, 0.7), (30, 20, 50, 40), (40, 30))
    assert (shown[25, 35] == heat[25, 35]).all()
    assert (shown[30, 40] == 255).all()  # the cross
    assert (answer_overlay(mask * 0.7, mask, rgb, (0.5, 0.7))[20, 35] == 255).all()  # the outline
    assert (shown[5, 5] == heat[5, 5]).all()


def test_mask_is_tinted_outlined_and_the_rest_darker():
    rgb = np.full((40, 60, 3), 0.5, np.float32)
    mask = np.zeros((40, 60), bool)
    mask[10:30, 20:50] = True
    shown = mask_overlay(mask, rgb).astype(int)
    assert shown[20, 35, 0] > shown[20, 35, 2] + 40
    assert shown[5, 5].max() < 128
    assert (shown[10, 35] != shown[20, 35]).any()


def test_sizes_that_disagree_are_refused():
    for draw, values in ((heat_overlay, float), (mask_overlay, bool), (region_overlay, int)):
        with refuses():
            draw(np.zeros((3, 4), values), photo(4, 3))
    with refuses():
        answer_overlay(np.zeros((3, 4)), np.zeros((4, 3), bool), photo(3, 4), (0.5, 0.7))
    with refuses():
        captioned(np.zeros((3, 4), np.uint8), "x")
    with refuses():
        code_picture(np.zeros((3, 4)))


@pytest.mark.parametrize(
    "text", ["teapot", "a very long question that goes on and on " * 4, "", "überlange Größe", "W" * 200]
)
@pytest.mark.parametrize("width", [20, 60, 120, 480])
@pytest.mark.parametrize("most", [1, 3])
def test_text_fits(text: str, width: int, most: int):
    lines, face = lines_of(text, width, 18, most)
    assert len(lines) <= most
    assert all(text_width(line, face) <= width for line in lines)


def test_text_is_broken_between_words():
    lines, _ = lines_of("the person who stands behind the wooden table", 120, 12)
    assert " ".join(lines) == "the person who stands behind the wooden table"
    assert len(lines) > 1
    assert lines_of("a b  c\nd", 500, 12)[0] == ["a b c d"]
    assert lines_of("", 500, 12)[0] == []
    assert lines_of("word " * 99, 120, 12)[0][-1].endswith("...")
    assert lines_of("Töpfe, café", 500, 18)[0] == ["Topfe, cafe"]


@pytest.mark.parametrize("text", ["茶壶", "чайник", "\U0001f600", "\ud800", "\u202e", "한국"])
def test_letters_without_a_glyph_are_boxes(text: str):
    lines, face = lines_of(text, 500, 18)
    assert text_width(lines[0], face) > 0
    ground = np.zeros((10, 240, 3), np.uint8)
    assert (captioned(ground, text)[:-10] != captioned(ground, "")[:-10]).any()


@pytest.mark.parametrize("width", [120, 240, 960])
def test_captions_are_not_cut_off(width: int):
    shown = captioned(np.zeros((10, width, 3), np.uint8), "Quizzical jelly " * 12, "level m, 0.731")
    strip = shown[:-10]
    ground = np.array(PAPER)
    assert (strip != ground).any()
    for edge in (strip[0], strip[-1], strip[:, 0], strip[:, -1]):
        assert (edge == ground).all()


def test_both_texts_of_a_caption_are_shown():
    ground = np.zeros((10, 300, 3), np.uint8)
    alone, both = captioned(ground, "teapot"), captioned(ground, "teapot", "IoU 0.83")
    assert (alone[:, :150] == both[:, :150]).all()
    assert (alone[:, 150:] != both[:, 150:]).any()
    ground = ground[:, :200]  # what does not fit beside stands below
    short, long = captioned(ground, "mug", "score 0.7"), captioned(ground, "a mug " * 9, "level m, score 0.7")
    assert long.shape[0] > short.shape[0]
    assert (long[-10:] == 0).all()


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
    titles = [f"tile {k}" for k in range(5)]
    sheet = contact_sheet(tiles, titles, 3, 600, "A heading", "A footer. " * 30, ["r"] * 5)
    assert sheet.shape[1] == 600
    assert all((sheet == 40 * (k + 1)).all(2).sum() > 10_000 for k in range(5))
    # Those of a row stand in line.
    row = contact_sheet([tiles[4]] * 2, ["mug", "a rather long question about a teapot " * 3], 2, 400)
    rows = [(row[:, x] == 200).all(1) for x in (60, 260)]
    assert (rows[0] == rows[1]).all()
    assert rows[0].any()


@pytest.mark.parametrize("share", [0.0, 0.9, 0.99, 1.0])
def test_outlines_are_those_of_binary_erosion(share: float) -> None:
    from scipy import ndimage

    inside = np.random.default_rng(2).random((30, 41)) < share
    for width in (1, 2, 4):
        expected = ndimage.binary_erosion(inside, iterations=width, border_value=1)
        np.testing.assert_array_equal(eroded(inside, width), expected)


def test_shorter_pictures_get_a_margin_above(tmp_path: Path) -> None:
    frames = [np.full((height, 9, 3), 200, np.uint8) for height in (8, 6)]
    save_animation(frames, tmp_path / "a.webp", 12)
    with Image.open(tmp_path / "a.webp") as picture:
        assert picture.size == (9, 8)
        picture.seek(1)
        shown = np.asarray(picture.convert("RGB"))
    assert (shown[0] < 60).all()
    assert (shown[-1] > 150).all()
