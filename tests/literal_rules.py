"""The rules of automatic masks and of LangSplat, written out one mask and one pair at a time, at full size.

Slow on purpose, and independent of ``scoup.extract``: the tests compare with it.
Sources: the protocol in docs/extract.md; SAM's automatic mask generator and LangSplat's preprocessing as published.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy import ndimage
from torch import Tensor


def overlap_of_boxes(one: Sequence[float], other: Sequence[float]) -> float:
    """Intersection over union; boxes are x0, y0, x1, y1 with areas (x1 - x0) (y1 - y0)."""
    width = max(0.0, min(one[2], other[2]) - max(one[0], other[0]))
    height = max(0.0, min(one[3], other[3]) - max(one[1], other[1]))
    shared = np.float32(width * height)
    whole = (one[2] - one[0]) * (one[3] - one[1]) + (other[2] - other[0]) * (other[3] - other[1])
    rest = np.float32(whole) - shared
    return float(shared / rest) if rest else math.nan


def box_suppression(boxes: Sequence[Sequence[float]], scores: Sequence[float], limit: float) -> list[int]:
    """Numbers kept, best first."""
    order = sorted(range(len(boxes)), key=lambda number: -scores[number])  # stable: ties to the lower number
    kept: list[int] = []
    for number in order:
        if not any(overlap_of_boxes(boxes[number], boxes[better]) > np.float32(limit) for better in kept):
            kept.append(number)
    return kept


def box_of(mask: np.ndarray) -> list[int]:
    """x0, y0, x1, y1 of the first and last pixels; zeros for an empty mask."""
    rows, columns = np.nonzero(mask)
    if not len(rows):
        return [0, 0, 0, 0]
    return [int(columns.min()), int(rows.min()), int(columns.max()), int(rows.max())]


def remove_small(mask: np.ndarray, least: int, holes: bool) -> tuple[np.ndarray, bool]:
    """Fill small holes, or remove small islands, of a mask [H, W] of the whole image; whether anything changed."""
    labels, count = ndimage.label(mask ^ holes, np.ones((3, 3)))  # pyright: ignore[reportGeneralTypeIssues]
    sizes = [int((labels == number).sum()) for number in range(1, count + 1)]
    small = [number for number in range(1, count + 1) if sizes[number - 1] < least]
    if not small:
        return mask, False
    if holes:
        return mask | np.isin(labels, small), True
    large = [number for number in range(1, count + 1) if number not in small]
    if not large:
        large = [1 + int(np.argmax(sizes))]
    return np.isin(labels, large), True


def clean_up(dense: Sequence[np.ndarray], least: int, limit: float) -> tuple[list[np.ndarray], list[int]]:
    """Small parts removed, boxes suppressed with the unchanged masks first: masks, and their old numbers."""
    cleaned: list[np.ndarray] = []
    unchanged: list[float] = []
    for mask in dense:
        filled, first = remove_small(mask, least, holes=True)
        result, second = remove_small(filled, least, holes=False)
        cleaned.append(result)
        unchanged.append(float(not first and not second))
    kept = box_suppression([box_of(mask) for mask in cleaned], unchanged, limit)
    return [cleaned[number] for number in kept], kept


def mask_rule(
    dense: Tensor,
    scores: Tensor,
    most_overlap: float = 0.8,
    least_score: float = 0.7,
    inside: float = 0.85,
    covered: float = 0.5,
) -> list[int]:
    """LangSplat's suppression of masks [N, H, W]: numbers kept, ascending."""
    order = torch.sort(scores, descending=True, stable=True).indices.tolist()
    areas = [dense[number].sum(dtype=torch.float) for number in order]
    dropped = [not bool(scores[number] > least_score) for number in order]
    for i in range(len(order)):
        for j in range(i + 1, len(order)):
            shared = torch.logical_and(dense[order[i]], dense[order[j]]).sum(dtype=torch.float)
            union = torch.logical_or(dense[order[i]], dense[order[j]]).sum(dtype=torch.float)
            if shared / union > most_overlap:
                dropped[j] = True
            if shared / areas[i] < covered and shared / areas[j] >= inside:
                dropped[j] = True
            if shared / areas[j] < covered and shared / areas[i] >= inside:
                dropped[i] = True
    return sorted(number for number, gone in zip(order, dropped, strict=True) if not gone)


def painted(dense: Sequence[np.ndarray], size: tuple[int, int]) -> np.ndarray:
    """[H, W] labels, later masks over earlier ones."""
    labels = np.full(size, -1, np.int32)
    for number, mask in enumerate(dense):
        labels[mask] = number
    return labels


