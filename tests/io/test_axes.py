"""Formats that name their axes, and those of 3DGS: right, down, forward."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from gltf_samples import spz_in_gltf
from io_samples import covariances, same_gaussians, some_cameras, some_gaussians
from scoup.base import FileFormatError
from scoup.io.splats.axes import Axis, turned
from scoup.io.splats.gltf import read_gltf
from scoup.io.splats.rotation import rotated_sh
from scoup.io.splats.spz import read_spz
from scoup.raster import view_colors
from scoup.scene import Camera

TURNS: dict[Axis, list[float]] = {"x": [1, -1, -1], "y": [-1, 1, -1], "z": [-1, -1, 1]}


@pytest.mark.parametrize("axis", TURNS)
def test_a_half_turn_is_the_rotation(axis: Axis) -> None:
    gaussians = some_gaussians(9, 3)
    rotation = np.diag(TURNS[axis]).astype(np.float64)
    found = turned(gaussians, axis)
    np.testing.assert_array_equal(found.means, gaussians.means.numpy() @ rotation)
    linear = torch.from_numpy(rotation)
    torch.testing.assert_close(covariances(found), linear @ covariances(gaussians) @ linear)
    np.testing.assert_allclose(found.sh, rotated_sh(gaussians.sh.numpy(), rotation), atol=1e-6)
    assert same_gaussians(turned(found, axis), gaussians)


def test_rotations_of_harmonics_form_a_group() -> None:
    sh, rotation = some_gaussians(4, 3).sh.numpy(), Rotation.from_rotvec([0.3, -1.1, 0.7]).as_matrix()
    np.testing.assert_allclose(rotated_sh(rotated_sh(sh, rotation), rotation.T), sh, atol=2e-6)


@pytest.mark.parametrize("axis", TURNS)
def test_colours_of_degree_4_turn_along(axis: Axis) -> None:
    gaussians, camera = some_gaussians(9, 4), some_cameras(1)[0]
    turn = torch.diag(torch.tensor([*TURNS[axis], 1.0], dtype=torch.float64))
    along = Camera("a", camera.viewmat @ turn, camera.K, camera.width, camera.height)
    colors = view_colors(turned(gaussians, axis), along)
    torch.testing.assert_close(colors, view_colors(gaussians, camera), rtol=0, atol=2e-5)


@pytest.mark.parametrize("name", ["", "_2"])
@pytest.mark.parametrize("version", [2, 4])
def test_spz_in_gltf_is_read(tmp_path: Path, name: str, version: int) -> None:
    gaussians = some_gaussians(30, 3)
    path = spz_in_gltf(tmp_path, gaussians, name, version)
    assert same_gaussians(read_gltf(path), read_spz(tmp_path / "inner.spz"))


def test_spz_in_gltf_that_is_damaged_is_refused(tmp_path: Path) -> None:
    path = spz_in_gltf(tmp_path, some_gaussians(30, 1))
    data = path.read_bytes()
    path.write_bytes(data[:-200] + bytes(200))
    with pytest.raises(FileFormatError, match=r"spz\.glb: "):
        read_gltf(path)
    path = spz_in_gltf(tmp_path, some_gaussians(30, 4), version=4)
    with pytest.raises(FileFormatError, match="SH of a degree above 3"):
        read_gltf(path)
