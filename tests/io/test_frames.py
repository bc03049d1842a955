"""Frames of the world in files of splats: glTF and OpenUSD; tests/io/test_spz.py has those of .spz."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from gltf_samples import columns_of, foreign, packed
from io_samples import some_gaussians
from scoup.base import WorldFrame
from scoup.io import load_gaussians, save_gaussians
from scoup.io.splats.axes import Axis, turned

PLACE = WorldFrame(0.25, (0.1, -0.9, 0.2), (0.8, 0.1, 0.5), (48.2082, 16.3738, 187.5), "map")


def in_the_world(means: torch.Tensor, frame: WorldFrame) -> np.ndarray:
    """Heights in metres."""
    up = torch.tensor(frame.up or (0, -1, 0), dtype=torch.float64)
    return ((frame.metres_per_unit or 1) * means.double() @ up).numpy()


@pytest.mark.parametrize(
    "frame", [WorldFrame(0.25), WorldFrame(2.0, (0.1, -0.9, 0.2)), WorldFrame(up=(0, 1, 0))]
)
def test_gltf_is_written_upright_and_in_metres(tmp_path: Path, frame: WorldFrame) -> None:
    given = replace(some_gaussians(9, 1), world=frame)
    save_gaussians(given, tmp_path / "a.gltf")
    found = load_gaussians(tmp_path / "a.gltf")
    assert torch.equal(found.means, given.means)
    assert found.world.metres_per_unit == pytest.approx(frame.metres_per_unit)
    np.testing.assert_allclose(
        in_the_world(found.means, found.world), in_the_world(given.means, frame), rtol=1e-6
    )


def test_a_node_of_gltf_is_the_frame(tmp_path: Path) -> None:
    """Three metres per unit, a quarter turn about z, and a translation: seen in the axes of the Gaussians."""
    given = some_gaussians(9, 1)
    root, binary = foreign(columns_of(turned(given, "z")))
    turn = [0.0, 0.0, 0.5**0.5, 0.5**0.5]
    root["nodes"] = [
        {"children": [1], "scale": [3, 3, 3]},
        {"mesh": 0, "rotation": turn, "translation": [0, 2, 0]},
    ]
    root["scenes"] = [{"nodes": [0]}]
    found = load_gaussians(packed(tmp_path / "a.glb", root, binary))
    assert found.world.metres_per_unit == pytest.approx(3)
    assert found.world.up == pytest.approx((-1, 0, 0), abs=1e-9), "x of the file, left, points up"
    np.testing.assert_allclose((found.means - given.means).numpy(), np.tile([-2, 0, 0], (9, 1)), atol=1e-6)


@pytest.mark.parametrize("axis", ["x", "z"])
def test_turned_gaussians_have_a_turned_frame(axis: Axis) -> None:
    given = replace(some_gaussians(9, 1), world=PLACE)
    other = turned(given, axis)
    assert turned(other, axis).world == PLACE
    np.testing.assert_allclose(
        in_the_world(other.means, other.world), in_the_world(given.means, PLACE), rtol=1e-5
    )


def test_a_stage_of_usd_is_upright_and_says_its_metres(tmp_path: Path) -> None:
    pxr = pytest.importorskip("pxr.UsdGeom")
    usd = pytest.importorskip("pxr.Usd")

    frame = WorldFrame(0.25, (0.1, -0.9, 0.2))
    given = replace(some_gaussians(9, 1), world=frame)
    save_gaussians(given, tmp_path / "a.usda")
    stage = usd.Stage.Open(str(tmp_path / "a.usda"))
    prim = stage.GetDefaultPrim()
    assert pxr.GetStageMetersPerUnit(stage) == 0.25
    matrix = np.array(pxr.Xformable(prim).ComputeLocalToWorldTransform(0))
    positions = np.array(prim.GetAttribute("positions").Get(), np.float64)
    heights = (positions @ matrix[:3, :3])[:, 1] * 0.25
    np.testing.assert_allclose(heights, in_the_world(given.means, frame), rtol=1e-5)
    assert np.linalg.det(matrix) == pytest.approx(1)
