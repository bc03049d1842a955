"""MobileSAM's real weights on a real photograph, against masks made with its authors' code and masks drawn by hand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import scoup
from scoup.extract import mask_settings, open_segmenter
from scoup.extract.masks import paint
from scoup.scene import LEVELS
from scoup_lab.data.labels import read_labels

NAME = "input_0001"


@pytest.fixture(scope="module")
def photograph(data_folder: Path) -> np.ndarray:
    path = data_folder / "desk" / "images_2" / f"{NAME}.jpg"
    if not path.is_file():
        pytest.skip(f"no real photograph at {path}")
    return np.asarray(Image.open(path).convert("RGB"))


@pytest.mark.data
def test_masks_are_those_of_the_authors_code(photograph, mobile_sam: Path, data_folder: Path) -> None:
    """The regions beside the photographs come from their encoder and decoder, 20 x 20 points and all of them."""
    settings = replace(mask_settings("fast", points_per_side=20), by_need=False)
    found = open_segmenter(str(mobile_sam), settings).segment(photograph)
    cameras = scoup.load_cameras(data_folder / "desk")
    kept = scoup.load_regions(data_folder / "desk" / "language_features", cameras)
    view = next(camera.name for camera in cameras if NAME in camera.name)
    for level in LEVELS:
        labels = kept.load(view, level).labels.numpy()
        painted = paint(found[level])
        both = (labels >= 0) & (painted >= 0)
        assert ((labels >= 0) == (painted >= 0)).mean() > 0.97, level
        # Regions of equal pixels pair off: the commonest partner of a region takes most of it.
        table = np.zeros((labels.max() + 1, painted.max() + 1), np.int64)
        np.add.at(table, (labels[both], painted[both]), 1)
        assert table.max(1).sum() / both.sum() > 0.97, level


@pytest.mark.data
def test_things_have_regions(photograph, mobile_sam: Path, data_folder: Path) -> None:
    """With the preset for machines without a GPU."""
    found = open_segmenter(str(mobile_sam), mask_settings("fast")).segment(photograph)
    counts = {level: len(found[level]) for level in LEVELS}
    assert 40 < counts["s"] < 140
    assert 10 < counts["l"] < counts["m"] < counts["s"]
    frame = next(frame for frame in read_labels(data_folder / "desk" / "label") if frame.name == NAME)
    best = []
    for truth in frame.masks.values():
        thing = truth.numpy()
        overlaps = []
        for level in LEVELS:
            masks = found[level].dense()
            shared = (masks & thing).sum((1, 2))
            overlaps.append((shared / (masks.sum((1, 2)) + thing.sum() - shared)).max())
        best.append(max(overlaps))
    assert np.mean(np.array(best) > 0.5) > 0.85
    assert np.mean(best) > 0.75
