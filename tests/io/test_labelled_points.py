"""Labelled points from PLY files, and what is wrong with others."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from scoup.base import FileFormatError, MissingFileError, OutputExistsError
from scoup_lab.data.labelled_points import LabelledPoints, read_labelled_ply, write_labelled_ply

HEADER = """ply
format {encoding} 1.0
element vertex {count}
property float x
property float y
property float z
property uchar red
property uchar green
property uchar blue
property uchar alpha
property ushort label
element face 1
property list uchar int vertex_indices
end_header
"""


def test_a_mesh_as_scannet_writes_it(tmp_path: Path) -> None:
    kinds = [*((name, "<f4") for name in "xyz"), *((name, "u1") for name in "rgba"), ("label", "<u2")]
    rows = np.zeros(2, dtype=kinds)
    rows["x"], rows["label"] = [1.5, -2], [40, 5]
    face = bytes([3]) + np.array([0, 1, 0], "<i4").tobytes()
    header = HEADER.format(encoding="binary_little_endian", count=2).encode()
    (tmp_path / "a.ply").write_bytes(header + rows.tobytes() + face)
    points = read_labelled_ply(tmp_path / "a.ply")
    assert points.positions.tolist() == [[1.5, 0, 0], [-2, 0, 0]]
    assert points.labels.tolist() == [40, 5]
    assert points.labels.dtype == torch.int64


def test_a_mesh_in_text(tmp_path: Path) -> None:
    header = HEADER.format(encoding="ascii", count=1)
    (tmp_path / "a.ply").write_text(header + "1 2 3 0 0 0 255 7\n3 0 0 0\n")
    points = read_labelled_ply(tmp_path / "a.ply")
    assert (points.positions.tolist(), points.labels.tolist()) == ([[1, 2, 3]], [7])


def test_what_is_written_is_read(tmp_path: Path) -> None:
    points = LabelledPoints(torch.rand(5, 3, generator=torch.Generator().manual_seed(0)), torch.arange(5) * 9)
    write_labelled_ply(points, tmp_path / "a.ply")
    found = read_labelled_ply(tmp_path / "a.ply")
    assert found.positions.equal(points.positions)
    assert found.labels.equal(points.labels)
    with pytest.raises(OutputExistsError):
        write_labelled_ply(points, tmp_path / "a.ply")


TEXT = HEADER.format(encoding="ascii", count=1)
MANY = HEADER.format(encoding="binary_little_endian", count=1_000_000_000)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (TEXT.replace("property ushort label\n", "") + "1 2 3 0 0 0 255\n3 0 0 0\n",
         r"no label \(but x, y, z, red.*_vh_clean_2.labels.ply"),
        (TEXT.replace("ushort label", "float label") + "1 2 3 0 0 0 255 7.5\n3 0 0 0\n", "not whole numbers"),
        (TEXT + "1 nan 3 0 0 0 255 7\n3 0 0 0\n", "not finite"),
        (MANY + "\0" * 100, "cut short"),
    ],
    ids=["no label", "halves", "nan", "cut"],
)  # fmt: skip
def test_other_meshes_are_refused(tmp_path: Path, content: str, said: str) -> None:
    with pytest.raises(MissingFileError, match="labelled points was expected"):
        read_labelled_ply(tmp_path / "a.ply")
    (tmp_path / "a.ply").write_text(content)
    with pytest.raises(FileFormatError, match=said):
        read_labelled_ply(tmp_path / "a.ply")
