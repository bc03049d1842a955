"""Small holes of masks are filled, small islands removed.

Connected components are found among runs of equal pixels: a row of a mask has few runs, and one pass over the runs of
many masks finds the components of all of them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scoup.extract.masks import Masks
from scoup.extract.overlaps import keep_by_boxes

_CHUNK = 16 << 20  # pixels of boxes that are processed together


def without_small_parts(masks: Masks, least_area: int, most_overlap: float) -> Masks:
    """Fill holes and remove islands of fewer than ``least_area`` pixels, then suppress boxes again.

    As SAM's ``postprocess_small_regions``: pixels that touch at a corner belong together; a mask of small islands
    alone keeps the largest; in the suppression the unchanged masks go first, and the result is in that order.
    """
    changed: dict[int, NDArray[np.bool_]] = {}
    corner: dict[int, tuple[int, int]] = {}
    for numbers in _chunks(masks):
        padded = [_with_margin(masks, number, least_area) for number in numbers]
        parts = [part for part, _ in padded]
        touched = _fill_holes(parts, least_area) | _remove_islands(parts, least_area)
        for place in np.flatnonzero(touched).tolist():
            changed[numbers[place]], corner[numbers[place]] = padded[place]
    cleaned = masks.replace_masks(changed, corner)
    unchanged = np.ones(len(masks), np.float32)
    unchanged[list(changed)] = 0
    return cleaned.select(keep_by_boxes(cleaned.corners(), unchanged, most_overlap))


def _chunks(masks: Masks) -> Iterator[list[int]]:
    """Yield the numbers of the masks that are not empty, in chunks."""
    sides = (masks.boxes[:, 2:] - masks.boxes[:, :2]).astype(np.int64)
    chunk: list[int] = []
    pixels = 0
    for number, area in enumerate(sides.prod(1).tolist()):
        if not area:
            continue
        if chunk and pixels + area > _CHUNK:
            yield chunk
            chunk, pixels = [], 0
        chunk.append(number)
        pixels += area
    if chunk:
        yield chunk


def _with_margin(masks: Masks, number: int, least_area: int) -> tuple[NDArray[np.bool_], tuple[int, int]]:
    """Return a mask within a larger box, and the corner (x, y) of that box."""
    x0, y0, x1, y1 = masks.boxes[number].tolist()
    crop = masks.crop(number)
    # A strip of the margin has ``least_area`` pixels: a component that leaves the margin is large whatever lies beyond,
    # so that nothing outside matters.
    across, down = -(-least_area // crop.shape[0]), -(-least_area // crop.shape[1])
    left, right = min(x0, across), min(masks.size[1] - x1, across)
    top, bottom = min(y0, down), min(masks.size[0] - y1, down)
    whole = np.zeros((top + crop.shape[0] + bottom, left + crop.shape[1] + right), np.bool_)
    whole[top : top + crop.shape[0], left : left + crop.shape[1]] = crop
    return whole, (x0 - left, y0 - top)


def _fill_holes(parts: list[NDArray[np.bool_]], least_area: int) -> NDArray[np.bool_]:
    """Fill in place; return [N] which masks changed."""
    runs = _runs_of([~part for part in parts])
    small = runs.sizes < least_area
    return _write(parts, runs, small[runs.labels], True)


def _remove_islands(parts: list[NDArray[np.bool_]], least_area: int) -> NDArray[np.bool_]:
    """Remove in place; return [N] which masks have small islands, one that stays alone included."""
    runs = _runs_of(parts)
    small = runs.sizes < least_area
    # [islands], the mask of each island
    owner = np.zeros(len(runs.sizes), np.int64)
    owner[runs.labels] = runs.masks
    needed = np.bincount(owner, weights=small, minlength=len(parts)) > 0
    large = np.bincount(owner, weights=~small, minlength=len(parts)) > 0
    for number in np.flatnonzero(needed & ~large).tolist():
        own = np.flatnonzero(owner == number)
        small[own[runs.sizes[own].argmax()]] = False
    _write(parts, runs, small[runs.labels], False)
    return needed


@dataclass(frozen=True, eq=False)
class _Runs:
    """Runs of true pixels of several arrays, in order of array, row and column."""

    masks: NDArray[np.int64]  # [R] which array
    rows: NDArray[np.int64]  # [R]
    starts: NDArray[np.int64]  # [R] first column
    stops: NDArray[np.int64]  # [R] one past the last column
    labels: NDArray[np.int64]  # [R] component, numbered over all arrays in order of their first runs
    sizes: NDArray[np.int64]  # [P] pixels of each component


def _runs_of(parts: list[NDArray[np.bool_]]) -> _Runs:
    from scipy import sparse
    from scipy.sparse import csgraph

    found: list[NDArray[np.int64]] = []
    offset = 0
    for number, part in enumerate(parts):
        height, width = part.shape
        # A false pixel before and after each row: values change twice for each run.
        framed = np.zeros((height, width + 2), np.bool_)
        framed[:, 1:-1] = part
        flat = framed.ravel()
        changes = np.flatnonzero(flat[1:] != flat[:-1])
        rows, starts = np.divmod(changes[0::2], width + 2)
        stops = changes[1::2] - rows * (width + 2)
        # Rows of different arrays are kept two apart, so that no run touches one of the next array.
        found.append(np.stack([np.full(len(rows), number), rows, starts, stops, rows + offset]))
        offset += height + 1
    masks, rows, starts, stops, lines = np.concatenate([np.zeros((5, 0), np.int64), *found], axis=1)
    wide = int(stops.max(initial=0)) + 2
    # The runs of the next row that touch a run, corners included, lie between two places of the sorted list.
    low = np.searchsorted(lines * wide + stops, (lines + 1) * wide + starts, "left")
    high = np.searchsorted(lines * wide + starts, (lines + 1) * wide + stops, "right")
    counts = (high - low).clip(0)
    first = np.repeat(np.arange(len(lines)), counts)
    second = np.arange(len(first)) + np.repeat(low - (counts.cumsum() - counts), counts)
    graph = sparse.csr_array((np.ones(len(first), np.int8), (first, second)), shape=(len(lines), len(lines)))
    count, labels = csgraph.connected_components(graph, directed=False)
    sizes = np.bincount(labels, weights=stops - starts, minlength=count).astype(np.int64)
    return _Runs(masks, rows, starts, stops, labels.astype(np.int64), sizes)


def _write(
    parts: list[NDArray[np.bool_]], runs: _Runs, chosen: NDArray[np.bool_], value: bool
) -> NDArray[np.bool_]:
    """Set the pixels of the chosen runs; return [N] which arrays changed."""
    touched = np.zeros(len(parts), np.bool_)
    numbers = np.flatnonzero(chosen)
    bounds = np.searchsorted(runs.masks[numbers], np.arange(len(parts) + 1))
    for mask in np.flatnonzero(np.diff(bounds)).tolist():
        own = numbers[bounds[mask] : bounds[mask + 1]]
        lengths = runs.stops[own] - runs.starts[own]
        begins = runs.rows[own] * parts[mask].shape[1] + runs.starts[own]
        steps = np.arange(lengths.sum()) - np.repeat(lengths.cumsum() - lengths, lengths)
        parts[mask].reshape(-1)[np.repeat(begins, lengths) + steps] = value
        touched[mask] = True
    return touched
