"""Transforms and labelled points in files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from scene_damages import POINT_HEADER, TURNED

from messages import refuses
from scoup.base import MissingFileError, OutputExistsError
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


def test_a_mesh_as_scannet_writes_it(tmp_path: Path) -> None:
    kinds = [*((name, "<f4") for name in "xyz"), *((name, "u1") for name in "rgba"), ("label", "<u2")]
    rows = np.zeros(2, dtype=kinds)
    rows["x"], rows["label"] = [1.5, -2], [40, 5]
    face = bytes([3]) + np.array([0, 1, 0], "<i4").tobytes()
    header = POINT_HEADER.format(encoding="binary_little_endian", count=2).encode()
    (tmp_path / "a.ply").write_bytes(header + rows.tobytes() + face)
    points = read_labelled_ply(tmp_path / "a.ply")
    assert points.positions.tolist() == [[1.5, 0, 0], [-2, 0, 0]]
    assert points.labels.tolist() == [40, 5]
    assert points.labels.dtype == torch.int64


def test_a_mesh_in_text(tmp_path: Path) -> None:
    header = POINT_HEADER.format(encoding="ascii", count=1)
    (tmp_path / "a.ply").write_text(header + "1 2 3 0 0 0 255 7\n3 0 0 0\n")
    points = read_labelled_ply(tmp_path / "a.ply")
    assert (points.positions.tolist(), points.labels.tolist()) == ([[1, 2, 3]], [7])


def test_what_is_written_is_read(tmp_path: Path) -> None:
    points = LabelledPoints(torch.rand(5, 3, generator=torch.Generator().manual_seed(0)), torch.arange(5) * 9)
    write_labelled_ply(points, tmp_path / "a.ply")
    found = read_labelled_ply(tmp_path / "a.ply")
    assert found.positions.equal(points.positions)
    assert found.labels.equal(points.labels)
    with refuses(MissingFileError):
        read_labelled_ply(tmp_path / "b.ply")
    with pytest.raises(OutputExistsError):
        write_labelled_ply(points, tmp_path / "a.ply")
