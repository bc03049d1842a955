"""Masks over one image, each stored as the packed bits of its bounding box."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scoup.base import InputError


@dataclass(frozen=True, eq=False)
class Masks:
    """N masks over an image of H x W pixels. Memory is proportional to the boxes, not the image."""

    size: tuple[int, int]
    """(H, W)."""
    boxes: NDArray[np.int32]
    """[N, 4] x0, y0, x1, y1 in pixels; x1 and y1 one past the last. An empty mask has zeros."""
    bits: tuple[NDArray[np.uint8], ...]
    """N arrays, ``numpy.packbits`` of the mask within its box, row by row."""
    predicted_iou: NDArray[np.float32]
    """[N] the model's own estimate of a mask's quality; 1 where unknown."""
    stability: NDArray[np.float32]
    """[N] how little a mask depends on the threshold; 1 where unknown."""

    @classmethod
    def from_dense(
        cls,
        dense: NDArray[np.bool_],
        predicted_iou: NDArray[np.float32] | None = None,
        stability: NDArray[np.float32] | None = None,
    ) -> Masks:
        """Return the masks of an array [N, H, W]."""
        crops = [_crop_to_box(mask) for mask in dense]
        ones = np.ones(len(dense), np.float32)
        return cls(
            (int(dense.shape[1]), int(dense.shape[2])),
            np.array([box for box, _ in crops], np.int32).reshape(-1, 4),
            tuple(np.packbits(crop) for _, crop in crops),
            ones if predicted_iou is None else predicted_iou.astype(np.float32),
            ones if stability is None else stability.astype(np.float32),
        )

    @classmethod
    def from_labels(cls, labels: NDArray[np.integer]) -> Masks:
        """Return a mask for each value from 0 to the maximum of labels [H, W], in order; -1 is not a mask."""
        from scipy import ndimage

        boxes: list[tuple[int, int, int, int]] = []
        bits: list[NDArray[np.uint8]] = []
        for value, slices in enumerate(ndimage.find_objects(labels + 1)):
            if slices is None:
                boxes.append((0, 0, 0, 0))
                bits.append(np.zeros(0, np.uint8))
                continue
            rows, columns = slices
            boxes.append((columns.start, rows.start, columns.stop, rows.stop))
            bits.append(np.packbits(labels[slices] == value))
        ones = np.ones(len(bits), np.float32)
        table = np.array(boxes, np.int32).reshape(-1, 4)
        return cls((labels.shape[0], labels.shape[1]), table, tuple(bits), ones, ones)

    @classmethod
    def concatenate(cls, size: tuple[int, int], parts: Sequence[Masks]) -> Masks:
        """Return all masks of ``parts``, one after another."""
        if any(masks.size != size for masks in parts):
            sizes = sorted({masks.size for masks in parts})
            raise InputError(f"masks over images of {sizes} cannot be concatenated; use masks over one image")
        empty = np.zeros(0, np.float32)
        return cls(
            size,
            np.concatenate([np.zeros((0, 4), np.int32), *(masks.boxes for masks in parts)]),
            tuple(bits for masks in parts for bits in masks.bits),
            np.concatenate([empty, *(masks.predicted_iou for masks in parts)]),
            np.concatenate([empty, *(masks.stability for masks in parts)]),
        )

    def __len__(self) -> int:
        return len(self.bits)

    def crop(self, number: int) -> NDArray[np.bool_]:
        """Return [h, w] a mask within its box."""
        x0, y0, x1, y1 = self.boxes[number].tolist()
        height, width = y1 - y0, x1 - x0
        return np.unpackbits(self.bits[number], count=height * width).view(np.bool_).reshape(height, width)

    def place(self, number: int) -> tuple[slice, slice]:
        """Return rows and columns of a mask's box."""
        x0, y0, x1, y1 = self.boxes[number].tolist()
        return slice(y0, y1), slice(x0, x1)

    def dense(self) -> NDArray[np.bool_]:
        """Return [N, H, W] bool."""
        result = np.zeros((len(self), *self.size), np.bool_)
        for number in range(len(self)):
            result[number][self.place(number)] = self.crop(number)
        return result

    def areas(self) -> NDArray[np.int64]:
        """Return [N] pixels of each mask."""
        return np.array([np.count_nonzero(np.unpackbits(bits)) for bits in self.bits], np.int64)

    def corners(self) -> NDArray[np.int32]:
        """Return [N, 4] x0, y0, x1, y1 with the last column and row themselves, as SAM's code writes boxes."""
        filled = self.boxes[:, 2:] > self.boxes[:, :2]
        return np.concatenate([self.boxes[:, :2], self.boxes[:, 2:] - filled], axis=1)

    def select(self, chosen: NDArray[np.integer] | NDArray[np.bool_] | Iterable[int]) -> Masks:
        """Return the chosen masks: by numbers, in their order, or by a boolean [N]."""
        numbers = np.asarray(chosen if isinstance(chosen, np.ndarray) else list(chosen))
        if numbers.dtype == np.bool_:
            numbers = np.flatnonzero(numbers)
        numbers = numbers.astype(np.int64)
        return Masks(
            self.size,
            self.boxes[numbers],
            tuple(self.bits[number] for number in numbers.tolist()),
            self.predicted_iou[numbers],
            self.stability[numbers],
        )

    def translate(self, x: int, y: int, size: tuple[int, int]) -> Masks:
        """Return the masks in a larger image of ``size``, with the corner of their own image at (x, y)."""
        filled = (self.boxes[:, 2:3] > self.boxes[:, :1]).astype(np.int32)
        shift = np.array([x, y, x, y], np.int32)
        return replace(self, size=size, boxes=self.boxes + shift * filled)

    def replace_masks(
        self, number_to_mask: dict[int, NDArray[np.bool_]], corner: dict[int, tuple[int, int]]
    ) -> Masks:
        """Replace some masks: number -> [h, w], and number -> (x, y) of that array's corner."""
        boxes, bits = self.boxes.copy(), list(self.bits)
        for number, mask in number_to_mask.items():
            box, crop = _crop_to_box(mask)
            x, y = corner[number]
            boxes[number] = np.array(box, np.int32) + np.array([x, y, x, y], np.int32) * bool(crop.size)
            bits[number] = np.packbits(crop)
        return replace(self, boxes=boxes, bits=tuple(bits))


def paint(masks: Masks) -> NDArray[np.int32]:
    """Return [H, W] labels: the number of the last mask that covers a pixel, -1 for none."""
    labels = np.full(masks.size, -1, np.int32)
    for number in range(len(masks)):
        labels[masks.place(number)][masks.crop(number)] = number
    return labels


def _crop_to_box(mask: NDArray[np.bool_]) -> tuple[tuple[int, int, int, int], NDArray[np.bool_]]:
    rows = np.flatnonzero(mask.any(1))
    if not len(rows):
        return (0, 0, 0, 0), mask[:0, :0]
    y0, y1 = int(rows[0]), int(rows[-1]) + 1
    columns = np.flatnonzero(mask[y0:y1].any(0))
    x0, x1 = int(columns[0]), int(columns[-1]) + 1
    return (x0, y0, x1, y1), mask[y0:y1, x0:x1]
