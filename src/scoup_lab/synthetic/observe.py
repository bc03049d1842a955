"""Simulated observations: regions and embeddings of a segmenter and an image encoder, made from the true parts.

Regions. The truth at each level is cut into connected pieces, and all their borders are moved by smooth noise of one
to two pixels. Of the regions, 6 % are missing, 12 % grown or shrunk by some pixels, 4 % merged with a neighbour and
5 % split in two (15 % at the fine level). Small ones are dropped.

Embeddings. A region's embedding mixes the prototypes of what its pixels truly show, plus 2 to 16 % of what surrounds
it; at the fine level every part has an offset of its own. Noise is added: isotropic, and along differences of
prototypes (an encoder errs towards other things). Part of the noise belongs to the view, and all regions of an object
in that view share it. Small regions get more noise. 10 % of the regions carry the embedding of a neighbour.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy import ndimage

from scoup.scene import LEVELS, RegionMap, Regions
from scoup_lab.synthetic.art.meshes import Floats
from scoup_lab.synthetic.art.things import Parts
from scoup_lab.synthetic.masks import Mask, components, grown, shrunk
from scoup_lab.synthetic.words import Words, unit

REFERENCE_WIDTH = 480  # pixels in the constants below refer to an image this wide
SMALLEST = 45  # pixels
LEAST_KEPT = 12  # pixels: smaller regions are dropped
BORDER_NOISE = 1.3  # pixels, standard deviation of the displacement along each axis
BORDER_SMOOTHNESS = 7.0  # pixels
MISSING, RESIZED, MERGED = 0.06, 0.12, 0.04
SPLIT = {"s": 0.15, "m": 0.05, "l": 0.05}
SWAPPED = 0.10
SURROUNDINGS = (0.02, 0.16)
VIEW_NOISE = 0.16  # length of the noise that a thing's regions share in one view; a prototype has length 1
REGION_NOISE = 0.22
DIRECTED_NOISE = 0.18  # along differences of prototypes
PART_OFFSET = 0.2
SMALL_AREA = 500  # pixels: at this area the noise is half as strong again as on a large region

IntMap = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class Shown:
    """The ground truth of one view, and the parts of the embeddings of its regions."""

    truth: IntMap  # [H, W] numbers of names, -1 = nothing
    prototypes: Floats  # [names, D]
    offsets: Floats  # [names, D] added to the prototypes in every view
    shifts: Floats  # [names, D] noise of this view, which all regions of a name share


def observe(part_maps: Mapping[str, IntMap], parts: Parts, words: Words, rng: np.random.Generator) -> Regions:
    """Return region maps and embeddings of all views at three levels.

    ``part_maps``: true part number of each pixel, [H, W] int32, for each view name; -1 = nothing.
    """
    offsets = {
        level: noise(words.prototypes[level].shape, PART_OFFSET if level == "s" else 0.0, rng)
        for level in LEVELS
    }
    maps: dict[str, dict[str, RegionMap]] = {}
    for name, part_map in part_maps.items():
        maps[name] = {}
        moved = moved_borders(part_map, rng)
        for level in LEVELS:
            prototypes = words.prototypes[level]
            shifts = noise(prototypes.shape, VIEW_NOISE, rng)
            truth = parts.at_level(part_map, level).astype(np.int32)
            shown = Shown(truth, prototypes, offsets[level], shifts)
            labels = make_regions(parts.at_level(moved, level).astype(np.int32), level, rng)
            maps[name][level] = RegionMap(
                torch.from_numpy(labels),
                torch.from_numpy(embed_regions(labels, shown, rng).astype(np.float32)),
            )
    return Regions.from_maps(maps)


def make_regions(truth: IntMap, level: str, rng: np.random.Generator) -> IntMap:
    """Return a segmenter's map of one level: [H, W] int32 region numbers from 0, -1 where no mask lies.

    ``truth``: [H, W] numbers of names, borders already moved; -1 = nothing.
    """
    scale = truth.shape[1] / REFERENCE_WIDTH
    pieces = _pieces(truth, max(LEAST_KEPT, SMALLEST * scale**2))
    order = rng.permutation(len(pieces))
    fate = rng.random(len(pieces))
    labels = np.full(truth.shape, -1, np.int32)
    for number, (box, mask) in enumerate(pieces):
        labels[box][mask] = number
    boxes = [tuple(_padded(side, 8) for side in box) for box, _ in pieces]
    next_number = len(pieces)
    for number in order:
        window = labels[boxes[number]]  # shares memory with ``labels``
        mask = window == number
        bound = MISSING
        if fate[number] < bound:
            window[mask] = -1
            continue
        if fate[number] < (bound := bound + RESIZED):
            _resize(window, mask, number, scale, rng)
        elif fate[number] < (bound := bound + MERGED):
            neighbours = window[grown(mask, 2) & ~mask]
            neighbours = neighbours[neighbours >= 0]
            if len(neighbours):
                window[mask] = np.bincount(neighbours).argmax()
        elif fate[number] < bound + SPLIT[level]:
            rows, columns = np.nonzero(mask)
            turn = rng.uniform(0, np.pi)
            along = np.cos(turn) * columns + np.sin(turn) * rows
            beyond = along > np.quantile(along, rng.uniform(0.3, 0.7)) if len(along) else along > 0
            window[rows[beyond], columns[beyond]] = next_number
            next_number += 1
    return _renumbered(labels)


def moved_borders(part_map: IntMap, rng: np.random.Generator) -> IntMap:
    """Return the map [H, W] read at smoothly displaced positions."""
    scale = part_map.shape[1] / REFERENCE_WIDTH
    rows, columns = np.indices(part_map.shape)
    shifts = []
    for _ in range(2):
        field = ndimage.gaussian_filter(
            rng.normal(size=part_map.shape), BORDER_SMOOTHNESS * scale, mode="wrap"
        )
        shifts.append(field / max(field.std(), 1e-12) * BORDER_NOISE * scale)
    height, width = part_map.shape
    take_rows = np.rint(rows + shifts[0]).astype(int).clip(0, height - 1)
    take_columns = np.rint(columns + shifts[1]).astype(int).clip(0, width - 1)
    return part_map[take_rows, take_columns]


def _pieces(truth: IntMap, smallest: float) -> list[tuple[tuple[slice, ...], Mask]]:
    """Return the connected pieces of each name that have at least ``smallest`` pixels: window and mask in
    the window."""
    pieces = []
    for name, box in enumerate(ndimage.find_objects(truth + 1)):
        if box is None:
            continue
        numbers, count = components(truth[box] == name)
        sizes = np.bincount(numbers.ravel(), minlength=count + 1)
        pieces += [(box, numbers == piece) for piece in range(1, count + 1) if sizes[piece] >= smallest]
    return pieces


def _padded(side: slice, margin: int) -> slice:
    return slice(max(0, side.start - margin), side.stop + margin)


def _resize(labels: IntMap, mask: Mask, number: int, scale: float, rng: np.random.Generator) -> None:
    steps = min(7, max(1, round(rng.uniform(2, 5) * scale)))
    if rng.random() < 0.5:
        labels[grown(mask, steps)] = number
        return
    smaller = shrunk(mask, steps)
    if smaller.sum() >= LEAST_KEPT:
        labels[mask & ~smaller] = -1


def _renumbered(labels: IntMap) -> IntMap:
    """Return regions numbered from 0 without gaps; remains of a few pixels become no region."""
    sizes = np.bincount(labels[labels >= 0], minlength=1)
    large = sizes >= LEAST_KEPT
    numbers = np.where(large, np.cumsum(large) - 1, -1)
    return np.where(labels >= 0, numbers[labels], -1).astype(np.int32)


def embed_regions(
    labels: IntMap,
    shown: Shown,
    rng: np.random.Generator,
    noisiness: float | Floats = 1.0,
    swapped: float = SWAPPED,
) -> Floats:
    """Return [R, D] unit embeddings of the regions of one map [H, W]: regions from 0, -1 for none.

    ``noisiness`` scales the noise of the regions, of all alike or of each [R]; that of the view is in ``shown``. The
    share ``swapped`` carries the embedding of a neighbour.
    """
    count = int(labels.max()) + 1
    appearances = shown.prototypes + shown.offsets + shown.shifts
    dimensions = appearances.shape[1]
    mixture, clean = np.zeros((count, dimensions)), np.zeros((count, dimensions))
    neighbour = np.arange(count)
    boxes = ndimage.find_objects(labels + 1)
    areas = np.bincount(labels[labels >= 0], minlength=count)
    for number in range(count):
        rows, columns = boxes[number]
        window = _padded(rows, 6), _padded(columns, 6)
        mask = labels[window] == number
        around = grown(mask, 5) & ~mask
        inside = _share(shown.truth[window][mask], len(appearances))
        outside = _share(shown.truth[window][around], len(appearances))
        surroundings = rng.uniform(*SURROUNDINGS) if outside.any() else 0.0
        mixture[number] = ((1 - surroundings) * inside + surroundings * outside) @ appearances
        clean[number] = mixture[number]
        beside = labels[window][around]
        if (beside >= 0).any():
            neighbour[number] = np.bincount(beside[beside >= 0]).argmax()
    wrong = rng.random(count) < swapped
    mixture = unit(np.where(wrong[:, None], clean[neighbour], mixture))
    pixels = areas * (REFERENCE_WIDTH / labels.shape[1]) ** 2
    of_area = 1 + 0.5 * np.sqrt(SMALL_AREA / (pixels + SMALL_AREA / 4)).clip(max=1.6)
    strength = (noisiness * of_area)[:, None]
    isotropic = noise(mixture.shape, REGION_NOISE, rng)
    towards = (
        shown.prototypes[rng.integers(0, len(appearances), count)]
        - shown.prototypes[rng.integers(0, len(appearances), count)]
    )
    return unit(mixture + strength * (isotropic + DIRECTED_NOISE * rng.normal(size=(count, 1)) * towards))


def _share(numbers: IntMap, count: int) -> Floats:
    """Return [count] share of each name among ``numbers``; all zero where there is none."""
    counts = np.bincount(numbers[numbers >= 0], minlength=count).astype(float)
    return counts / max(counts.sum(), 1.0)


def noise(shape: tuple[int, ...], length: float, rng: np.random.Generator) -> Floats:
    """Return random rows of about the given length."""
    return rng.normal(size=shape) * (length / np.sqrt(shape[-1]))
