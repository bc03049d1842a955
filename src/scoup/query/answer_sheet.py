"""Contact sheets of the answers of a query."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from PIL import Image
from torch import Tensor

from scoup.base.counts import counted
from scoup.base.errors import InputError
from scoup.pictures import answer_overlay, as_picture, contact_sheet, heat_legend, stacked
from scoup.pictures.colors import Picture
from scoup.pictures.sheet import GAP
from scoup.query.answer import ViewAnswer

MOST_VIEWS = 12  # on a sheet
MOST_TEXTS = 6  # on a sheet; more are spread evenly over several
VIEWS_BESIDE = 4  # in a row, of one text
WIDTH, HEIGHT = 1600, 3600  # of a sheet, in pixels, more or less
NARROWEST, WIDEST = 320, 960  # of a cell, in pixels
LEAST_SPAN = 0.05  # of the relevancy that the colours stand for

HOW_TO_READ = (
    "Heat: relevancy, the same colours in all cells. White line: the mask. Cross: the pixel that fits best. Blue: the "
    "box around the mask without specks. Grey all over: absent, or not visible from here."
)


@dataclass(frozen=True)
class _Cell:
    """An answer at the size of a cell."""

    heat: np.ndarray
    mask: np.ndarray
    box: tuple[float, float, float, float] | None
    point: tuple[float, float] | None
    remark: str
    visible: bool
    coverage: float
    largest: float  # relevancy before resizing


@dataclass(frozen=True)
class _Row:
    """A view with its answers, one per text."""

    number: int
    view: str
    picture: Picture
    cells: tuple[_Cell, ...]


class AnswerSheets:
    """Contact sheets: rows are views and columns texts; the views of a single text stand beside each other.

    Of more views than ``MOST_VIEWS`` only the best are kept: the texts choose in turn, each the view in which its
    mask is largest among those not yet chosen.

    Args:
        texts: of the query.
        views: number of views that will be added.
    """

    def __init__(self, texts: Sequence[str], views: int) -> None:
        if not texts or views < 1:
            raise InputError("sheets of answers need at least one text and one view")
        self.texts, self.views = tuple(texts), views
        several = len(texts) > 1
        columns = -(-len(texts) // len(self)) if several else min(views, VIEWS_BESIDE)
        rows = min(views, MOST_VIEWS) if several else -(-min(views, MOST_VIEWS) // columns)
        self._cell_width = min(WIDEST, max(NARROWEST, min(WIDTH // columns, HEIGHT // rows)))
        self._rows: list[_Row] = []
        self._added = 0

    def __len__(self) -> int:
        """Number of sheets."""
        return -(-len(self.texts) // MOST_TEXTS)

    def add(self, view: str, answers: Sequence[ViewAnswer], rgb: Tensor) -> None:
        """Add a view by its name, one answer per text, and its colour render [H, W, 3] float 0..1."""
        picture = as_picture(rgb)
        width = self._cell_width
        size = (width, max(1, round(picture.shape[0] * width / picture.shape[1])))
        small = np.asarray(Image.fromarray(picture).resize(size, Image.Resampling.LANCZOS))
        cells = tuple(_cell(answer, size) for answer in answers)
        self._rows.append(_Row(self._added, view, small, cells))
        self._added += 1
        if len(self._rows) > MOST_VIEWS:
            # A view not chosen among fewer is not chosen among more.
            self._rows = _best_rows(self._rows, MOST_VIEWS)

    def pictures(self) -> list[Picture]:
        """Draw the sheets, after at least one view was added."""
        high = max(cell.largest for row in self._rows for cell in row.cells)
        span = (min(0.5, high - LEAST_SPAN), high)
        ends = [len(self.texts) * number // len(self) for number in range(len(self) + 1)]
        return [self._sheet(range(*of_sheet), span) for of_sheet in pairwise(ends)]

    def _sheet(self, columns: range, span: tuple[float, float]) -> Picture:
        alone = len(self.texts) == 1
        tiles, titles, remarks = [], [], []
        for row in self._rows:
            for column in columns:
                cell = row.cells[column]
                heat = cell.heat if cell.visible else np.zeros_like(cell.heat)
                tiles.append(answer_overlay(heat, cell.mask, row.picture, span, cell.box, cell.point))
                titles.append(row.view if alone else self.texts[column])
                remarks.append(cell.remark if alone else f"{row.view}: {cell.remark}")
        beside = min(self.views, VIEWS_BESIDE) if alone else len(columns)
        width = beside * (self._cell_width + GAP) + GAP
        heading = self._heading(columns)
        sheet = contact_sheet(tiles, titles, beside, width, heading, HOW_TO_READ, remarks)
        return stacked([sheet, heat_legend(width, *span)])

    def _heading(self, columns: range) -> str:
        shown = len(self._rows)
        texts = f'"{self.texts[0]}"' if len(self.texts) == 1 else f"{len(self.texts)} texts"
        if len(self) > 1:
            texts = f"texts {columns[0] + 1} to {columns[-1] + 1} of {len(self.texts)}"
        if shown == self.views:
            return f"{texts} in {counted(shown, 'view')}"
        turns = ", the texts choosing in turn" if len(self.texts) > 1 else ""
        return f"{texts} in {shown} of {counted(self.views, 'view')}: those that show most{turns}"


def _best_rows(rows: Sequence[_Row], count: int) -> list[_Row]:
    """The rows of the best answers, chosen by the texts in turn, in their order."""
    left, chosen = list(rows), []
    for turn in range(min(count, len(rows))):
        column = turn % len(rows[0].cells)
        best = max(left, key=lambda row: (row.cells[column].visible, row.cells[column].coverage, -row.number))
        left.remove(best)
        chosen.append(best)
    return sorted(chosen, key=lambda row: row.number)


def _cell(answer: ViewAnswer, size: tuple[int, int]) -> _Cell:
    height, width = answer.mask.shape
    x, y = size[0] / width, size[1] / height
    relevancy, how = answer.heat.numpy(), Image.Resampling.BILINEAR
    mask = np.asarray(Image.fromarray(answer.mask.numpy().astype(np.uint8) * 255).resize(size, how)) > 127
    return _Cell(
        heat=np.asarray(Image.fromarray(relevancy).resize(size, how)),
        mask=mask,
        box=answer.box and (answer.box[0] * x, answer.box[1] * y, answer.box[2] * x, answer.box[3] * y),
        point=answer.point and ((answer.point[0] + 0.5) * x, (answer.point[1] + 0.5) * y),
        remark=answer.remark(),
        visible=answer.visible,
        coverage=answer.coverage,
        largest=float(relevancy.max()),
    )
