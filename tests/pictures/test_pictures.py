"""Pictures: shapes, colours that keep their order, text that stays inside; animations and videos."""

from __future__ import annotations

import sys
from itertools import product
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
import torch
from PIL import Image, ImageDraw

from messages import refuses
from scoup import pictures
from scoup.base import ScoupError
from scoup.pictures.colors import heat_colors
from scoup.pictures.legends import scale_ends
from scoup.pictures.lettering import INK, PAPER, lines_of, text_width
from scoup.pictures.overlays import eroded
from scoup.pictures.region_sheet import numbered
from scoup.pictures.video import check_video_writer, save_animation, save_video

SIZES = [(1, 1), (1, 300), (300, 1), (36, 48), (180, 240)]


def photo(height: int, width: int) -> np.ndarray:
    return np.random.default_rng(0).random((height, width, 3)).astype(np.float32)


def check(picture: np.ndarray) -> None:
    assert (picture.dtype, picture.shape[2:]) == (np.uint8, (3,))


GREY = np.full((60, 80, 3), 0.5, np.float32)


@pytest.mark.parametrize(("height", "width"), SIZES)
def test_every_picture_of_every_size(height: int, width: int):
    rng = np.random.default_rng(1)
    rgb, values = photo(height, width), rng.random((height, width))
    shown = pictures.heat_map(values, rgb, "a rather long question about a teapot", "m", 0.731)
    check(shown)
    assert shown.shape[1] == max(width, 120)
    assert shown.shape[0] > height
    check(pictures.heat_overlay(torch.from_numpy(values), torch.from_numpy(rgb)))
    plain = pictures.mask_overlay(values > 0.5, rgb)
    check(plain)
    assert plain.shape == (height, width, 3)
    check(pictures.mask_overlay(values > 0.5, rgb, (0, 0, width, height), (0, 0), "mug", "IoU 0.9"))
    check(pictures.region_overlay((values * 7).astype(np.int32) - 1, rgb))
    assert pictures.code_picture(rng.random((height, width, 5))).shape == (height, width, 3)
    check(pictures.contact_sheet([rgb, rgb], ["one", "two"], columns=2, width=120))


def test_heat_grows_lighter_all_the_way():
    lightness = heat_colors(np.linspace(0, 1, 257)) @ [0.299, 0.587, 0.114]
    assert (np.diff(lightness) > 0).all()
    assert heat_colors(np.array([np.nan, -1.0, 2.0]))[[0, 1]].tolist() == heat_colors(np.zeros(2)).tolist()


