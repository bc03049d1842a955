"""Read LangSplat's region features: ``<stem>_s.npy`` (labels) and ``<stem>_f.npy`` (embeddings) per image."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scoup.base import FileFormatError, counted
from scoup.io.npy import open_npy
from scoup.io.reading import MAX_IMAGE_SIDE
from scoup.io.regions.views import REMEDY
from scoup.scene import LEVELS

ENDINGS = ("_s.npy", "_f.npy")
FILE_LEVELS = ("default", *LEVELS)  # order of the planes and of the row blocks


@dataclass(frozen=True, eq=False)
class LangSplatView:
    """A view: the headers of its two files. Arrays are read when they are needed; neither file is kept open."""

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


# ---- label planes: the embedding rows and the labels of each level


def level_blocks(path: Path, planes: np.ndarray, rows: int) -> dict[str, slice]:
    """Return the block of each level among ``rows`` embeddings, by the labels (global row numbers or -1) of ``planes``
    [4, H, W].

    Levels are consecutive blocks in the order of ``FILE_LEVELS``. Rows that no pixel names belong to the level before
    them.
    """
    starts: list[int] = []
    end = 0
    for name, plane in zip(FILE_LEVELS, planes, strict=True):
        used = _used_range(path, plane, name, rows)
        if used is None:
            starts.append(-1)
            continue
        if used[0] < end:
            raise FileFormatError(
                path,
                f"level {name!r} starts at row {used[0]}, inside the level before (up to row {end - 1})",
                "its values must be global row numbers, each level after the one before; " + REMEDY,
            )
        starts.append(used[0])
        end = used[1] + 1
    # Rows before the first pixel belong to "default"; an empty level has no rows, those after it decide.
    starts[0] = 0
    bounds = [*starts, rows]
    for position in range(len(starts) - 1, 0, -1):
        if bounds[position] < 0:
            bounds[position] = bounds[position + 1]
    return {name: slice(*block) for name, block in zip(FILE_LEVELS, pairwise(bounds), strict=True)}


def _used_range(path: Path, plane: np.ndarray, name: str, rows: int) -> tuple[int, int] | None:
    """Return the first and the last row that a plane names, None if it names none."""
    whole = np.asarray(plane)
    if plane.dtype.kind == "f":
        narrow = plane.dtype.itemsize <= 4  # beyond 32 bits such floats are refused by their size in any case
        with np.errstate(invalid="ignore"):
            whole = plane.astype(np.int32 if narrow else np.int64)
        if not np.array_equal(whole.astype(plane.dtype), plane):
            raise FileFormatError(path, f"level {name!r} has labels that are not whole numbers", REMEDY)
    low, high = int(whole.min()), int(whole.max())
    if low < -1 or high >= rows:
        embeddings = path.name.replace("_s.npy", "_f.npy")
        raise FileFormatError(
            path,
            f"level {name!r} has labels from {low} to {high}, but {embeddings} has {counted(rows, 'embedding')}",
            "the two files do not belong together; " + REMEDY,
        )
    return None if high < 0 else (_lowest(whole), high)


def copy_labels(plane: np.ndarray, block: slice, out: NDArray[np.int32]) -> bool:
    """Put a plane's labels, counted from the first row of their level's block, into ``out`` [H, W]; -1 stays. Return
    whether all lie within the block; if not, what is in ``out`` is of no use."""
    with np.errstate(invalid="ignore"):
        out[...] = plane
    if out.min() < -1 or out.max() >= block.stop or _lowest(out) < block.start:
        return False
    np.subtract(out, block.start, out=out)
    np.maximum(out, -1, out=out)
    return True


def _lowest(plane: np.ndarray) -> int:
    """Return the lowest label of 0 or more in a plane of integers; more than any label if there is none."""
    if plane.dtype.kind == "i":  # negative ones are the largest numbers without sign
        return int(plane.view(plane.dtype.str.replace("i", "u")).min())
    return int(plane.min())
