"""Transforms and labelled points in files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from io_samples import POINT_HEADER, TURNED
from scoup.base import OutputExistsError
from scoup.io import read_similarity
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
