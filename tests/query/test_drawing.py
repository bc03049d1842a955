"""Pictures of answers and of fields, and contact sheets."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import ImageDraw
from scipy import ndimage

from messages import refuses
from query.conftest import ASKED, Queried
from scoup import raster
from scoup.pictures import Picture, as_picture, heat_map, heat_overlay
from scoup.pictures.lettering import PAPER
from scoup.query.answer import Answer
from scoup.query.answer_files import MOST_VIEWS, AnswerSheets
from scoup.query.drawings import code_drawing, drawing
from scoup.query.field_view import FieldView
from scoup.query.view_answer import ViewAnswer
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
    assert np.array_equal(drawing(field, "color", plain=True)(field.at(camera)), as_picture(rgb))
    answer = field.at(camera).answer(queried.texts)[0]
    expected = heat_map(answer.heat, rgb, "word 0", answer.level, float(answer.heat.max()), camera.name)
    assert np.array_equal(drawing(field, "relevancy", question=queried.texts)(field.at(camera)), expected)
    plain = drawing(field, "relevancy", question=queried.texts, plain=True)(field.at(camera))
    assert np.array_equal(plain, heat_overlay(answer.heat, rgb))


def test_the_same_code_has_the_same_colour_in_every_view(queried: Queried, monkeypatch) -> None:
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


RGB = torch.full((30, 40, 3), 0.5)


def answer(heat: float, is_present: bool = True, width: int = 15) -> ViewAnswer:
    score = 0.93 if is_present else 0.2
    whole = Answer("mug", torch.ones(9, dtype=torch.bool), "m", score, ASKED, is_present)
    mask = torch.zeros(30, 40, dtype=torch.bool)
    mask[10:20, 10 : 10 + width] = is_present
    box = (10, 10, 10 + width, 20) if is_present else None
    point = (10 + width // 2, 15) if is_present else None
    return ViewAnswer(whole, "a.png", mask, torch.where(mask, heat, 0.4), mask, box, point)


def sheets_of(names: list[str], *views: list[ViewAnswer]) -> AnswerSheets:
    """A sheet of views that are named by their numbers."""
    sheets = AnswerSheets(names, len(views))
    for number, answers in enumerate(views):
        sheets.add(f"view {number}", answers, RGB)
    return sheets


def cells_of(sheet: Picture) -> list[tuple[slice, slice]]:
    """Rows and columns of the cells: what is not paper, and neither lettering nor the scale below."""
    labels = np.zeros(sheet.shape[:2], np.int32)
    ndimage.label((sheet != PAPER).any(2), output=labels)
    found = ndimage.find_objects(labels)
    return [(y, x) for y, x in found if x.stop - x.start > 200 and y.stop - y.start > 50]


def drawn_texts(sheets: AnswerSheets, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    texts: list[str] = []
    with monkeypatch.context() as patch:
        patch.setattr(ImageDraw.ImageDraw, "text", lambda self, at, text, *rest, **more: texts.append(text))
        sheets.pictures()
    return texts


def test_every_cell_says_what_was_found(monkeypatch: pytest.MonkeyPatch) -> None:
    sheets = sheets_of(
        ["mug", "teapot"], [answer(0.7), answer(0.6, is_present=False)], [answer(0.8), answer(0.9)]
    )
    texts = drawn_texts(sheets, monkeypatch)
    assert {"2 texts in 2 views", "largest 0.90"} <= set(texts)
    assert texts.count("mug") == texts.count("teapot") == 2
    assert "view 0: level m, 12.5% of the view, sure (score 0.93)" in " ".join(texts)
    assert "view 0: not in this scene (score 0.20)" in " ".join(texts)


def test_an_absent_thing_has_no_heat() -> None:
    absent = replace(answer(0.7, is_present=False), heat=torch.full((30, 40), 0.7))
    (sheet,) = sheets_of(["mug"], [answer(0.7)], [absent]).pictures()
    colored = np.ptp(sheet[: sheet.shape[0] * 2 // 3].astype(int), axis=2) > 60
    half = sheet.shape[1] // 2
    assert colored[:, :half].sum() > 1000
    assert not colored[:, half:].any()


def test_the_colours_are_those_of_one_scale() -> None:
    (low,), (high,) = (sheets_of(["mug"], [answer(0.7)], [answer(other)]).pictures() for other in (0.7, 0.95))
    assert low[:600, :600].mean() > high[:600, :600].mean()


def test_of_many_views_those_that_show_most_are_drawn(monkeypatch) -> None:
    widths = np.random.default_rng(0).permutation(np.arange(30).repeat(2)).reshape(30, 2)
    views = [[answer(0.7, width > 0, width) for width in row] for row in widths.tolist()]
    chosen: list[int] = []
    for turn in range(MOST_VIEWS):  # the rule, written out over all views
        order = np.argsort(-widths[:, turn % 2], kind="stable")
        chosen.append(next(int(view) for view in order if view not in chosen))
    texts = drawn_texts(sheets_of(["mug", "teapot"], *views), monkeypatch)
    heading = "2 texts in the 12 of 30 views where the masks are largest"
    assert heading in " ".join(texts)
    shown = [text.split(":")[0] for text in texts if text.startswith("view ")]
    assert shown[::2] == [f"view {number}" for number in sorted(chosen)]
    views = [[answer(0.9, is_present=number != 3)] for number in range(MOST_VIEWS)]
    texts = drawn_texts(sheets_of(["mug"], *views, [answer(0.6)]), monkeypatch)
    assert '"mug" in the 12 of 13 views where the masks are largest' in texts
    assert f"view {MOST_VIEWS}" in texts
    assert "view 3" not in texts


@pytest.mark.parametrize(("texts", "views", "headings"), [
    (7, 2, ["texts 1 to 3 of 7 in 2 views", "texts 4 to 7 of 7 in 2 views"]),
    (8, 1, ["texts 1 to 4 of 8 in 1 view", "texts 5 to 8 of 8 in 1 view"]),
    (13, 2, [f"texts {texts} of 13 in 2 views" for texts in ("1 to 4", "5 to 8", "9 to 13")]),
])  # fmt: skip
def test_each_view_is_a_row_of_each_sheet(texts: int, views: int, headings: list[str], monkeypatch) -> None:
    sheets = sheets_of([f"thing {number}" for number in range(texts)], *[[answer(0.7)] * texts] * views)
    assert [text for text in drawn_texts(sheets, monkeypatch) if text.startswith("texts")] == headings
    pictures = [(sheet, cells_of(sheet)) for sheet in sheets.pictures()]
    for sheet, cells in pictures:
        assert len({cell[0].start for cell in cells}) == views
        assert len(cells) == views * len({cell[1].start for cell in cells})
        assert max(cell[1].stop for cell in cells) > sheet.shape[1] - 20  # no empty column
    widths = [cell[1].stop - cell[1].start for _, cells in pictures for cell in cells]
    assert (len(sheets), len(widths)) == (len(headings), texts * views)
    assert max(widths) - min(widths) <= 1


@pytest.mark.parametrize(("height", "width"), [(1, 1), (60, 20), (20, 60)])
def test_views_of_any_shape(height: int, width: int) -> None:
    mask = torch.ones(height, width, dtype=torch.bool)
    odd = replace(answer(0.7), mask=mask, box=(0, 0, width, height), point=(0, 0), heat=mask * 0.7)
    sheets = AnswerSheets(["überlange Größe " * 20], 2)
    sheets.add("a.png", [odd], torch.zeros(height, width, 3))
    sheets.add("b.png", [answer(0.7)], RGB)
    (sheet,) = sheets.pictures()
    odd_cell, even_cell = sorted(cells_of(sheet), key=lambda cell: cell[1].start)
    for cell, shape in ((odd_cell, (height, width)), (even_cell, (30, 40))):
        tall, wide = (side.stop - side.start for side in cell)
        assert tall == pytest.approx(wide * shape[0] / shape[1], abs=2)
        assert np.ptp(sheet[cell].astype(int), axis=2).max() > 60  # heat