def test_regions_are_numbered_where_there_is_room():
    labels = np.full((3, 60, 80), -1)
    labels[0, :, 40:], labels[0, 5, :30] = 1, 0  # a wide region, and a line
    labels[1] = 7
    sheet = pictures.regions_sheet(photo(60, 80), labels, ("s", "m", "l"), "view.png", "made by hand", 500)
    check(sheet)
    assert sheet.shape[1] == 500
    plain = pictures.region_overlay(labels[0], photo(60, 80))
    for level, expected in ((0, 1), (2, 0)):
        shown, written = numbered(plain, labels[level])
        drawn = (shown != plain).any(-1)
        assert (written, drawn[:, 40:].any(), drawn[:, :38].any()) == (expected, expected, False)


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
    values = np.tile(np.concatenate([np.zeros(120), np.linspace(0, 1, 80)]), (40, 1))
    shown = pictures.heat_overlay(values, np.full((40, 200, 3), 0.5, np.float32))
    middle = shown[shown.shape[0] // 2].astype(int)
    assert np.ptp(middle[:100], axis=1).max() <= 2  # grey
    assert middle[-1, 0] > 200
    assert middle[-1, 0] - middle[-1, 2] > 50  # light yellow


@pytest.mark.parametrize("value", [0, 0.5, np.nan])
def test_maps_without_contrast_show_the_render_unless_a_span_is_given(value: float):
    values = np.full((60, 80), value)
    check(pictures.heat_map(values, GREY, "x", "m", 0.5))
    assert np.ptp(pictures.heat_overlay(values, GREY).astype(int), axis=2).max() <= 2
    if value == 0.5:
        low, high = (pictures.heat_overlay(values, GREY, span).mean() for span in ((0.5, 0.8), (0.2, 0.5)))
        assert high > low + 50


@pytest.mark.parametrize("width", [120, 288, 960, 1640])
@pytest.mark.parametrize(("low", "high"), [(0.48, 0.59), (0.1, 0.95), (0.5, 0.5)])
def test_ticks_and_colours_of_the_legend_stand_at_their_relevancy(width: int, low: float, high: float):
    legend = pictures.heat_legend(np.zeros((1, width, 3), np.uint8), low, high)[1:].astype(int)
    first, last = scale_ends(width)
    bar = next(y for y in range(len(legend)) if (legend[y, first:last] != PAPER).any(1).all()) + 1
    bottom = max(y for y in range(len(legend)) if (legend[y, first:last] != PAPER).any(1).all())
    ticks = np.flatnonzero((legend[bottom + 1] == INK).all(1))
    assert ticks.tolist() == [first, first + round(0.5 * (last - first)), last]
    # A pixel of a map of this relevancy has the colour that the bar has there.
    for relevancy in np.linspace(low, high, 7)[1:-1] if high > low else ():
        column = first + round(relevancy * (last - first))
        exact = (column - first) / (last - first)
        shown = pictures.heat_overlay(np.full((1, 1), exact), np.full((1, 1, 3), 0.5), (low, high))[0, 0]
        assert np.abs(legend[bar, column] - shown).max() <= 4
    beyond = first + round((high + 1) / 2 * (last - first))
    assert (legend[bar, beyond] == PAPER).all() or width >= 288  # or a text stands there


def test_the_legend_says_what_a_draw_is(monkeypatch: pytest.MonkeyPatch):
    texts = []
    monkeypatch.setattr(ImageDraw.ImageDraw, "text", lambda self, at, text, *a, **k: texts.append(text))
    for width in (960, 120):
        pictures.heat_legend(np.zeros((1, width, 3), np.uint8), 0.48, 0.59)
    wide = ["0", "1", "0.5: draw with the canonical phrases", "clear below 0.48", "largest 0.59"]
    assert texts == [*wide, "0", "1", "0.5: draw"]


def test_swatches_are_as_many_as_fit():
    colors, texts = [(200, 30, 30), (30, 200, 30), (30, 30, 200)], ("what colours mean", "some of them")
    wide = pictures.swatch_legend(np.zeros((1, 600, 3), np.uint8), *texts, colors, ["7", "12", "130"])
    assert all((wide == color).all(2).sum() > 20 for color in colors)
    narrow = pictures.swatch_legend(np.zeros((1, 120, 3), np.uint8), *texts, colors * 9, ["100"] * 27)
    assert narrow.shape[1] == 120
    assert (narrow[1:, -3:] == PAPER).all()


def test_answers_and_masks_are_outlined():
    """An answer lies over the heat; a mask is tinted, and the rest darker."""
    mask = np.zeros((60, 80), bool)
    mask[20:40, 30:50] = True
    heat = pictures.heat_overlay(mask * 0.7, GREY, (0.5, 0.7))
    shown = pictures.answer_overlay(mask * 0.7, mask, GREY, (0.5, 0.7), (30, 20, 50, 40), (40, 30))
    assert (shown[[25, 5], [35, 5]] == heat[[25, 5], [35, 5]]).all()
    assert (shown[30, 40] == 255).all()  # the cross
    assert (pictures.answer_overlay(mask * 0.7, mask, GREY, (0.5, 0.7))[20, 35] == 255).all()  # the outline
    shown = pictures.mask_overlay(mask, GREY).astype(int)
    assert shown[30, 40, 0] > shown[30, 40, 2] + 40
    assert shown[5, 5].max() < 128
    assert (shown[20, 40] != shown[30, 40]).any()


def test_sizes_that_disagree_are_refused():
    for draw, kind in (
        (pictures.heat_overlay, float),
        (pictures.mask_overlay, bool),
        (pictures.region_overlay, int),
    ):
        with refuses():
            draw(np.zeros((3, 4), kind), photo(4, 3))
    with refuses():
        pictures.answer_overlay(np.zeros((3, 4)), np.zeros((4, 3), bool), photo(3, 4), (0.5, 0.7))
    with refuses():
        pictures.captioned(np.zeros((3, 4), np.uint8), "x")
    with refuses():
        pictures.code_picture(np.zeros((3, 4)))


@pytest.mark.parametrize("text", ["teapot", "a very long question " * 8, "", "überlange Größe", "W" * 200])
def test_text_fits(text: str):
    for width, most in product((20, 60, 120, 480), (1, 3)):
        lines, face = lines_of(text, width, 18, most)
        assert len(lines) <= most
        assert all(text_width(line, face) <= width for line in lines)


def test_text_is_broken_between_words():
    text = "the person who stands behind the wooden table"
    lines, _ = lines_of(text, 120, 12)
    assert " ".join(lines) == text
    assert len(lines) > 1
    assert lines_of("word " * 99, 120, 12)[0][-1].endswith("...")
    for text, shown in (("a b  c\nd", ["a b c d"]), ("", []), ("Töpfe, café", ["Topfe, cafe"])):
        assert lines_of(text, 500, 18)[0] == shown
    ground = np.zeros((10, 240, 3), np.uint8)
    # Letters without a glyph are boxes.
    for text in ("茶壶", "чайник", "\U0001f600", "\ud800", "\u202e", "한국"):
        lines, face = lines_of(text, 500, 18)
        assert text_width(lines[0], face) > 0
        assert (pictures.captioned(ground, text)[:-10] != pictures.captioned(ground, "")[:-10]).any()


@pytest.mark.parametrize("width", [120, 240, 960])
def test_captions_are_not_cut_off(width: int):
    shown = pictures.captioned(np.zeros((10, width, 3), np.uint8), "Quizzical jelly " * 12, "level m, 0.731")
    written = (shown[:-10] != np.array(PAPER)).any(2)
    assert written.any()
    assert not written[[0, -1]].any()
    assert not written[:, [0, -1]].any()


def test_both_texts_of_a_caption_are_shown():
    ground = np.zeros((10, 300, 3), np.uint8)
    alone, both = pictures.captioned(ground, "teapot"), pictures.captioned(ground, "teapot", "IoU 0.83")
    assert (alone[:, :150] == both[:, :150]).all()
    assert (alone[:, 150:] != both[:, 150:]).any()
    ground = ground[:, :200]  # what does not fit beside stands below
    short, long = (
        pictures.captioned(ground, "mug", "score 0.7"),
        pictures.captioned(ground, "a mug " * 9, "level m, score 0.7"),
    )
    assert long.shape[0] > short.shape[0]
    assert (long[-10:] == 0).all()


def test_label_colours_differ_and_last():
    colors = pictures.label_colors(60)
    assert len(np.unique(colors, axis=0)) == 60
    assert (pictures.label_colors(10) == colors[:10]).all()
    assert pictures.label_colors(0).shape == (0, 3)


def test_codes_alike_get_colours_alike():
    codes = np.zeros((4, 9, 8), np.float32)
    for block in range(3):
        codes[:, 3 * block : 3 * block + 3, 2 * block] = 1.0
    codes[0, 0] = 0
    shown = pictures.code_picture(codes)
    assert (shown[0, 0] == 0).all()
    assert (shown[1, 0] == shown[3, 2]).all()
    first, second, third = shown[1, [0, 4, 8]].astype(int)
    assert min(np.abs(first - second).max(), np.abs(second - third).max()) > 60
    part = pictures.code_picture(codes[:, :3], pictures.code_basis(codes))
    assert (part == shown[:, :3]).all()
    assert (pictures.code_picture(np.zeros((2, 2, 4))) == 0).all()


def test_sheets_keep_all_tiles_and_their_width():
    tiles = [np.full((30, 40, 3), 40 * (k + 1), np.uint8) for k in range(5)]
    titles = [f"tile {k}" for k in range(5)]
    sheet = pictures.contact_sheet(tiles, titles, 3, 600, "A heading", "A footer. " * 30, ["r"] * 5)
    assert sheet.shape[1] == 600
    assert all((sheet == 40 * (k + 1)).all(2).sum() > 10_000 for k in range(5))
    # Those of a row stand in line.
    row = pictures.contact_sheet(
        [tiles[4]] * 2, ["mug", "a rather long question about a teapot " * 3], 2, 400
    )
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


def frames(count: int, height: int = 36, width: int = 48) -> list[np.ndarray]:
    """A grey that grows lighter, with a red square that moves."""
    made = [np.full((height, width, 3), 30 + 10 * number, np.uint8) for number in range(count)]
    for number, frame in enumerate(made):
        frame[8:16, 4 * number : 4 * number + 8] = (220, 20, 20)
    return made


@pytest.fixture
def ffmpeg() -> Any:
    return pytest.importorskip("imageio_ffmpeg", reason="imageio-ffmpeg is not installed")


def read(ffmpeg: Any, path: Path) -> tuple[dict, list[np.ndarray]]:
    reader = ffmpeg.read_frames(str(path))
    facts = next(reader)
    width, height = facts["size"]
    return facts, [np.frombuffer(frame, np.uint8).reshape(height, width, 3) for frame in reader]


@pytest.mark.parametrize(("height", "width"), [(36, 48), (37, 49)])
def test_a_video_shows_its_frames(ffmpeg: Any, tmp_path: Path, height: int, width: int) -> None:
    given = frames(9, height, width)
    for name in ("a.mp4", "b.mp4"):
        save_video(iter(given), tmp_path / name, 12.5)
    assert (tmp_path / "a.mp4").read_bytes() == (tmp_path / "b.mp4").read_bytes()
    facts, found = read(ffmpeg, tmp_path / "a.mp4")
    assert (facts["size"], facts["fps"], len(found)) == ((48, 36), 12.5, 9)
    for one, other in zip(given, found, strict=True):
        assert np.abs(one[:36, :48].astype(int) - other).mean() < 12


def test_what_makes_no_video_is_refused(ffmpeg: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for given in ([], [*frames(2), *frames(1, 20, 20)], frames(1, 1, 9)):
        with refuses():
            save_video(given, tmp_path / "a.mp4", 24)
    nowhere = Mock(side_effect=RuntimeError("No ffmpeg exe could be found"))
    monkeypatch.setattr(ffmpeg, "get_ffmpeg_exe", nowhere)
    with refuses(ScoupError):
        check_video_writer()
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)  # a missing package
    with refuses(ScoupError):
        check_video_writer()
