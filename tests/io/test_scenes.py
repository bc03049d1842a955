from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
import torch

from io_samples import (
    camera_difference,
    same_gaussians,
    save_checkpoint,
    save_images,
    some_cameras,
    some_gaussians,
    write_inria_cameras,
)
from messages import refuses, warns
from scoup.base import FileFormatError, MissingFileError, ScoupWarning
from scoup.extract import find_photographs
from scoup.io import as_stored, load_cameras, load_gaussians, load_image, save_gaussians, splat_source
from scoup.io.camera_sources import CAMERA_FORMATS, CameraFormat, find_cameras
from scoup.io.cameras.colmap import write_colmap
from scoup.io.cameras.nerfstudio import write_transforms
from scoup.io.scenes import camera_photographs
from scoup.io.splats.ply import PlyTable
from scoup.scene import sanity_problems


def colmap_scene(folder: Path, count: int = 3, images: str | None = "images", divisor: int = 1) -> Path:
    cameras = some_cameras(count)
    write_colmap(cameras, folder / "sparse" / "0")
    if images:
        save_images(cameras, folder / images, divisor)
    return folder


@pytest.mark.parametrize("name", ["sparse/0", "sparse", "colmap/sparse/0", "."])
def test_colmap_folders(tmp_path, name):
    cameras = some_cameras(3)
    write_colmap(cameras, tmp_path / name)
    save_images(cameras, tmp_path / "images")
    for path in (tmp_path, tmp_path / name, tmp_path / name / "images.bin"):
        loaded = load_cameras(path)
        assert camera_difference(cameras, loaded) < 1e-12
        assert [camera.image_path for camera in loaded] == [
            tmp_path / "images" / each for each in cameras.names
        ]


def test_the_current_folder(tmp_path, monkeypatch):
    colmap_scene(tmp_path)
    monkeypatch.chdir(tmp_path / "sparse")
    assert load_cameras("0")[0].image_path is not None
    monkeypatch.chdir(tmp_path)
    assert load_cameras(".")[0].image_path is not None


def test_precedence(tmp_path):
    cameras = some_cameras(2, centered=True)
    write_inria_cameras(cameras, tmp_path / "cameras.json")
    assert find_cameras(tmp_path).format == "inria"
    write_colmap(cameras, tmp_path / "colmap" / "sparse" / "0")
    assert find_cameras(tmp_path).path == tmp_path / "colmap" / "sparse" / "0"
    write_transforms(cameras, tmp_path / "transforms.json")
    assert find_cameras(tmp_path).format == "nerfstudio"
    write_colmap(cameras, tmp_path / "sparse" / "0")
    assert find_cameras(tmp_path).format == "colmap"
    (tmp_path / "point_cloud").mkdir()
    assert find_cameras(tmp_path).format == "inria"


@pytest.mark.filterwarnings("ignore:.*no image")
def test_a_format_of_a_package(tmp_path, monkeypatch):
    cameras = some_cameras(2)
    own = CameraFormat("own", lambda path, _: cameras, lambda path: path.suffix == ".rig", ("own.rig",))
    monkeypatch.setitem(CAMERA_FORMATS._all, "own", own)
    with refuses(MissingFileError):
        find_cameras(tmp_path)
    (tmp_path / "own.rig").touch()
    save_images(cameras, tmp_path / "images")
    for path in (tmp_path, tmp_path / "own.rig"):
        assert load_cameras(path).names == cameras.names


def test_inria_names_get_their_extension_and_images_of_the_training_data(tmp_path):
    cameras = some_cameras(3, centered=True)
    data = tmp_path / "data"
    save_images(cameras, data / "images")
    output = tmp_path / "output"
    write_inria_cameras(cameras, output / "cameras.json")
    entries = json.loads((output / "cameras.json").read_text())
    for entry in entries:
        entry["img_name"] = entry["img_name"].split(".")[0]
    (output / "cameras.json").write_text(json.dumps(entries))
    (output / "cfg_args").write_text(f"Namespace(source_path={str(data)!r})")
    loaded = load_cameras(output)
    assert camera_difference(cameras, loaded) < 1e-12
    assert loaded[0].image_path == data / "images" / "view_00.png"
    (output / "cfg_args").write_text("damaged")
    with warns(ScoupWarning):
        assert load_cameras(output).names == ("view_00", "view_01", "view_02")


def test_only_scaled_images(tmp_path):
    scene = colmap_scene(tmp_path, images="images_2", divisor=2)
    camera = load_cameras(scene)[0]
    assert (camera.width, camera.height) == (16, 12)
    assert camera.fx == pytest.approx(30.5 / 2)
    assert load_image(camera).shape == (12, 16, 3)


