"""Read LangSplat's region features: ``<stem>_s.npy`` (labels) and ``<stem>_f.npy`` (embeddings) per image."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scoup.base import FileFormatError
from scoup.io.npy import open_npy
from scoup.io.reading import MAX_IMAGE_SIDE
from scoup.io.regions.langsplat_rows import FILE_LEVELS, copy_labels, level_blocks
from scoup.io.regions.views import REMEDY

ENDINGS = ("_s.npy", "_f.npy")


@dataclass(frozen=True, eq=False)
class LangSplatView:
    """A view: the headers of its two files. Arrays are read when they are needed.

    Neither file is kept open. Which rows belong to which level is read from the labels on first use, once.
    """

    folder: Path
    name: str  # stem of the files
    width: int  # of the label maps, as the height
    height: int
    rows: int  # embeddings of all levels
    dim: int  # D of the embeddings
    _blocks: dict[str, slice] = field(default_factory=dict)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    levels = FILE_LEVELS
    manifest = photograph = ""  # the files tell neither

    @property
    def counts(self) -> dict[str, int]:
        return {"all": self.rows}  # the headers do not tell the levels apart

    @property
    def labels_path(self) -> Path:
        return self.folder / f"{self.name}{ENDINGS[0]}"

    @property
    def embeddings_path(self) -> Path:
        return self.folder / f"{self.name}{ENDINGS[1]}"

    def labels(self, levels: Sequence[str]) -> NDArray[np.int32]:
        """Return [levels, H, W] labels; embeddings are not read once the blocks are known."""
        blocks = self.blocks()
        planes = _open_planes(self.labels_path)
        labels = np.empty((len(levels), *planes.shape[1:]), np.int32)
        for number, level in enumerate(levels):
            if not copy_labels(planes[FILE_LEVELS.index(level)], blocks[level], labels[number]):
                raise _changed(self.labels_path)
        return labels

    def embeddings(self, level: str) -> NDArray[np.floating]:
        """Return [R, D] embeddings of a level, mapped."""
        block = self.blocks()[level]
        rows = _open_rows(self.embeddings_path)
        if block.stop > len(rows):
            raise _changed(self.embeddings_path)
        return rows[block]

    def blocks(self) -> dict[str, slice]:
        """Return level -> rows of its embeddings; both files are read and checked for them, once."""
        with self._lock:
            if not self._blocks:
                planes, rows = _open_planes(self.labels_path), _open_rows(self.embeddings_path)
                self._blocks.update(level_blocks(self.labels_path, planes, len(rows)))
            return self._blocks


def stem_of(name: str) -> str:
    """Return the name of an image without folders, cut at its first dot."""
    return Path(name).name.partition(".")[0]


def open_view(folder: Path, stem: str) -> LangSplatView:
    """Return a view whose files are there."""
    planes, rows = _open_planes(folder / f"{stem}_s.npy"), _open_rows(folder / f"{stem}_f.npy")
    height, width = planes.shape[1:]
    return LangSplatView(folder, stem, width, height, *rows.shape)


def _open_planes(path: Path) -> np.ndarray:
    """Return the labels [4, H, W] of a view, mapped."""
    planes = open_npy(path, "region labels")
    sides = planes.shape[1:]
    valid = planes.ndim == 3 and len(planes) == len(FILE_LEVELS)
    if not valid or not all(1 <= side <= MAX_IMAGE_SIDE for side in sides):
        problem = f"has shape {list(planes.shape)}, expected [4, height, width]"
        raise FileFormatError(path, problem, REMEDY)
    return planes


def _open_rows(path: Path) -> np.ndarray:
    """Return the embeddings [M, D] of a view, mapped; as ``_open_planes``."""
    rows = open_npy(path, "region embeddings")
    if rows.ndim != 2 or rows.dtype.kind != "f" or (len(rows) and not rows.shape[1]):
        problem = (
            f"has shape {list(rows.shape)} of {rows.dtype}, expected floating point [regions, dimensions]"
        )
        raise FileFormatError(path, problem, REMEDY)
    return rows


def _changed(path: Path) -> FileFormatError:
    return FileFormatError(path, "has changed since it was opened", "open the features again")
