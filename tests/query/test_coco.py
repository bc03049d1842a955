"""COCO's JSON, read by its own library."""

from __future__ import annotations

import contextlib
import io
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scoup.base import OutputExistsError
from scoup.query.coco import CocoAnnotations, run_lengths

mask_tools = pytest.importorskip("pycocotools.mask", reason="pycocotools is the oracle")


@given(st.integers(1, 40), st.integers(1, 40), st.floats(0, 1), st.integers(0, 2**31))
def test_run_lengths_equal_cocos(height: int, width: int, share: float, seed: int) -> None:
    mask = np.random.default_rng(seed).random((height, width)) < share
    expected = mask_tools.encode(np.asfortranarray(mask.astype(np.uint8)))
    assert run_lengths(mask) == expected["counts"].decode()


@pytest.mark.parametrize("side", [700, 70_000])
def test_long_runs(side: int) -> None:
    mask = np.zeros((side, 3), bool)
    mask[5:, 1] = True
    expected = mask_tools.encode(np.asfortranarray(mask.astype(np.uint8)))
    assert run_lengths(mask) == expected["counts"].decode()


def test_files_are_read_by_cocos_library(tmp_path: Path) -> None:
    from pycocotools.coco import COCO

    masks = np.random.default_rng(0).random((2, 3, 20, 30)) < 0.3
    masks[1, 2] = False
    written = CocoAnnotations(("mug", "kettle", "table"))
    for number, of_view in enumerate(masks):
        written.add(f"view_{number}.png", list(of_view), [0.5, 0.75, 0.25] if number else None)
    written.write(tmp_path / "coco.json")
    with contextlib.redirect_stdout(io.StringIO()):
        read = COCO(str(tmp_path / "coco.json"))
    assert [image["file_name"] for image in read.loadImgs([1, 2])] == ["view_0.png", "view_1.png"]
    assert {one["id"]: one["name"] for one in read.loadCats([1, 2, 3])} == {1: "mug", 2: "kettle", 3: "table"}
    assert len(read.getAnnIds()) == 5
    for entry in read.loadAnns(read.getAnnIds()):
        mask = masks[entry["image_id"] - 1, entry["category_id"] - 1]
        assert np.array_equal(read.annToMask(entry).astype(bool), mask)
        assert entry["area"] == mask.sum()
        assert entry["bbox"] == mask_tools.toBbox(entry["segmentation"]).tolist()
        expected = {1: 0.5, 2: 0.75}[entry["category_id"]] if entry["image_id"] == 2 else None
        assert entry.get("score") == expected
    with pytest.raises(OutputExistsError):
        written.write(tmp_path / "coco.json")


def test_an_empty_set_is_a_file(tmp_path: Path) -> None:
    written = CocoAnnotations(("mug",))
    written.add("a.png", [np.zeros((2, 3), bool)])
    written.write(tmp_path / "coco.json")
    assert json.loads((tmp_path / "coco.json").read_text())["annotations"] == []
