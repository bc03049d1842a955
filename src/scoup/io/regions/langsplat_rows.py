"""LangSplat's label planes: the embedding rows and the labels of each level."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scoup.base import FileFormatError, counted
from scoup.io.regions.views import REMEDY
from scoup.scene import LEVELS

FILE_LEVELS = ("default", *LEVELS)  # order of the planes and of the row blocks


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
