""".spz: ranges, axes, extensions, and the place on Earth. An independent library: test_gaussforge_formats.py."""

from __future__ import annotations

import gzip
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import zstandard
from scipy.spatial.transform import Rotation
from splat_damages import AXES

from io_samples import PLACE, covariances, same_gaussians, some_gaussians, tame
from messages import refuses, warns
from scoup.base import FileFormatError, ScoupWarning, WorldFrame
from scoup.io import load_gaussians, save_gaussians
from scoup.io.splats.spz import read_spz, write_spz
from scoup.io.splats.spz_container import _unpacked
from scoup.scene import Gaussians, sh_basis
from support import unit


def test_ugly_values_are_mended(tmp_path: Path) -> None:
    ugly, scales = some_gaussians(4, 0), torch.ones(4, 3)
    scales[:2, 0] = torch.tensor([0.0, 1e30])
    with warns(ScoupWarning):
        write_spz(replace(ugly, scales=scales), tmp_path / "a.spz")
    found = read_spz(tmp_path / "a.spz")
    assert found.scales[:2, 0].log().tolist() == pytest.approx([-10, 255 / 16 - 10], abs=1e-4)
    with refuses():  # beyond the 24 bits of the format
        write_spz(replace(ugly, means=torch.full((4, 3), 1e9)), tmp_path / "b.spz")
    assert not (tmp_path / "b.spz").exists()


def test_degree_4_is_for_version_4(tmp_path: Path) -> None:
    given = tame(5, 4, 3)
    write_spz(given, tmp_path / "a.spz")
    found = read_spz(tmp_path / "a.spz")
    content = (tmp_path / "a.spz").read_bytes()  # streams are as long as their table says; of six the last
    (size,) = struct.unpack_from("<Q", content, 32 + 5 * 16)
    stored = np.frombuffer(zstandard.decompress(content[-size:]), np.uint8).reshape(5, 24, 3)[:, 15:]
    signs = np.array([1 if sign == "+" else -1 for sign in "-+-++-+--"])[:, None]
    np.testing.assert_array_equal(found.sh[:, 16:], ((stored / 128.0 - 1) * signs).astype(np.float32))


def extended(path: Path, record: bytes) -> Path:
    """Put a record of an extension into a .spz file."""
    content = path.read_bytes()
    if content[:2] == b"\x1f\x8b":
        body = bytearray(gzip.decompress(content))
        body[14] |= 2
        path.write_bytes(gzip.compress(bytes(body) + record))
    else:
        place = struct.unpack_from("<I", content, 16)[0] + len(record)
        head = content[:14] + bytes([content[14] | 2, content[15]]) + struct.pack("<I", place)
        path.write_bytes(head + content[20:32] + record + content[32:])
    return path


@pytest.mark.parametrize("version", [3, 4])
def test_declared_axes_are_obeyed(tmp_path: Path, version: int) -> None:
    given = tame(5, version, 3)
    directions = unit(torch.randn(9, 3))
    ways = {"R": (0, 1), "L": (0, -1), "D": (1, 1), "U": (1, -1), "F": (2, 1), "B": (2, -1)}

    def read(number: int) -> Gaussians:
        write_spz(given, tmp_path / "a.spz", True, version)
        return read_spz(extended(tmp_path / "a.spz", AXES + struct.pack("<I", number)))

    stored = read(6)  # RDF: as they are in the file
    assert same_gaussians(read(0), read(4))  # RUB
    names = "LDB RDB LUB RUB LDF RDF LUF RUF LFD RFD LFU RFU LBD RBD LBU RBU"
    for number, name in enumerate(names.split(), 1):
        found, matrix = read(number), torch.zeros(3, 3, dtype=torch.float64)
        for column, letter in enumerate(name):
            row, sign = ways[letter]
            matrix[row, column] = sign
        assert torch.allclose(found.means, stored.means @ matrix.float().T), name
        expected = matrix @ covariances(stored) @ matrix.T
        assert torch.allclose(covariances(found), expected, atol=1e-4), name
        if "U" not in name:  # where the format's own tools turn the last coefficient of degree 4
            before = sh_basis(directions, stored.sh_degree) @ stored.sh[:, 1:]
            after = sh_basis(directions @ matrix.float().T, stored.sh_degree) @ found.sh[:, 1:]
            assert torch.allclose(before, after, atol=1e-4), name