def exact_crop_of(image: np.ndarray, mask: np.ndarray, side: int, cut_last: bool = True) -> np.ndarray:
    """[side, side, 3] float64: the rest black, cut to the box, squared, resized pixel by pixel as cv2.resize does."""
    black = image.copy()
    black[~mask] = 0
    x0, y0, x1, y1 = box_of(mask)
    last = 0 if cut_last else 1
    cut = black[y0 : max(y1 + last, y0 + 1), x0 : max(x1 + last, x0 + 1)]
    height, width = cut.shape[:2]
    length = max(height, width)
    square = np.zeros((length, length, 3), np.uint8)
    top, left = (length - height) // 2, (length - width) // 2
    square[top : top + height, left : left + width] = cut
    values = torch.from_numpy(square).permute(2, 0, 1)[None].double()
    large = torch.nn.functional.interpolate(values, (side, side), mode="bilinear", align_corners=False)
    return large[0].permute(1, 2, 0).numpy()


Answer = Callable[[np.ndarray, np.ndarray], tuple[Tensor, Tensor]]
"""(crop [h, w, 3], points [P, 2] in its pixels) -> logits [P, 3, h, w] and predicted IoU [P, 3]."""
Crop = tuple[int, int, int, int]
Item = tuple[np.ndarray, float, float, list[int]]
"""Mask, predicted IoU, stability, and box."""


@dataclass(frozen=True)
class Generator:
    """LangSplat's generator of masks, before its suppression of masks."""

    points_per_side: int
    batch: int
    layers: int
    iou_limit: float
    stability_limit: float
    offset: float
    box_limit: float
    crop_limit: float
    least: int
    crop_share: float

    def generate(self, image: np.ndarray, answer: Answer) -> dict[str, list[tuple[np.ndarray, float, float]]]:
        """Level -> (mask, predicted IoU, stability)."""
        height, width = image.shape[:2]
        crops = self.crops(height, width)
        lists: dict[str, list[tuple[np.ndarray, float, float, int]]] = {name: [] for name in ("s", "m", "l")}
        for crop in crops:
            x0, y0, x1, y1 = crop
            for level, items in self.candidates(image, crop, answer).items():
                for number in box_suppression([i[3] for i in items], [i[1] for i in items], self.box_limit):
                    mask, quality, stability, _ = items[number]
                    whole = np.zeros((height, width), bool)
                    whole[y0:y1, x0:x1] = mask
                    lists[level].append((whole, quality, stability, (x1 - x0) * (y1 - y0)))
        result = {}
        for level, items in lists.items():
            if len(crops) > 1:
                scores = [float(np.float32(1) / np.float32(item[3])) for item in items]
                kept = box_suppression([box_of(item[0]) for item in items], scores, self.crop_limit)
                items = [items[number] for number in kept]
            limit = max(self.box_limit, self.crop_limit)
            masks, kept = clean_up([item[0] for item in items], self.least, limit)
            result[level] = [(mask, items[n][1], items[n][2]) for mask, n in zip(masks, kept, strict=True)]
        return result

    def crops(self, height: int, width: int) -> list[Crop]:
        """The image, and four overlapping crops with one layer."""
        boxes = [(0, 0, width, height)]
        if self.layers:
            overlap = int(self.crop_share * min(height, width))
            wide, high = math.ceil((overlap + width) / 2), math.ceil((overlap + height) / 2)
            for x0 in (0, wide - overlap):
                for y0 in (0, high - overlap):
                    boxes.append((x0, y0, min(x0 + wide, width), min(y0 + high, height)))
        return boxes

    def candidates(self, image: np.ndarray, crop: Crop, answer: Answer) -> dict[str, list[Item]]:
        """Level -> what the points of one crop give, filtered one by one."""
        x0, y0, x1, y1 = crop
        places = [
            (
                (column + 0.5) / self.points_per_side * (x1 - x0),
                (row + 0.5) / self.points_per_side * (y1 - y0),
            )
            for row in range(self.points_per_side)
            for column in range(self.points_per_side)
        ]
        found: dict[str, list[Item]] = {name: [] for name in ("s", "m", "l")}
        for start in range(0, len(places), self.batch):
            logits, iou = answer(image[y0:y1, x0:x1], np.array(places[start : start + self.batch]))
            for point in range(len(logits)):
                for channel, level in enumerate(("s", "m", "l")):
                    item = self.judged(logits[point, channel], float(iou[point, channel]))
                    if item is not None and not cut_off(item[3], crop, image.shape[1], image.shape[0]):
                        found[level].append(item)
        return found

    def judged(self, values: Tensor, iou: float) -> Item | None:
        """One mask, if its quality and stability suffice."""
        if not iou > np.float32(self.iou_limit):
            return None
        low = (values > -self.offset).sum()
        stability = (values > self.offset).sum().float() / low.float()
        if not bool(stability >= self.stability_limit):
            return None
        mask = (values > 0).numpy()
        return mask, iou, float(stability), box_of(mask)


def cut_off(box: Sequence[int], crop: Sequence[int], width: int, height: int, near: float = 20) -> bool:
    """Whether a box within a crop ends near an edge of the crop that is no edge of the image."""
    place = [box[0] + crop[0], box[1] + crop[1], box[2] + crop[0], box[3] + crop[1]]
    edges = [0, 0, width, height]
    return any(
        abs(value - edge) <= near and not abs(value - outer) <= near
        for value, edge, outer in zip(place, crop, edges, strict=True)
    )
