"""Contact sheets of the answers of a query."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import ImageDraw
from scipy import ndimage

from query.conftest import ASKED
from scoup.pictures import Picture
from scoup.pictures.lettering import PAPER
from scoup.query.answer import Answer
from scoup.query.answer_files import MOST_VIEWS, AnswerSheets
from scoup.query.view_answer import ViewAnswer

RGB = torch.full((30, 40, 3), 0.5)


def answer(heat: float, is_present: bool = True, width: int = 15) -> ViewAnswer:
    score = 0.93 if is_present else 0.2
    whole = Answer("mug", torch.ones(9, dtype=torch.bool), "m", score, ASKED, is_present)
    mask = torch.zeros(30, 40, dtype=torch.bool)
    mask[10:20, 10 : 10 + width] = is_present
    box = (10, 10, 10 + width, 20) if is_present else None
    point = (10 + width // 2, 15) if is_present else None
    return ViewAnswer(whole, "a.png", mask, torch.where(mask, heat, 0.4), mask, box, point)


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
    sheets = AnswerSheets(["mug", "teapot"], 2)
    sheets.add("a.png", [answer(0.7), answer(0.6, is_present=False)], RGB)
    sheets.add("b.png", [answer(0.8), answer(0.9)], RGB)
    texts = drawn_texts(sheets, monkeypatch)
    assert "2 texts in 2 views" in texts
    assert texts.count("mug") == texts.count("teapot") == 2
    assert "a.png: level m, 12.5% of the view, sure (score 0.93)" in " ".join(texts)
    assert "a.png: not in this scene (score 0.20)" in " ".join(texts)
    assert "largest 0.90" in texts


def test_an_absent_thing_has_no_heat() -> None:
    sheets = AnswerSheets(["mug"], 2)
    sheets.add("a.png", [answer(0.7)], RGB)
    sheets.add("b.png", [answer(0.7, is_present=False)], RGB)
    (sheet,) = sheets.pictures()
    cells = sheet[: sheet.shape[0] * 2 // 3].astype(int)
    colored = np.ptp(cells, axis=2) > 60
    half = sheet.shape[1] // 2
    assert colored[:, :half].sum() > 1000
    assert not colored[:, half:].any()


def test_the_colours_are_those_of_one_scale() -> None:
    def heat(*scores: float) -> np.ndarray:
        sheets = AnswerSheets(["mug"], len(scores))
        for number, score in enumerate(scores):
            sheets.add(f"{number}.png", [answer(score)], RGB)
        (sheet,) = sheets.pictures()
        return sheet

    assert heat(0.9, 0.7).shape == heat(0.7, 0.7).shape
    left = slice(0, 600)
    assert heat(0.7, 0.7)[:600, left].mean() > heat(0.7, 0.95)[:600, left].mean()


def test_of_many_views_the_best_are_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)
    widths = rng.permutation(np.arange(30).repeat(2)).reshape(30, 2)
    sheets = AnswerSheets(["mug", "teapot"], 30)
    for number, (mug, teapot) in enumerate(widths.tolist()):
        shown = [answer(0.7, width > 0, width) for width in (mug, teapot)]
        sheets.add(f"view {number}", shown, RGB)
    chosen: list[int] = []
    for turn in range(MOST_VIEWS):  # the rule, written out over all views
        order = np.argsort(-widths[:, turn % 2], kind="stable")
        chosen.append(next(int(view) for view in order if view not in chosen))
    texts = drawn_texts(sheets, monkeypatch)
    heading = "2 texts in 12 of 30 views: those that show most, the texts choosing in turn"
    assert heading in " ".join(texts)
    shown = [text.split(":")[0] for text in texts if text.startswith("view ")]
    assert shown[::2] == [f"view {number}" for number in sorted(chosen)]


def test_what_is_there_goes_before_what_is_not(monkeypatch: pytest.MonkeyPatch) -> None:
    sheets = AnswerSheets(["mug"], MOST_VIEWS + 1)
    for number in range(MOST_VIEWS):
        sheets.add(f"view {number}", [answer(0.9, is_present=number != 3)], RGB)
    sheets.add("last", [replace(answer(0.6))], RGB)
    texts = drawn_texts(sheets, monkeypatch)
    assert '"mug" in 12 of 13 views: those that show most' in texts
    assert "last" in texts
    assert "view 3" not in texts


def test_more_texts_take_more_sheets(monkeypatch: pytest.MonkeyPatch) -> None:
    names = [f"thing {number}" for number in range(8)]
    sheets = AnswerSheets(names, 1)
    sheets.add("a.png", [answer(0.7) for _ in names], RGB)
    assert len(sheets) == len(sheets.pictures()) == 2
    texts = drawn_texts(sheets, monkeypatch)
    assert [text for text in texts if text.startswith("texts")] == [
        "texts 1 to 4 of 8 in 1 view",
        "texts 5 to 8 of 8 in 1 view",
    ]


@pytest.mark.parametrize("views", [1, 2])
@pytest.mark.parametrize("texts", [7, 8, 13])
def test_each_view_is_a_row_of_each_sheet(texts: int, views: int) -> None:
    sheets = AnswerSheets([f"thing {number}" for number in range(texts)], views)
    for view in range(views):
        sheets.add(f"view {view}", [answer(0.7)] * texts, RGB)
    widths: set[int] = set()
    count = 0
    for sheet in sheets.pictures():
        cells = cells_of(sheet)
        count += len(cells)
        rows = {cell[0].start for cell in cells}
        assert len(rows) == views
        assert len(cells) == views * len({cell[1].start for cell in cells})
        widths |= {cell[1].stop - cell[1].start for cell in cells}
        assert max(cell[1].stop for cell in cells) > sheet.shape[1] - 20  # no empty column
    assert count == texts * views
    assert max(widths) - min(widths) <= 1


@pytest.mark.parametrize(("height", "width"), [(1, 1), (120, 30), (30, 120)])
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
