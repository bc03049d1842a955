"""Answers as files: contact sheets, pictures, arrays, COCO's JSON (docs/formats.md, "Answers")."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from torch import Tensor

from scoup.base.errors import InputError
from scoup.base.file_names import unique_slugs
from scoup.base.npz import write_npz
from scoup.io import save_png
from scoup.io.coco import CocoAnnotations
from scoup.query.answer import ViewAnswer
from scoup.query.answer_sheet import AnswerSheets
from scoup.scene.cameras import Camera

PICTURES = ("heat", "mask", "overlay")
COCO = "coco.json"
NPZ = "relevancy.npz"


class AnswerFiles:
    """The files of a query's answers, written view by view.

    Args:
        texts: of the query.
        cameras: of all views, in the order in which they are added.
        pictures: "sheet", "all" (each picture by itself, too) or "none".
        npz: write relevancy and masks of each view as arrays.
        coco: write the masks of all views as COCO's JSON.
    """

    def __init__(
        self,
        texts: Sequence[str],
        cameras: Sequence[Camera],
        pictures: Literal["sheet", "all", "none"] = "sheet",
        npz: bool = False,
        coco: bool = False,
    ) -> None:
        self._folders = dict(
            zip((c.name for c in cameras), unique_slugs(c.stem for c in cameras), strict=True)
        )
        kinds = PICTURES if pictures == "all" else ()
        self._singles = [{kind: f"{name}_{kind}.png" for kind in kinds} for name in unique_slugs(texts)]
        self._npz = npz
        self._sheets = None if pictures == "none" else AnswerSheets(texts, len(cameras))
        if coco and len(set(texts)) < len(texts):
            raise InputError("two texts are equal, but COCO's categories differ by name; pass each text once")
        self._coco = CocoAnnotations(tuple(texts)) if coco else None
        singles = [name for of_text in self._singles for name in of_text.values()] + [NPZ] * npz
        # Of all files, within their folder.
        self.names = [
            *self.sheet_names,
            *[COCO] * coco,
            *(f"{folder}/{name}" for folder in self._folders.values() for name in singles),
        ]

    @property
    def n_views(self) -> int:
        """Number of views."""
        return len(self._folders)

    @property
    def sheet_names(self) -> list[str]:
        """File names of the contact sheets."""
        if self._sheets is None:
            return []
        count = len(self._sheets)
        return ["sheet.png"] if count == 1 else [f"sheet_{number}.png" for number in range(1, count + 1)]

    @property
    def needs_colors(self) -> bool:
        """Return whether ``add`` needs the colours of the views."""
        return self._sheets is not None

    def of_view(self, camera: Camera, out: Path) -> list[dict[str, str]]:
        """Return the paths of a view's files: one dict per text, by kind."""
        folder = out / self._folders[camera.name]
        arrays = {"npz": (folder / NPZ).as_posix()} if self._npz else {}
        return [
            {**{kind: (folder / name).as_posix() for kind, name in names.items()}, **arrays}
            for names in self._singles
        ]

    def add(self, camera: Camera, answers: Sequence[ViewAnswer], rgb: Tensor | None, hidden: Path) -> None:
        """Write the files of one view, given one answer per text and its colours [H, W, 3], into a folder."""
        folder = hidden / self._folders[camera.name]
        if self._sheets is not None and rgb is not None:
            self._sheets.add(camera.name, answers, rgb)
            for answer, names in zip(answers, self._singles, strict=True):
                drawn = answer.pictures(rgb) if names else {}
                for kind, name in names.items():
                    save_png(drawn[kind], folder / name)
        if self._npz:
            folder.mkdir(parents=True, exist_ok=True)
            write_npz(folder / NPZ, answer_arrays(answers), compressed=True)
        if self._coco is not None:
            masks = [answer.mask.numpy() for answer in answers]
            size = (camera.width, camera.height)
            self._coco.add(camera.name, size, masks, [answer.score or 0.0 for answer in answers])

    def finish(self, hidden: Path) -> None:
        """Write the files of all views together."""
        if self._sheets is not None:
            for name, sheet in zip(self.sheet_names, self._sheets.pictures(), strict=True):
                save_png(sheet, hidden / name)
        if self._coco is not None:
            self._coco.write(hidden / COCO)


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
