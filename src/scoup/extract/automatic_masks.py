"""Automatic masks: predictions for grids of points, filtered by the rules of SAM and LangSplat."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from scoup.extract import constants
from scoup.extract.masks import Masks
from scoup.extract.overlaps import keep_by_boxes, keep_by_masks
from scoup.extract.settings import MaskSettings
from scoup.models import EncodedImage, PointModel
from scoup.scene import LEVELS

_COARSEST = 8  # rows and columns between the first points
Box = tuple[int, int, int, int]  # x0, y0, x1, y1 in pixels, x1 and y1 one past the last

CHUNK_BYTES = 128 << 20  # of logits at the size of the image in memory at once


@dataclass(frozen=True, eq=False)
class Candidates:
    """Masks over a crop that passed the filters of one mask at a time, in the order of the points."""

    masks: Masks
    channels: NDArray[np.int64]  # [N], 0, 1, 2 for the masks s, m, l of a point

    def select(self, chosen: NDArray[np.integer] | NDArray[np.bool_]) -> Candidates:
        return Candidates(self.masks.select(chosen), self.channels[chosen])


@dataclass(frozen=True, eq=False)
class _Coarse:
    """Low-resolution ``Candidates`` of a batch of points."""

    logits: Tensor  # [N, h, w]
    iou: Tensor  # [N]
    stability: Tensor
    channels: Tensor
    smallest: Tensor  # [N] of the masks of its point


class SamSegmenter:
    """A segmenter over a model that predicts masks from points."""

    def __init__(self, model: PointModel, settings: MaskSettings) -> None:
        self.model = model
        self.settings = settings
        self.cut_last, self.drop_hidden = settings.cut_last, settings.drop_hidden

    def to_dict(self) -> dict[str, Any]:
        return {**self.model.to_dict(), **self.settings.to_dict()}

    def segment(self, image: NDArray[np.uint8]) -> dict[str, Masks]:
        return automatic_masks(image, self.model, self.settings)


def automatic_masks(image: NDArray[np.uint8], model: PointModel, settings: MaskSettings) -> dict[str, Masks]:
    """Return level -> masks of an image [H, W, 3], in painting order, by the rules of docs/extract.md."""
    size = (image.shape[0], image.shape[1])
    boxes = crop_boxes(*size, settings.crop_layers, settings.crop_share)
    by_level: dict[str, list[Masks]] = {name: [] for name in LEVELS}
    for box in boxes:
        candidates = _candidates(image, box, model, settings)
        for channel, name in enumerate(LEVELS):
            masks = candidates.masks.select(candidates.channels == channel)
            keep = keep_by_boxes(masks.corners(), masks.predicted_iou, settings.box_overlap)
            by_level[name].append(masks.select(keep).translate(box[0], box[1], size))
    return {name: _suppress(parts, boxes, size, settings) for name, parts in by_level.items()}


def _suppress(parts: list[Masks], boxes: list[Box], size: tuple[int, int], settings: MaskSettings) -> Masks:
    """Apply the rules over all crops: duplicates between crops, small parts, and the mask rule."""
    masks = Masks.concatenate(size, parts)
    if len(boxes) > 1:
        # Masks from smaller crops are preferred.
        areas = [
            np.full(len(crop), (b[2] - b[0]) * (b[3] - b[1])) for crop, b in zip(parts, boxes, strict=True)
        ]
        scores = 1.0 / np.concatenate(areas).astype(np.float32)
        masks = masks.select(keep_by_boxes(masks.corners(), scores, settings.crop_overlap))
    if settings.least_area > 0:
        overlap = max(settings.box_overlap, settings.crop_overlap)
        masks = without_small_parts(masks, settings.least_area, overlap)
    scores = masks.stability.astype(np.float64) * masks.predicted_iou.astype(np.float64)
    rule = (settings.mask_overlap, settings.least_score, settings.inside, settings.covered)
    return masks.select(keep_by_masks(masks, scores, *rule))


def _candidates(image: NDArray[np.uint8], box: Box, model: PointModel, settings: MaskSettings) -> Candidates:
    """Return the masks of one crop of the image, in pixels of the crop."""
    x0, y0, x1, y1 = box
    encoded = model.encode(np.ascontiguousarray(image[y0:y1, x0:x1]))
    crop_size, image_size = (y1 - y0, x1 - x0), (image.shape[0], image.shape[1])
    parts: list[Candidates] = []
    coarse: list[_Coarse] = []
    for batch in _batches(encoded, coarse, settings):
        logits, iou = encoded.predict(batch * torch.tensor([x1 - x0, y1 - y0]))
        channels = torch.arange(logits.shape[1], device=iou.device).repeat(len(batch))
        logits, iou = logits.flatten(0, 1), iou.flatten()
        good = torch.nonzero(iou > settings.predicted_iou)[:, 0]
        if settings.coarse_filters:
            stable = _stability(encoded.without_padding(logits[good]), settings)
            mask = stable >= settings.stability
            good = good[mask]
            point = good // len(LEVELS)
            smallest = point != torch.cat([point[:1] - 1, point[:-1]])
            coarse.append(_Coarse(logits[good].half(), iou[good], stable[mask], channels[good], smallest))
        else:
            parts += _upscaled(encoded, logits, iou, channels, good, settings, crop_size)
    if settings.coarse_filters:
        parts = _from_coarse(encoded, coarse, settings, crop_size)
    masks = Masks.concatenate(crop_size, [crop.masks for crop in parts])
    channels = np.concatenate([np.zeros(0, np.int64), *(crop.channels for crop in parts)])
    return Candidates(masks, channels).select(~touches_inner_edge(masks.corners(), box, *image_size))


def _batches(encoded: EncodedImage, coarse: list[_Coarse], settings: MaskSettings) -> Iterator[Tensor]:
    """Yield points [P, 2] in 0..1 to predict at a time; ``coarse`` has the results of earlier points.

    By need, the grid is asked from coarse to fine: whether a point is left out is decided before its round and does
    not depend on the batches.
    """
    grid = point_grid(settings.points_per_side)
    if not settings.by_need:
        yield from torch.from_numpy(grid).split(settings.points_per_batch)
        return
    rounds = coarse_to_fine(settings.points_per_side)
    for chosen in rounds:
        needed = torch.from_numpy(grid[chosen])
        needed = needed[~_known(needed, encoded, coarse, last=chosen is rounds[-1])]
        yield from needed.split(settings.points_per_batch) if len(needed) else ()


def _known(points: Tensor, encoded: EncodedImage, coarse: list[_Coarse], last: bool) -> Tensor:
    """Return [P] whether points lie in a mask of level s found so far; in the last round, also whether they lie in many
    larger masks of points without one: such ground, textured for instance, would be asked at every point."""
    small, large = torch.zeros(2, len(points), dtype=torch.int64)
    for batch in coarse:
        logits = encoded.without_padding(batch.logits[batch.smallest])
        rows, columns = (points.flip(1) * torch.tensor(logits.shape[1:])).long().to(logits.device).unbind(1)
        inside = (logits[:, rows, columns] > 0).cpu()
        is_small = (batch.channels[batch.smallest] == 0).cpu()
        small += inside[is_small].sum(0)
        large += inside[~is_small].sum(0)
    return (small > 0) | (large >= constants.MANY) & last


def _upscaled(
    encoded: EncodedImage,
    logits: Tensor,
    iou: Tensor,
    channels: Tensor,
    numbers: Tensor,
    settings: MaskSettings,
    size: tuple[int, int],
    stability: Tensor | None = None,
) -> list[Candidates]:
    """Upscale masks to the size of the crop, a few at a time; stability is computed there unless passed."""
    result: list[Candidates] = []
    for chunk in numbers.split(max(1, CHUNK_BYTES // (4 * size[0] * size[1]))):
        large = encoded.upscale(logits[chunk].float())
        if stability is None:
            stable = _stability(large, settings)
            mask = stable >= settings.stability
            large, stable, chunk = large[mask], stable[mask], chunk[mask]
        else:
            stable = stability[chunk]
        dense = (large > 0).cpu().numpy()
        masks = Masks.from_dense(dense, iou[chunk].cpu().numpy(), stable.cpu().numpy())
        result.append(Candidates(masks, channels[chunk].cpu().numpy()))
    return result


def _from_coarse(
    encoded: EncodedImage, batches: list[_Coarse], settings: MaskSettings, size: tuple[int, int]
) -> list[Candidates]:
    """Suppress boxes among the low-resolution masks of each channel, and upscale the rest."""
    logits, iou, stability, channels = (
        torch.cat([getattr(batch, name) for batch in batches])
        for name in ("logits", "iou", "stability", "channels")
    )
    small = [
        Masks.from_dense((chunk > 0).cpu().numpy()) for chunk in encoded.without_padding(logits).split(256)
    ]
    if not small:
        return []
    corners = np.concatenate([masks.corners() for masks in small])
    survivors: list[NDArray[np.int64]] = []
    for channel in range(len(LEVELS)):
        numbers = torch.nonzero(channels == channel)[:, 0].cpu().numpy()
        scores = iou.cpu().numpy()[numbers]
        survivors.append(numbers[keep_by_boxes(corners[numbers], scores, settings.box_overlap)])
    chosen = torch.from_numpy(np.sort(np.concatenate(survivors))).to(logits.device)
    return _upscaled(encoded, logits, iou, channels, chosen, settings, size, stability)


def _stability(logits: Tensor, settings: MaskSettings) -> Tensor:
    """Return [N] float32 area above +offset over area above -offset; NaN for an empty mask."""
    high = (logits > settings.stability_offset).sum((-2, -1), dtype=torch.int32)
    low = (logits > -settings.stability_offset).sum((-2, -1), dtype=torch.int32)
    return high / low


def point_grid(points_per_side: int) -> NDArray[np.float64]:
    """Return [n^2, 2] x, y in 0..1: the centres of n x n equal cells, row by row."""
    line = (np.arange(points_per_side) + 0.5) / points_per_side
    return np.stack([np.tile(line, points_per_side), np.repeat(line, points_per_side)], axis=1)


def coarse_to_fine(points_per_side: int) -> list[NDArray[np.bool_]]:
    """Return masks [n^2] of the grid's points by round: every eighth row and column, then the points in the middle of
    four, then the points in the middle of the sides between, and so on; a round may be empty."""
    y, x = np.indices((points_per_side, points_per_side)) - (_COARSEST // 2 - 1)
    step = np.gcd(np.gcd(y, x), _COARSEST)
    middle = (y // step % 2 == 1) & (x // step % 2 == 1) & (step < _COARSEST)
    rounds = (2 * np.log2(_COARSEST // step).astype(np.int64) - middle).ravel()
    return [rounds == number for number in range(2 * int(np.log2(_COARSEST)) + 1)]


def crop_boxes(height: int, width: int, layers: int, share: float) -> list[Box]:
    """Return the image itself, then 2^n x 2^n overlapping crops for each further layer n, as in SAM's code.

    Neighbours overlap by ``share`` of the shorter side in the first layer, by half of it in each next.
    """
    boxes: list[Box] = [(0, 0, width, height)]
    for layer in range(1, layers + 1):
        a_side = 2**layer
        overlap = int(share * min(height, width) * (2 / a_side))
        wide, high = (math.ceil((overlap * (a_side - 1) + length) / a_side) for length in (width, height))
        for column, row in product(range(a_side), repeat=2):
            x0, y0 = (wide - overlap) * column, (high - overlap) * row
            boxes.append((x0, y0, min(x0 + wide, width), min(y0 + high, height)))
    return boxes


def touches_inner_edge(
    corners: NDArray[np.integer], crop: Box, height: int, width: int, near: float = 20.0
) -> NDArray[np.bool_]:
    """Return [N] whether boxes [N, 4] within a crop end within ``near`` pixels of an edge of the crop that is not an
    edge of the image: they are cut off there."""
    boxes = corners + np.array([crop[0], crop[1], crop[0], crop[1]])
    near_crop = np.abs(boxes - np.array(crop)) <= near
    near_image = np.abs(boxes - np.array([0, 0, width, height])) <= near
    return np.asarray((near_crop & ~near_image).any(1), np.bool_)


def without_small_parts(masks: Masks, least_area: int, most_overlap: float) -> Masks:
    """Fill holes and remove islands of fewer than ``least_area`` pixels, then suppress boxes again.

    As SAM's ``postprocess_small_regions``: pixels that touch at a corner belong together; a mask of small islands
    alone keeps the largest; in the suppression the unchanged masks go first, and the result is in that order.
    """
    changed: dict[int, NDArray[np.bool_]] = {}
    corner: dict[int, tuple[int, int]] = {}
    for number in np.flatnonzero(masks.boxes[:, 2] > masks.boxes[:, 0]).tolist():
        mask, offset = _with_margin(masks, number, least_area)
        filled, removed = _fill_holes(mask, least_area), _remove_islands(mask, least_area)
        if filled or removed:
            changed[number], corner[number] = mask, offset
    cleaned = masks.replace_masks(changed, corner)
    unchanged = np.ones(len(masks), np.float32)
    unchanged[list(changed)] = 0
    return cleaned.select(keep_by_boxes(cleaned.corners(), unchanged, most_overlap))


def _with_margin(masks: Masks, number: int, least_area: int) -> tuple[NDArray[np.bool_], tuple[int, int]]:
    """Return a mask within a larger box, and the corner (x, y) of that box."""
    x0, y0, x1, y1 = masks.boxes[number].tolist()
    crop = masks.crop(number)
    # A strip of the margin has ``least_area`` pixels: a component that leaves the margin is large whatever lies beyond,
    # so that nothing outside matters.
    across, down = -(-least_area // crop.shape[0]), -(-least_area // crop.shape[1])
    left, right = min(x0, across), min(masks.size[1] - x1, across)
    top, bottom = min(y0, down), min(masks.size[0] - y1, down)
    return np.pad(crop, ((top, bottom), (left, right))), (x0 - left, y0 - top)


def _fill_holes(mask: NDArray[np.bool_], least_area: int) -> bool:
    """Fill in place; return whether there were small holes."""
    holes, small = _parts(~mask, least_area)
    mask |= small[holes]
    return bool(small.any())


def _remove_islands(mask: NDArray[np.bool_], least_area: int) -> bool:
    """Remove in place; return whether there were small islands, one that stays alone included."""
    islands, small = _parts(mask, least_area)
    any_small = bool(small.any())
    if small[1:].all():
        small[1 + np.bincount(islands[mask])[1:].argmax()] = False
    mask &= ~small[islands]
    return any_small


def _parts(pixels: NDArray[np.bool_], least_area: int) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
    """Return the connected component of each pixel, from 1, 0 for false ones, and which components are small; 0 is
    not."""
    from scipy import ndimage

    labels = np.zeros(pixels.shape, np.int32)
    ndimage.label(pixels, np.ones((3, 3)), output=labels)
    small = np.bincount(labels.ravel()) < least_area
    small[0] = False
    return labels, small
