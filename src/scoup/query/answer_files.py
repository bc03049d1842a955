"""Answers as files: contact sheets, pictures, arrays, COCO's JSON (docs/formats.md, "Answers")."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path, PurePosixPath
from typing import Literal

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from scoup.base import InputError, Progress, counted, reported, unique_slugs, write_npz
from scoup.field import Field
from scoup.io import save_png
from scoup.pictures import Picture, answer_overlay, as_picture, contact_sheet, heat_legend, save_frames
from scoup.query.coco import CocoAnnotations
from scoup.query.drawings import Motion, heat_frames
from scoup.query.things import Place
from scoup.query.view_answer import ViewAnswer
from scoup.scene import Camera, Cameras

PICTURES = ("heat", "mask", "overlay")
COCO = "coco.json"
NPZ = "relevancy.npz"
MOST_VIEWS = 12  # on a sheet
MOST_TEXTS = 6  # on a sheet; more are spread evenly over several
VIEWS_BESIDE = 4  # in a row, of one text
WIDTH, HEIGHT = 1600, 3600  # of a sheet, in pixels, approximately
NARROWEST, WIDEST = 320, 960  # of a cell, in pixels
FRAMES, FRAMES_PER_SECOND = 120, 24.0  # of a video
LEAST_SPAN = 0.05  # of the relevancy that the colours stand for

HOW_TO_READ = (
    "Heat: relevancy, the same colours in all cells. White line: the mask. Cross: the pixel that fits best. Blue: the "
    "box around the mask without specks. Yellow line: the runner-up. Grey all over: absent, or not visible from here."
)


class AnswerFiles:
    """The files of a query's answers, written view by view.

    Args:
        texts: of the query.
        cameras: of all views, in the order in which they are added.
        pictures: "sheet", "all" (each picture by itself, too) or "none".
        npz: write relevancy and masks of each view as arrays.
        coco: names of categories, one per text, to write the masks of all views as COCO's JSON.
        video: of each text's heat map; "turntable": those of texts without a place are left out.
    """

    def __init__(
        self,
        texts: Sequence[str],
        cameras: Sequence[Camera],
        pictures: Literal["sheet", "all", "masks", "none"] = "sheet",
        npz: bool = False,
        coco: Sequence[str] = (),
        video: Motion | Literal["none"] = "none",
    ) -> None:
        self._folders = dict(
            zip((c.name for c in cameras), unique_slugs(c.stem for c in cameras), strict=True)
        )
        kinds = PICTURES if pictures == "all" else ()
        self._singles = [{kind: f"{name}_{kind}.png" for kind in kinds} for name in unique_slugs(texts)]
        self._npz = npz
        self._masks = (
            dict(zip(self._folders, mask_files(cameras), strict=True)) if pictures == "masks" else {}
        )
        self._sheets = None if pictures in ("masks", "none") else AnswerSheets(texts, len(cameras))
        if len(set(coco)) < len(coco):
            raise InputError("two texts are equal, but COCO's categories differ by name; pass each text once")
        self._coco = CocoAnnotations(tuple(coco)) if coco else None
        self._motion: Motion | Literal["none"] = video
        self._videos = [] if video == "none" else [f"{name}_{video}.mp4" for name in unique_slugs(texts)]
        singles = [name for of_text in self._singles for name in of_text.values()] + [NPZ] * npz
        # Of all files, within their folder.
        self.names = [
            *self.sheet_names,
            *[COCO] * bool(coco),
            *self._masks.values(),
            *(f"{folder}/{name}" for folder in self._folders.values() for name in singles),
            *self._videos,
        ]

    @property
    def sheet_names(self) -> list[str]:
        """File names of the contact sheets."""
        if self._sheets is None:
            return []
        count = len(self._sheets)
        return ["sheet.png"] if count == 1 else [f"sheet_{number}.png" for number in range(1, count + 1)]

    def of_view(self, camera: Camera, out: Path) -> list[dict[str, str]]:
        """Return the paths of a view's files: one dict per text, by kind."""
        folder = out / self._folders[camera.name]
        arrays = {"npz": (folder / NPZ).as_posix()} if self._npz else {}
        return [
            {**{kind: (folder / name).as_posix() for kind, name in names.items()}, **arrays}
            for names in self._singles
        ]

    def add(self, camera: Camera, answers: Sequence[ViewAnswer], rgb: Tensor | None, hidden: Path) -> None:
        """Write the files of one view into a folder, from one answer per text and its colours [H, W, 3], which pictures
        need."""
        folder = hidden / self._folders[camera.name]
        if self._sheets is not None and rgb is not None:
            self._sheets.add(camera.name, answers, rgb)
            for answer, names in zip(answers, self._singles, strict=True):
                drawn = answer.pictures(rgb) if names else {}
                for kind, name in names.items():
                    save_png(drawn[kind], folder / name)
        if self._masks:
            save_png(
                torch.stack([answer.mask for answer in answers]).any(0), hidden / self._masks[camera.name]
            )
        if self._npz:
            folder.mkdir(parents=True, exist_ok=True)
            write_npz(folder / NPZ, answer_arrays(answers), compressed=True)
        if self._coco is not None:
            masks = [answer.mask.numpy() for answer in answers]
            self._coco.add(camera.name, masks, [answer.score or 0.0 for answer in answers])

    def add_videos(
        self, field: Field, places: Sequence[Place], cameras: Cameras, hidden: Path, progress: Progress
    ) -> list[str]:
        """Write the videos of the texts, which are at ``places``; return their names."""
        written = []
        for name, place in zip(self._videos, places, strict=True):
            if self._motion == "none" or (self._motion == "turntable" and place.position is None):
                continue
            frames = heat_frames(field, place, cameras, self._motion, FRAMES)
            save_frames(reported(frames, "video", FRAMES, progress), hidden / name, FRAMES_PER_SECOND)
            written.append(name)
        return written

    def finish(self, hidden: Path) -> None:
        """Write the files of all views together."""
        if self._sheets is not None:
            for name, sheet in zip(self.sheet_names, self._sheets.pictures(), strict=True):
                save_png(sheet, hidden / name)
        if self._coco is not None:
            self._coco.write(hidden / COCO)