def test_downscale(tmp_path):
    scene = colmap_scene(tmp_path)
    save_images(some_cameras(3), scene / "images_2", 2)
    folders: dict[Literal[1, 2, 4, 8], str] = {1: "images", 2: "images_2", 4: "images", 8: "images"}
    for factor, folder in folders.items():
        camera = load_cameras(scene, downscale=factor)[0]
        assert (camera.width, camera.height) == (32 // factor, 24 // factor)
        assert camera.image_path == scene / folder / "view_00.png"
        assert camera.K[0, 2] == pytest.approx(16.7 / factor)
        assert load_image(camera).shape == (24 // factor, 32 // factor, 3)
    with refuses():
        load_cameras(scene, downscale=3)  # pyright: ignore[reportArgumentType]


def test_missing_images(tmp_path):
    scene = colmap_scene(tmp_path, count=4)
    (scene / "images" / "view_01.png").unlink()
    with warns(ScoupWarning):
        assert load_cameras(scene).names == ("view_00.png", "view_02.png", "view_03.png")
    kept = load_cameras(scene, missing_images="keep", downscale=2)
    assert len(kept) == 4
    assert kept[1].image_path is None
    assert kept[1].width == 16
    shutil.rmtree(scene / "images")
    with warns(ScoupWarning):
        assert len(load_cameras(scene)) == 4
    assert len(load_cameras(scene, missing_images="keep")) == 4


def test_images_elsewhere(tmp_path):
    scene = colmap_scene(tmp_path / "scene", images=None)
    save_images(some_cameras(3), tmp_path / "photos")
    camera = load_cameras(scene, images=tmp_path / "photos")[0]
    assert camera.image_path == tmp_path / "photos" / "view_00.png"
    save_images(some_cameras(3), scene / "frames")
    assert load_cameras(scene, images="frames")[0].image_path == scene / "frames" / "view_00.png"
    with refuses(MissingFileError):
        load_cameras(scene, images=tmp_path / "none")
    (tmp_path / "empty").mkdir()
    with refuses(MissingFileError):
        load_cameras(scene, images=tmp_path / "empty")


def test_images_of_another_shape_or_damaged(tmp_path):
    scene = colmap_scene(tmp_path)
    for width, height in ((24, 32), (1, 1)):
        save_images(some_cameras(1, width, height), scene / "images")
        with refuses(FileFormatError):
            load_cameras(scene)
    save_images(some_cameras(2, 24, 32), scene / "images")
    save_images(some_cameras(1, 1, 1), scene / "images")
    for read in (load_cameras, camera_photographs, find_photographs):
        with refuses(FileFormatError):
            read(scene)
    save_images(some_cameras(), scene / "images")
    (scene / "images" / "view_00.png").write_bytes(b"no image")
    with warns(ScoupWarning):
        assert load_cameras(scene).names == ("view_01.png", "view_02.png")
    with warns(ScoupWarning):
        assert load_cameras(scene, missing_images="keep")[0].image_path is None
    for number in (1, 2):
        (scene / "images" / f"view_0{number}.png").write_bytes(b"no image")
    with warns(ScoupWarning):
        assert len(load_cameras(scene)) == 3


def test_no_cameras(tmp_path):
    with refuses(MissingFileError):
        load_cameras(tmp_path)
    (tmp_path / "a.ply").write_text("ply")
    with refuses(FileFormatError):
        load_cameras(tmp_path / "a.ply")
    with refuses():
        load_cameras(tmp_path, distorted="ignore")  # pyright: ignore[reportArgumentType]
    with refuses():
        load_cameras(tmp_path, missing_images="drop")  # pyright: ignore[reportArgumentType]


def test_gaussians_of_every_kind(tmp_path):
    gaussians = as_stored(some_gaussians(5, degree=1))
    save_gaussians(gaussians, tmp_path / "a.ply")
    assert same_gaussians(load_gaussians(tmp_path / "a.ply"), gaussians)
    assert same_gaussians(load_gaussians(tmp_path), gaussians)
    save_gaussians(gaussians, tmp_path / "b.splat")
    assert len(load_gaussians(tmp_path / "b.splat")) == 5
    with refuses(MissingFileError):
        load_gaussians(tmp_path)
    save_checkpoint(gaussians, tmp_path / "ckpts" / "ckpt_1_rank0.pt")
    for path in (tmp_path, tmp_path / "ckpts", tmp_path / "ckpts" / "ckpt_1_rank0.pt"):
        torch.testing.assert_close(load_gaussians(path).means, gaussians.means)
        assert splat_source(path).preset == "gsplat"
    save_gaussians(gaussians, tmp_path / "point_cloud" / "iteration_5" / "point_cloud.ply")
    assert same_gaussians(load_gaussians(tmp_path), gaussians)
    assert splat_source(tmp_path).preset == "inria"


def test_far_from_the_origin_is_refused_and_5_km_are_not(tmp_path):
    gaussians = some_gaussians(50)
    for name, shift in (("near.ply", (5000.0, -4000.0, 0.0)), ("utm.ply", (500000.0, 4649776.0, 120.0))):
        table = PlyTable.of(gaussians)
        for axis, value in zip("xyz", shift, strict=True):
            table = table.with_column(axis, table.rows[axis].astype(np.float64) + value)
        table.write(tmp_path / name)
    assert len(load_gaussians(tmp_path / "near.ply")) == 50
    with refuses(FileFormatError):
        load_gaussians(tmp_path / "utm.ply")


@pytest.mark.parametrize(("config", "said"), [
    ("cfg.yml", "antialiased: true\n"),
    ("config.yml", "  model:\n    rasterize_mode: antialiased\n"),
    ("cfg.yml", "antialiased: false\n"),
])  # fmt: skip
def test_configurations_say_antialiased(tmp_path, config, said):
    save_gaussians(some_gaussians(5), tmp_path / "a.ply")
    (tmp_path / config).write_text(said)
    gaussians = load_gaussians(tmp_path)
    assert gaussians.antialiased == ("false" not in said)
    warned = any("trained with antialiasing" in text for text in sanity_problems(gaussians))
    assert warned == gaussians.antialiased


def test_no_gaussians(tmp_path):
    with refuses(MissingFileError):
        load_gaussians(tmp_path)
    (tmp_path / "a.txt").write_bytes(b"x")
    with refuses(FileFormatError):
        load_gaussians(tmp_path / "a.txt")
    save_gaussians(some_gaussians(0), tmp_path / "empty.ply")
    with refuses(FileFormatError):
        load_gaussians(tmp_path / "empty.ply")
