"""Candidate masks for ``benchmarks.extract``: as many and as large as SAM's, over a real photograph where there is one.

SAM's weights are not at hand, so the masks are made from Felzenszwalb's regions at several scales: each is taken as
it is, grown, shrunk, or joined with another, and gets pinholes and specks. Overlaps, nesting and near copies are thus
like those of a grid of points; the shapes are those of the photograph.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage

from scoup.extract.masks import Masks

_SCALES = ((60.0, 300), (200.0, 1500), (600.0, 6000), (1500.0, 30000))


def photograph_of(data: Path, height: int, width: int) -> tuple[NDArray[np.uint8], str]:
    """[H, W, 3] the first photograph of the desk, cut and enlarged; soft noise where there are no data. And which."""
    found = sorted((data / "desk" / "images_2").glob("*.jpg"))
    if not found:
        noise = ndimage.gaussian_filter(np.random.default_rng(0).random((height, width, 3)), (12, 12, 0))
        noise = (noise - noise.min()) / (noise.max() - noise.min())
        return (noise * 255).astype(np.uint8), "soft noise"
    with Image.open(found[0]) as stored:
        image = stored.convert("RGB")
    share = min(image.width / width, image.height / height)
    box = (0, 0, round(width * share), round(height * share))
    return np.asarray(image.crop(box).resize((width, height), Image.Resampling.BICUBIC)), "desk"


def regions_of(image: NDArray[np.uint8]) -> Masks:
    """Regions of all scales, as masks."""
    from skimage.segmentation import felzenszwalb

    parts = [
        Masks.from_labels(felzenszwalb(image, scale=scale, sigma=0.8, min_size=least).astype(np.int32))
        for scale, least in _SCALES
    ]
    return Masks.joined((image.shape[0], image.shape[1]), parts)


def candidates(regions: Masks, count: int, seed: int = 0) -> Masks:
    """``count`` masks, with predicted IoU and stability from 0.7 and 0.85 to 1."""
    rng = np.random.default_rng(seed)
    areas = regions.areas().astype(np.float64)
    chance = np.sqrt(areas) / np.sqrt(areas).sum()  # a point of the grid falls into large regions more often
    dense = np.zeros((1, *regions.size), bool)
    parts: list[Masks] = []
    for _ in range(count):
        dense[0] = False
        numbers = rng.choice(len(regions), 2, p=chance)
        dense[0][regions.place(numbers[0])] = regions.crop(numbers[0])
        if rng.random() < 0.15:
            dense[0][regions.place(numbers[1])] |= regions.crop(numbers[1])
        steps = int(rng.integers(-2, 4))
        if steps > 0:
            dense[0] = ndimage.binary_dilation(dense[0], iterations=steps)
        elif steps < 0:
            smaller = ndimage.binary_erosion(dense[0], iterations=-steps)
            dense[0] = smaller if smaller.any() else dense[0]
        if rng.random() < 0.5:
            rows, columns = np.nonzero(dense[0])
            some = rng.integers(0, len(rows), 5)
            dense[0][rows[some], columns[some]] = False
        if rng.random() < 0.3:
            dense[0, rng.integers(regions.size[0]), rng.integers(regions.size[1])] = True
        scores = [np.array([rng.uniform(low, 1)], np.float32) for low in (0.7, 0.85)]
        parts.append(Masks.from_dense(dense, *scores))
    return Masks.joined(regions.size, parts)
