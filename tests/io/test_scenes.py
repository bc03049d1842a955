from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from io_samples import (
    TURNED,
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
from scoup.io import (
    PlyTable,
    load_cameras,
    load_gaussians,
    load_image,
    read_similarity,
    save_gaussians,
    splat_source,
    write_transforms,
)
from scoup.io.camera_sources import CAMERA_FORMATS, CameraFormat, find_cameras
from scoup.io.scenes import camera_photographs
from scoup.scene import sanity_problems
from scoup_lab.data.colmap_model import write_colmap


def colmap_scene(
    folder: Path, count: int = 3, images: str | None = "images", model: str = "sparse/0"
) -> Path:
    cameras = some_cameras(count)
    write_colmap(cameras, folder / model)
    if images:
        save_images(cameras, folder / images)
    return folder


@pytest.mark.parametrize("name", ["sparse/0", "sparse", "colmap/sparse/0", "."])
def test_colmap_folders(tmp_path, monkeypatch, name):
    model = colmap_scene(tmp_path, model=name) / name
    cameras = some_cameras(3)
    for path in (tmp_path, model, model / "images.bin"):
        loaded = load_cameras(path)
        assert camera_difference(cameras, loaded) < 1e-12
        assert [each.image_path for each in loaded] == [tmp_path / "images" / each for each in cameras.names]
    for current, path in ((model.parent, model.name), (tmp_path, ".")):
        monkeypatch.chdir(current)
        assert load_cameras(path)[0].image_path is not None


def test_precedence(tmp_path):
    cameras = some_cameras(2, centered=True)
    for name, write, expected in (
        ("cameras.json", write_inria_cameras, "inria"),
        ("colmap/sparse/0", write_colmap, "colmap"),
        ("transforms.json", write_transforms, "nerfstudio"),
        ("sparse/0", write_colmap, "colmap"),
    ):
        write(cameras, tmp_path / name)
        found = find_cameras(tmp_path)
        assert (found.path, found.format) == (tmp_path / name, expected)
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
    cameras, data, output = some_cameras(3, centered=True), tmp_path / "data", tmp_path / "output"
    save_images(cameras, data / "images")
    write_inria_cameras(cameras, output / "cameras.json")
    (output / "cameras.json").write_text((output / "cameras.json").read_text().replace(".png", ""))
    (output / "cfg_args").write_text(f"Namespace(source_path={str(data)!r})")
    loaded = load_cameras(output)
    assert camera_difference(cameras, loaded) < 1e-12
    assert loaded[0].image_path == data / "images" / "view_00.png"
    (output / "cfg_args").write_text("damaged")
    with warns(ScoupWarning):
        assert load_cameras(output).names == ("view_00", "view_01", "view_02")


@pytest.mark.parametrize(("there", "downscale", "folder", "factor"), [
    ([2], None, "images_2", 2),
    *(([1, 2], factor, "images_2" if factor == 2 else "images", factor) for factor in (1, 2, 4, 8)),
])  # fmt: skip
def test_scaled_images(tmp_path: Path, there: list[int], downscale: Any, folder: str, factor: int) -> None:
    colmap_scene(tmp_path, images=None)
    for divisor in there:
        save_images(some_cameras(3), tmp_path / ("images_2" if divisor == 2 else "images"), divisor)
    camera = load_cameras(tmp_path, downscale=downscale)[0]
    assert (camera.width, camera.height) == (32 // factor, 24 // factor)
    assert camera.image_path == tmp_path / folder / "view_00.png"
    expected = [30.5 / factor, 0, 16.7 / factor, 0, 31.25 / factor, 10.7 / factor]
    assert camera.K[:2].flatten().tolist() == pytest.approx(expected)
    assert load_image(camera).shape == (24 // factor, 32 // factor, 3)


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
    colmap_scene(tmp_path)
    wrong: list[dict[str, Any]] = [{"distorted": "ignore"}, {"missing_images": "drop"}, {"downscale": 3}]
    for option in wrong:
        with refuses():
            load_cameras(tmp_path, **option)


def test_gaussians_of_every_kind(tmp_path):
    gaussians = PlyTable.of(some_gaussians(5, degree=1)).gaussians()[0]
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
    for name, shift in (("near.ply", (5000.0, -4000.0, 0.0)), ("utm.ply", (500000.0, 4649776.0, 120.0))):
        given = some_gaussians(50)
        PlyTable.of(replace(given, means=given.means + torch.tensor(shift))).write(tmp_path / name)
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
    save_gaussians(some_gaussians(0), tmp_path / "empty.ply")
    for name in ("a.txt", "empty.ply"):
        with refuses(FileFormatError):
            load_gaussians(tmp_path / name)


def test_a_nerf_synthetic_scene(tmp_path: Path) -> None:
    for part, count in (("train", 3), ("test", 2)):
        cameras = some_cameras(count)
        save_images(cameras, tmp_path / part)
        write_transforms(cameras, tmp_path / "transforms.json", overwrite=True)
        content = json.loads((tmp_path / "transforms.json").read_text())
        for frame in content["frames"]:
            frame["file_path"] = frame["file_path"].replace("images", f"./{part}").removesuffix(".png")
        (tmp_path / f"transforms_{part}.json").write_text(json.dumps(content))
    (tmp_path / "transforms.json").unlink()
    loaded = load_cameras(tmp_path)
    assert camera_difference(loaded, some_cameras(3)) < 1e-12
    assert loaded[0].image_path == tmp_path / "train/view_00.png"
    assert [item.path for item in find_photographs(tmp_path)] == [camera.image_path for camera in loaded]
    (tmp_path / "transforms_train.json").unlink()
    with refuses(MissingFileError):
        load_cameras(tmp_path)
    assert len(load_cameras(tmp_path / "transforms_test.json")) == 2


@pytest.mark.parametrize(
    "text", [json.dumps(TURNED.tolist()), "\n\n".join(" ".join(map(str, row)) for row in TURNED), "\n".join(
        ", ".join(map(str, row)) for row in TURNED)]
)  # fmt: skip
def test_similarities_of_text_and_json(tmp_path: Path, text: str) -> None:
    path = tmp_path / "t.txt"
    path.write_text(text)
    assert np.array_equal(read_similarity(path), TURNED)
