"""Tracks of COLMAP's sparse points: binary and text, real and damaged."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from messages import refuses
from scoup.base.errors import FileFormatError, MissingFileError
from scoup.io import load_cameras, read_points, read_tracks

NAMES = {7: "b.png", 3: "sub/a.png"}
TRACKS = [[3, 7], [7], [], [3, 3, 7]]


def write_binary(folder: Path, tracks: list[list[int]] = TRACKS) -> None:
    images = struct.pack("<Q", len(NAMES))
    for number, name in NAMES.items():
        images += struct.pack("<I7dI", number, 1, 0, 0, 0, 0, 0, 0, 1) + name.encode() + b"\0"
        images += struct.pack("<Q", 2) + struct.pack("<ddQ", 1, 2, 0) * 2
    points = struct.pack("<Q", len(tracks))
    for number, track in enumerate(tracks):
        points += struct.pack("<Q3d3BdQ", number, number, 0.5, -1, 1, 2, 3, 0.1, len(track))
        points += b"".join(struct.pack("<II", image, 9) for image in track)
    (folder / "images.bin").write_bytes(images)
    (folder / "points3D.bin").write_bytes(points)


def write_text(folder: Path) -> None:
    lines = ["# comment"]
    for number, name in NAMES.items():
        lines += [f"{number} 1 0 0 0 0 0 0 1 {name}", "1.0 2.0 -1"]
    (folder / "images.txt").write_text("\n".join(lines))
    points = ["# comment"]
    for number, track in enumerate(TRACKS):
        points.append(f"{number} {number} 0.5 -1 1 2 3 0.1 " + " ".join(f"{image} 9" for image in track))
    (folder / "points3D.txt").write_text("\n".join(points))


@pytest.mark.parametrize("write", [write_binary, write_text])
def test_tracks_by_image_name(tmp_path: Path, write) -> None:
    write(tmp_path)
    positions, tracks = read_tracks(tmp_path)
    np.testing.assert_array_equal(positions, [[n, 0.5, -1] for n in range(4)])
    assert tracks == [["sub/a.png", "b.png"], ["b.png"], [], ["sub/a.png", "b.png"]]


def test_damage(tmp_path: Path) -> None:
    with refuses(MissingFileError):
        read_tracks(tmp_path)
    write_binary(tmp_path, [[3, 4]])
    with refuses(FileFormatError):
        read_tracks(tmp_path)
    write_binary(tmp_path)
    for name in ("points3D.bin", "images.bin"):
        whole = (tmp_path / name).read_bytes()
        for length in range(0, len(whole), 5):
            (tmp_path / name).write_bytes(whole[:length])
            with refuses(FileFormatError):
                read_tracks(tmp_path)
        (tmp_path / name).write_bytes(whole)
    # A track longer than the file, as a damaged number claims.
    (tmp_path / "points3D.bin").write_bytes(struct.pack("<QQ3d3BdQ", 1, 1, 0, 0, 0, 1, 2, 3, 0.1, 1 << 60))
    with pytest.raises(FileFormatError):
        read_tracks(tmp_path)
    write_text(tmp_path)
    (tmp_path / "points3D.bin").unlink()
    for text in ("1 2", "1 a b c 1 2 3 0.1 3 9", "1 0 0 0 1 2 3 0.1 99 9", f"1 0 0 0 1 2 3 0.1 {10**30} 9"):
        (tmp_path / "points3D.txt").write_text(text)
        with refuses(FileFormatError):
            read_tracks(tmp_path)


@pytest.mark.data
def test_real_tracks(data_folder: Path) -> None:
    """Photographs of a desk: every point was seen in two images or more, and projects into them."""
    from scoup_lab.evaluate.studies.matches import tracked_points

    folder = data_folder / "desk" / "sparse" / "0"
    if not folder.is_dir():
        pytest.skip(f"no desk at {folder}")
    positions, tracks = read_tracks(folder)
    assert len(positions) == 7562
    np.testing.assert_array_equal(positions, read_points(folder)[0])
    assert min(len(track) for track in tracks) >= 2
    cameras = load_cameras(data_folder / "desk")
    matches = tracked_points(folder, cameras)
    assert matches is not None
    assert matches.source == "COLMAP tracks"
    seen = sum(len(point) for point in matches.points)
    assert seen > 0.99 * sum(len(set(track)) for track in tracks)