def test_extensions_that_are_not_known_are_warned_of(tmp_path: Path) -> None:
    write_spz(tame(5, 0, 3), tmp_path / "a.spz")
    read_spz(extended(tmp_path / "a.spz", struct.pack("<II3f", 0xADBE0002, 12, 0, 1, 1)))  # of viewers only
    extended(tmp_path / "a.spz", struct.pack("<II", 0x12340001, 3) + b"abc")
    with warns(ScoupWarning):
        read_spz(tmp_path / "a.spz")


def test_a_stream_of_another_size_is_refused(tmp_path: Path) -> None:
    with refuses(FileFormatError):
        _unpacked(tmp_path / "a.spz", zstandard.ZstdCompressor().compress(b"abc"), 4)


@pytest.mark.parametrize("version", [3, 4])
def test_what_unpacks_to_no_end_is_refused(tmp_path: Path, version: int) -> None:
    """Gaussians that are all alike, which take next to no bytes: some are read, very many are not."""
    one, path = some_gaussians(1, degree=0), tmp_path / "a.spz"
    for count in (50_000, 300_000):
        many = Gaussians(*(part.expand(count, *part.shape[1:]) for part in one.tensors().values()))
        write_spz(many, path, overwrite=True, version=version)
        if count == 50_000:
            assert len(load_gaussians(path)) == count
    with pytest.raises(FileFormatError, match="says 300,000 Gaussians, more than"):
        load_gaussians(path)


# ---- the place on Earth


def at_place(frame: WorldFrame) -> Any:
    """Its numbers, near enough."""
    values = frame.metres_per_unit, *(frame.up or ()), *(frame.north or ()), *(frame.origin or ())
    return pytest.approx(values, abs=1e-7)


@pytest.mark.parametrize("version", [3, 4])
def test_spz_keeps_the_place_on_earth(tmp_path: Path, version: int) -> None:
    write_spz(replace(some_gaussians(9, 1), world=PLACE), tmp_path / "a.spz", version=version)
    found = read_spz(tmp_path / "a.spz").world
    north = np.array(PLACE.north) - np.dot(PLACE.north or 0, PLACE.up or 0) * np.array(PLACE.up)
    level = replace(PLACE, north=tuple((north / np.linalg.norm(north)).tolist()))
    assert at_place(level) == at_place(found).expected
    assert found.name == ""
    as_stored = load_gaussians(tmp_path / "a.spz", keep_axes=True).world
    assert as_stored.up == pytest.approx(
        [value * sign for value, sign in zip(found.up or (), (1, -1, -1), strict=True)]
    )
    save_gaussians(replace(some_gaussians(9, 1), world=WorldFrame(0.5)), tmp_path / "b.spz")
    assert load_gaussians(tmp_path / "b.spz").world == WorldFrame(), (
        "a metre alone has no place in the format"
    )


def record(length: int = 9, crs: bytes = b"EPSG:4978", version: int = 1, norm: float = 1.0) -> bytes:
    """Of Vienna's cathedral, geocentric by EPSG's formulas; right, up, back are east, up, south there."""
    latitude, longitude = np.radians([48.2082, 16.3738])
    s, c, t, d = np.sin(latitude), np.cos(latitude), np.sin(longitude), np.cos(longitude)
    radius = 6_378_137 / np.sqrt(1 - 0.00669437999014 * s**2)
    origin = [
        (radius + 187.5) * c * d,
        (radius + 187.5) * c * t,
        (radius * (1 - 0.00669437999014) + 187.5) * s,
    ]
    east, north, up = [-t, d, 0], [-s * d, -s * t, c], [c * d, c * t, s]
    quaternion = Rotation.from_matrix(np.array([east, up, [-each for each in north]]).T).as_quat() * norm
    numbers = struct.pack("<9d", *origin, *quaternion, 0.25, np.nan)
    content = struct.pack("<BBH", version, 0, length) + numbers + crs
    return struct.pack("<II", 0x4E530001, len(content)) + content


def test_spz_of_others_says_where_it_is(tmp_path: Path) -> None:
    def read(content: bytes) -> WorldFrame:
        write_spz(some_gaussians(5, 0), tmp_path / "a.spz", True)
        return read_spz(extended(tmp_path / "a.spz", content)).world

    assert at_place(read(record())).expected == at_place(
        WorldFrame(0.25, (0, -1, 0), (0, 0, 1), (48.2082, 16.3738, 187.5))
    )
    drafts = (
        record(crs=b"EPSG:4979"), record(version=2), record(norm=1.1), record(length=8), record(crs=b"EPSG:4978" * 2),
    )  # fmt: skip
    for content in drafts:
        with warns(ScoupWarning):
            assert read(content) == WorldFrame()