def mask_files(cameras: Iterable[Camera]) -> list[str]:
    """Return names of binary masks as LichtFeld Studio and Brush look for them: masks/STEM.png, of the photographs."""
    stems = [os.path.splitext(camera.name)[0] for camera in cameras]
    plain = all(
        PurePosixPath(stem).parts and not {"..", "/"} & {*PurePosixPath(stem).parts} for stem in stems
    )
    names = stems if plain and len({*stems}) == len(stems) else unique_slugs(stems)
    return [f"masks/{name}.png" for name in names]


def answer_arrays(answers: Sequence[ViewAnswer]) -> dict[str, np.ndarray]:
    """Return the answers of one view as arrays: texts [Q] and levels [Q] as strings, relevancy [Q, H, W] float32 at the
    level of each answer, mask [Q, H, W] boolean, score (NaN if it is not known) and present [Q].
    """
    scores = [np.nan if answer.score is None else answer.score for answer in answers]
    return {
        "texts": np.array([answer.text for answer in answers]),
        "levels": np.array([answer.level for answer in answers]),
        "relevancy": np.stack([answer.heat.numpy() for answer in answers]),
        "mask": np.stack([answer.mask.numpy() for answer in answers]),
        "score": np.array(scores, np.float32),
        "present": np.array([answer.presence for answer in answers]),
    }


@dataclass(frozen=True)
class _Cell:
    """An answer at the size of a cell."""

    heat: np.ndarray
    mask: np.ndarray
    box: tuple[float, float, float, float] | None
    point: tuple[float, float] | None
    runner_up: np.ndarray | None
    remark: str
    coverage: float  # 0 if nothing is visible
    largest: float  # relevancy before resizing


@dataclass(frozen=True)
class _Row:
    """A view with its answers, one per text."""

    view: str
    picture: Picture
    cells: tuple[_Cell, ...]


