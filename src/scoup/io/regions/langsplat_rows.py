"""LangSplat's label planes: which embedding rows belong to which level, and labels by level."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scoup.base.counts import counted
from scoup.base.errors import FileFormatError
from scoup.io.regions.views import REMEDY
from scoup.scene.regions import LEVELS

FILE_LEVELS = ("default", *LEVELS)  # order of the planes and of the row blocks


def level_blocks(path: Path, planes: np.ndarray, rows: int) -> dict[str, slice]:
    """Return which of ``rows`` embeddings belong to which level, by the label values, global row numbers or -1, of
    ``planes`` [4, H, W].

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
    low, high, lowest = rows, -1, rows
    fractions = False
    for some in _strips(plane):
        whole = some
        if plane.dtype.kind == "f":
            whole = _whole_numbers(some)
            fractions |= not np.array_equal(whole.astype(plane.dtype), some)
        low, high = min(low, int(whole.min())), max(high, int(whole.max()))
        lowest = min(lowest, _lowest(whole))
    if fractions:
        raise FileFormatError(path, f"level {name!r} has labels that are not whole numbers", REMEDY)
    if low < -1 or high >= rows:
        embeddings = path.name.replace("_s.npy", "_f.npy")
        raise FileFormatError(
            path,
            f"level {name!r} has labels from {low} to {high}, but {embeddings} has {counted(rows, 'embedding')}",
            "the two files do not belong together; " + REMEDY,
        )
    return None if high < 0 else (lowest, high)


def _strips(plane: np.ndarray) -> Iterator[np.ndarray]:
    """Yield some rows of a plane at a time: few enough to stay in a cache."""
    rows = max(1, (1 << 16) // plane.shape[1])
    for start in range(0, len(plane), rows):
        yield np.asarray(plane[start : start + rows])


def copy_labels(plane: np.ndarray, block: slice, out: NDArray[np.int32]) -> bool:
    """Put a plane's labels, counted from the first row of their level's block, into ``out`` [H, W]; -1 stays. Return
    whether all lie within the block; if not, what is in ``out`` is of no use."""
    for some, to in zip(_strips(plane), _strips(out), strict=True):
        with np.errstate(invalid="ignore"):
            to[...] = some
        if to.min() < -1 or to.max() >= block.stop or _lowest(to) < block.start:
            return False
        np.subtract(to, block.start, out=to)
        np.maximum(to, -1, out=to)
    return True


def _whole_numbers(plane: np.ndarray) -> NDArray[np.signedinteger]:
    """Return a plane cut to integers; what does not fit becomes another number."""
    narrow = plane.dtype.itemsize <= 4  # beyond 32 bits such floats are refused by their size in any case
    with np.errstate(invalid="ignore"):
        return plane.astype(np.int32 if narrow else np.int64)


def _lowest(plane: np.ndarray) -> int:
    """Return the lowest label of 0 or more in a plane of integers; more than any label if there is none."""
    if plane.dtype.kind == "i":  # negative ones are the largest numbers without sign
        return int(plane.view(plane.dtype.str.replace("i", "u")).min())
    return int(plane.min())
