"""dataparser_transforms.json: cameras follow the splat into the frame that nerfstudio trains in."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from io_samples import camera_difference, some_cameras
from scoup.io import load_cameras, write_colmap, write_transforms
from scoup.scene.cameras import Cameras

APPLIED = np.array([[0.0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, 0]])  # of ns-process-data
pytestmark = pytest.mark.filterwarnings("ignore:.*using the cameras alone")


def four(matrix: np.ndarray) -> np.ndarray:
    return np.vstack([matrix, [0, 0, 0, 1]])


@pytest.fixture
def trained(tmp_path: Path) -> tuple[np.ndarray, float, Path]:
    """What nerfstudio did to the cameras of transforms.json (turned, shifted, then scaled), and its record of it."""
    orient = np.hstack([Rotation.from_rotvec([0.3, -0.8, 0.4]).as_matrix(), [[0.5], [-2.0], [1.5]]])
    scale = 0.35
    path = tmp_path / "dataparser_transforms.json"
    record = (four(orient) @ four(APPLIED))[:3]
    path.write_text(json.dumps({"transform": record.tolist(), "scale": scale}))
    return orient, scale, path


def assert_follow(moved: Cameras, cameras: Cameras, world: np.ndarray, scale: float) -> None:
    """A point and its image in the other world are seen at the same pixel, at depths that differ by the scale."""
    points = np.random.default_rng(0).normal(size=(20, 3)) * 3
    images = scale * (points @ world[:3, :3].T + world[:3, 3])
    for camera in cameras:
        seen = points @ camera.viewmat[:3, :3].numpy().T + camera.viewmat[:3, 3].numpy()
        now = moved[camera.name]
        again = images @ now.viewmat[:3, :3].numpy().T + now.viewmat[:3, 3].numpy()
        np.testing.assert_allclose(again, scale * seen, atol=1e-9)
        assert torch.equal(now.K, camera.K)


def test_cameras_of_transforms_json(tmp_path: Path, trained):
    orient, scale, path = trained
    cameras = some_cameras(4)
    file = tmp_path / "transforms.json"
    write_transforms(cameras, file)
    content = json.loads(file.read_text()) | {"applied_transform": APPLIED.tolist()}
    file.write_text(json.dumps(content))
    assert_follow(load_cameras(file, dataparser_transforms=path), cameras, orient, scale)
    file.write_text(json.dumps(content | {"applied_scale": 0.5}))
    assert_follow(load_cameras(file, dataparser_transforms=path), cameras, orient, scale / 0.5)
    # Older data do not say what was applied; nerfstudio then goes by the model beside them.
    del content["applied_transform"]
    file.write_text(json.dumps(content))
    unapplied = (four(orient) @ four(APPLIED))[:3]
    assert_follow(load_cameras(file, dataparser_transforms=path), cameras, unapplied, scale)
    (tmp_path / "colmap" / "sparse" / "0").mkdir(parents=True)
    assert_follow(load_cameras(file, dataparser_transforms=path), cameras, orient, scale)
    assert camera_difference(load_cameras(file), cameras) < 1e-12


def test_cameras_of_colmap(tmp_path: Path, trained):
    orient, scale, path = trained
    cameras = some_cameras(4)
    write_colmap(cameras, tmp_path / "sparse" / "0")
    world = (four(orient) @ four(APPLIED))[:3]
    assert_follow(load_cameras(tmp_path, dataparser_transforms=path), cameras, world, scale)