class AnswerSheets:
    """Contact sheets: rows are views and columns texts; the views of a single text stand beside each other.

    Of more views than ``MOST_VIEWS`` only the best are kept: the texts choose in turn, each the view in which its
    mask is largest among those not yet chosen.
    """

    def __init__(self, texts: Sequence[str], views: int) -> None:
        """Make sheets of one or more texts in so many views, of which each will be added."""
        self.texts, self.views = tuple(texts), views
        several = len(texts) > 1
        columns = -(-len(texts) // len(self)) if several else min(views, VIEWS_BESIDE)
        rows = min(views, MOST_VIEWS) if several else -(-min(views, MOST_VIEWS) // columns)
        self._cell_width = min(WIDEST, max(NARROWEST, min(WIDTH // columns, HEIGHT // rows)))
        self._rows: list[_Row] = []

    def __len__(self) -> int:
        """Number of sheets."""
        return -(-len(self.texts) // MOST_TEXTS)

    def add(self, view: str, answers: Sequence[ViewAnswer], rgb: Tensor) -> None:
        """Add a view by its name, one answer per text, and its colour render [H, W, 3] float 0..1."""
        picture = as_picture(rgb)
        width = self._cell_width
        size = (width, max(1, round(picture.shape[0] * width / picture.shape[1])))
        small = np.asarray(Image.fromarray(picture).resize(size, Image.Resampling.LANCZOS))
        self._rows.append(_Row(view, small, tuple(_cell(answer, size) for answer in answers)))
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
                heat = cell.heat if cell.coverage else np.zeros_like(cell.heat)
                marks = span, cell.box, cell.point, cell.runner_up
                tiles.append(answer_overlay(heat, cell.mask, row.picture, *marks))
                titles.append(row.view if alone else self.texts[column])
                remarks.append(cell.remark if alone else f"{row.view}: {cell.remark}")
        beside = min(self.views, VIEWS_BESIDE) if alone else len(columns)
        heading, width = self._heading(columns), self._cell_width
        sheet = contact_sheet(tiles, titles, beside, 0, heading, HOW_TO_READ, remarks, tile_width=width)
        return heat_legend(sheet, *span)

    def _heading(self, columns: range) -> str:
        n_shown = len(self._rows)
        texts = f'"{self.texts[0]}"' if len(self.texts) == 1 else f"{len(self.texts)} texts"
        if len(self) > 1:
            texts = f"texts {columns[0] + 1} to {columns[-1] + 1} of {len(self.texts)}"
        if n_shown == self.views:
            return f"{texts} in {counted(n_shown, 'view')}"
        return f"{texts} in the {n_shown} of {counted(self.views, 'view')} where the masks are largest"


def _best_rows(rows: Sequence[_Row], count: int) -> list[_Row]:
    """Return the rows of the best answers, chosen by the texts in turn, in their order."""
    left, columns = list(range(len(rows))), len(rows[0].cells)
    for turn in range(min(count, len(rows))):
        # The first of equals.
        left.remove(max(left, key=lambda number: rows[number].cells[turn % columns].coverage))
    return [row for number, row in enumerate(rows) if number not in left]


def _cell(answer: ViewAnswer, size: tuple[int, int]) -> _Cell:
    height, width = answer.mask.shape
    x, y = size[0] / width, size[1] / height
    relevancy, how = answer.heat.numpy(), Image.Resampling.BILINEAR

    def resized(mask: Tensor) -> np.ndarray:
        return np.asarray(Image.fromarray(mask.numpy().astype(np.uint8) * 255).resize(size, how)) > 127

    return _Cell(
        heat=np.asarray(Image.fromarray(relevancy).resize(size, how)),
        mask=resized(answer.mask),
        box=answer.box and (answer.box[0] * x, answer.box[1] * y, answer.box[2] * x, answer.box[3] * y),
        point=answer.point and ((answer.point[0] + 0.5) * x, (answer.point[1] + 0.5) * y),
        runner_up=None if answer.runner_up is None else resized(answer.runner_up),
        remark=answer.remark(),
        coverage=answer.coverage,
        largest=float(relevancy.max()),
    )
