"""Transforms and labelled points in files, and COCO's JSON, read by its own library."""

from __future__ import annotations

import contextlib
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from io_samples import POINT_HEADER, TURNED
from messages import refuses
from scoup.base import OutputExistsError
from scoup.io.coco import CocoAnnotations, run_lengths
from scoup.io.similarity import read_similarity
from scoup_lab.data.labelled_points import LabelledPoints, read_labelled_ply, write_labelled_ply


@pytest.mark.parametrize(
    "text", [json.dumps(TURNED.tolist()), "\n\n".join(" ".join(map(str, row)) for row in TURNED), "\n".join(
        ", ".join(map(str, row)) for row in TURNED)]
)  # fmt: skip
def test_text_and_json(tmp_path: Path, text: str) -> None:
    path = tmp_path / "t.txt"
    path.write_text(text)
    assert np.array_equal(read_similarity(path), TURNED)


@pytest.mark.parametrize("encoding", ["binary_little_endian", "ascii"])
def test_a_mesh_as_scannet_writes_it(tmp_path: Path, encoding: str) -> None:
    kinds = [*((name, "<f4") for name in "xyz"), *((name, "u1") for name in "rgba"), ("label", "<u2")]
    rows = np.zeros(2, dtype=kinds)
    rows["x"], rows["label"] = [1.5, -2], [40, 5]
    body = rows.tobytes() + bytes([3]) + np.array([0, 1, 0], "<i4").tobytes()
    if encoding == "ascii":
        body = b"1.5 0 0 0 0 0 0 40\n-2 0 0 0 0 0 0 5\n3 0 1 0\n"
    (tmp_path / "a.ply").write_bytes(POINT_HEADER.format(encoding=encoding, count=2).encode() + body)
    points = read_labelled_ply(tmp_path / "a.ply")
    assert points.positions.tolist() == [[1.5, 0, 0], [-2, 0, 0]]
    assert points.labels.tolist() == [40, 5]
    assert points.labels.dtype == torch.int64


def test_what_is_written_is_read(tmp_path: Path) -> None:
    points = LabelledPoints(torch.rand(5, 3, generator=torch.Generator().manual_seed(0)), torch.arange(5) * 9)
    write_labelled_ply(points, tmp_path / "a.ply")
    found = read_labelled_ply(tmp_path / "a.ply")
    assert found.positions.equal(points.positions)
    assert found.labels.equal(points.labels)
    with pytest.raises(OutputExistsError):
        write_labelled_ply(points, tmp_path / "a.ply")


def encoded(mask: np.ndarray) -> Any:
    """Run lengths by COCO's own library."""
    tools = pytest.importorskip("pycocotools.mask", reason="pycocotools is the oracle")
    return tools.encode(np.asfortranarray(mask.astype(np.uint8)))


@given(st.integers(1, 40), st.integers(1, 40), st.floats(0, 1), st.integers(0, 2**31))
def test_run_lengths_equal_cocos(height: int, width: int, share: float, seed: int) -> None:
    mask = np.random.default_rng(seed).random((height, width)) < share
    assert run_lengths(mask) == encoded(mask)["counts"].decode()


@pytest.mark.parametrize("side", [700, 70_000])
def test_long_runs(side: int) -> None:
    mask = np.zeros((side, 3), bool)
    mask[5:, 1] = True
    assert run_lengths(mask) == encoded(mask)["counts"].decode()


def test_files_are_read_by_cocos_library(tmp_path: Path) -> None:
    coco = pytest.importorskip("pycocotools.coco", reason="pycocotools is the oracle")
    masks = np.random.default_rng(0).random((2, 3, 20, 30)) < 0.3
    masks[1, 2] = False
    written = CocoAnnotations(("mug", "kettle", "table"))
    for number, of_view in enumerate(masks):
        written.add(f"view_{number}.png", (30, 20), list(of_view), [0.5, None, 0.25])
    written.write(tmp_path / "coco.json")
    with contextlib.redirect_stdout(io.StringIO()):
        read = coco.COCO(str(tmp_path / "coco.json"))
    assert [image["file_name"] for image in read.loadImgs([1, 2])] == ["view_0.png", "view_1.png"]
    assert {one["id"]: one["name"] for one in read.loadCats([1, 2, 3])} == {1: "mug", 2: "kettle", 3: "table"}
    assert len(read.getAnnIds()) == 5
    for entry in read.loadAnns(read.getAnnIds()):
        mask = masks[entry["image_id"] - 1, entry["category_id"] - 1]
        assert np.array_equal(read.annToMask(entry).astype(bool), mask)
        assert entry["area"] == mask.sum()
        rows, columns = (np.flatnonzero(mask.any(axis)) for axis in (1, 0))
        corner = [columns[0], rows[0]]
        assert entry["bbox"] == [*corner, columns[-1] + 1 - corner[0], rows[-1] + 1 - corner[1]]
        assert entry.get("score") == {1: 0.5, 2: None, 3: 0.25}[entry["category_id"]]
    with pytest.raises(OutputExistsError):
        written.write(tmp_path / "coco.json")


def test_what_does_not_fit_is_refused() -> None:
    with refuses():
        CocoAnnotations(("mug", "mug"))
    with refuses():
        CocoAnnotations(("mug",)).add("a.png", (30, 20), [np.ones((30, 20), bool)])


def test_an_empty_set_is_a_file(tmp_path: Path) -> None:
    written = CocoAnnotations(("mug",))
    written.add("a.png", (3, 2), [None])
    written.write(tmp_path / "coco.json")
    assert json.loads((tmp_path / "coco.json").read_text())["annotations"] == []
