"""Box suppression, and the mask rule of LangSplat, at full resolution.

Pixels covered by the same masks form one cell. An image has far fewer cells than pixels, and the intersections of all
pairs of masks are one sparse product over the cells: the same counts as in a loop over pairs.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scoup.extract.masks import Masks


def keep_by_boxes(
    corners: NDArray[np.integer], scores: NDArray[np.floating], most_overlap: float
) -> NDArray[np.int64]:
    """Return the numbers of the boxes that greedy suppression keeps, best first.

    The best box stays, those whose IoU with it exceeds ``most_overlap`` go, and so on. Areas of boxes [N, 4] are
    (x1 - x0) (y1 - y0), as in torchvision.ops.nms; ties go to the lower number.
    """
    boxes = corners.astype(np.float32)
    x0, y0, x1, y1 = boxes.T
    areas = (x1 - x0) * (y1 - y0)
    waiting = np.argsort(-scores, kind="stable")
    chosen: list[int] = []
    while len(waiting):
        best, waiting = int(waiting[0]), waiting[1:]
        chosen.append(best)
        width = np.minimum(x1[best], x1[waiting]) - np.maximum(x0[best], x0[waiting])
        height = np.minimum(y1[best], y1[waiting]) - np.maximum(y0[best], y0[waiting])
        shared = width.clip(0) * height.clip(0)
        with np.errstate(invalid="ignore", divide="ignore"):  # NaN for two boxes without area: both stay
            overlap = shared / (areas[best] + areas[waiting] - shared)
        waiting = waiting[~(overlap > most_overlap)]
    return np.array(chosen, np.int64)


def intersections(masks: Masks) -> NDArray[np.int64]:
    """Return [N, N] pixels that two masks share; their areas on the diagonal."""
    from scipy import sparse

    count = len(masks)
    if not count:
        return np.zeros((0, 0), np.int64)
    areas = masks.areas()
    for seed in range(8):
        cells, weights = _cells(masks, seed)
        weighted = sparse.csr_array(cells.multiply(weights[None, :]))
        if np.array_equal(np.asarray(weighted.sum(1)).ravel(), areas):
            return np.asarray((weighted @ cells.T).todense())
    raise AssertionError("two cells of masks share a hash")  # eight hashes of 64 bits in a row


def keep_by_masks(
    masks: Masks,
    scores: NDArray[np.floating],
    most_overlap: float = 0.8,
    least_score: float = 0.7,
    inside: float = 0.85,
    covered: float = 0.5,
) -> NDArray[np.int64]:
    """Return the numbers of the masks that LangSplat's mask rule keeps, ascending: painting order stays.

    A mask goes if its IoU with a better one exceeds ``most_overlap``; if its score (stability times predicted IoU) is
    at most ``least_score``; or if at least ``inside`` of it lies in another mask of which it covers less than
    ``covered``, whichever is better. Masks that go still make others go; ties go to the lower number.
    """
    order = np.argsort(-scores, kind="stable")
    shared = intersections(masks)[np.ix_(order, order)].astype(np.float32)
    areas = np.diag(shared)
    with np.errstate(invalid="ignore", divide="ignore"):  # NaN of empty masks compares as false
        union = areas[:, None] + areas[None, :] - shared
        like_better = np.triu(shared / union > most_overlap, k=1).any(0)
        share = shared / areas[None, :]  # [i, j]: of mask j that lies in mask i
        covers = share.T  # [i, j]: of mask i that lies in mask j
        is_part = ((share >= inside) & (covers < covered)).any(0)
    keep = (scores[order] > least_score) & ~like_better & ~is_part
    return np.sort(order[keep])


def _cells(masks: Masks, seed: int) -> tuple[Any, NDArray[np.int64]]:
    """Return the cells in each mask [N, C] (sparse 0/1), and the pixels of each cell [C]."""
    from scipy import sparse

    height, width = masks.size
    keys = np.random.default_rng(seed).integers(1, 1 << 64, len(masks), dtype=np.uint64)
    hashes = np.zeros((height, width), np.uint64)
    for number in range(len(masks)):
        crop = hashes[masks.place(number)]
        crop ^= masks.crop(number) * keys[number]
    flat = hashes.ravel()
    # Neighbours mostly belong to one cell: only the first pixel of each run is sorted.
    starts = np.concatenate([[0], np.flatnonzero(flat[1:] != flat[:-1]) + 1])
    lengths = np.diff(np.append(starts, len(flat)))
    values, first, cell = np.unique(flat[starts], return_index=True, return_inverse=True)
    weights = np.bincount(cell.ravel(), weights=lengths, minlength=len(values)).astype(np.int64)
    rows, columns = np.divmod(starts[first], width)
    keep = values != 0  # not in any mask
    weights, rows, columns = weights[keep], rows[keep], columns[keep]
    order = np.argsort(rows, kind="stable")
    weights, rows, columns = weights[order], rows[order], columns[order]
    inside: list[NDArray[np.int64]] = []
    for number in range(len(masks)):
        x0, y0, x1, y1 = masks.boxes[number].tolist()
        low, high = np.searchsorted(rows, (y0, y1))
        near = low + np.flatnonzero((columns[low:high] >= x0) & (columns[low:high] < x1))
        inside.append(near[masks.crop(number)[rows[near] - y0, columns[near] - x0]])
    numbers = np.repeat(np.arange(len(masks)), [len(item) for item in inside])
    members = np.concatenate(inside) if inside else np.zeros(0, np.int64)
    ones = np.ones(len(members), np.int64)
    return sparse.csr_array((ones, (numbers, members)), shape=(len(masks), len(weights))), weights
