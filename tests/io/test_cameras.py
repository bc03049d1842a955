"""Cameras of COLMAP, nerfstudio and Inria's code: what is written is read, and files as those programs write them."""

from __future__ import annotations

import contextlib
import json
import math
import struct
from argparse import Namespace
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from io_samples import (
    APPLIED,
    DISTORTED,
    camera_difference,
    save_images,
    some_cameras,
    text_model,
    transforms,
    write_colmap_text,
    write_inria_cameras,
)
from messages import refuses, warns
from scoup.base import FileFormatError, MissingFileError, OutputExistsError, ScoupWarning
from scoup.extract import find_photographs
from scoup.io import load_cameras, read_points, read_tracks, write_transforms
from scoup.io.cameras.colmap import read_colmap
from scoup.io.cameras.inria import latest_point_cloud, read_cfg_args
from scoup.io.cameras.nerfstudio import read_transforms
from scoup.io.reading import read_text
from scoup.scene import Cameras
from scoup_lab.data.colmap_model import write_colmap

ALONE = pytest.mark.filterwarnings("ignore:.*using the cameras alone")
POINTS = np.random.default_rng(0).normal(size=(4, 3)), np.arange(12, dtype=np.uint8).reshape(4, 3)
WRITERS: dict[str, Callable[[Cameras, Path], object]] = {
    "sparse/0": lambda cameras, path: write_colmap(cameras, path, POINTS),
    "sparse": lambda cameras, path: write_colmap_text(cameras, path, POINTS),
    "transforms.json": write_transforms, "cameras.json": write_inria_cameras,
}  # fmt: skip


@ALONE
@pytest.mark.parametrize("name", WRITERS)
def test_what_is_written_is_read(tmp_path: Path, name: str) -> None:
    cameras, path = some_cameras(60, centered=name == "cameras.json"), tmp_path / name
    WRITERS[name](cameras, path)
    assert camera_difference(cameras, load_cameras(path)) < 1e-12
    if name.startswith("sparse"):
        assert all(map(np.array_equal, read_points(path), POINTS))
    if name in ("sparse/0", "transforms.json"):  # which are not of the tests alone
        with pytest.raises(OutputExistsError):
            WRITERS[name](cameras, path)


@pytest.mark.parametrize("text", [False, True])
def test_pycolmap_reads_what_we_write_and_we_what_it_writes(tmp_path: Path, text: bool) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    cameras = some_cameras(4)
    (write_colmap_text if text else write_colmap)(cameras, tmp_path / "ours", POINTS)
    model = pycolmap.Reconstruction(str(tmp_path / "ours"))
    assert model.num_images() == 4
    for image in model.images.values():
        camera = cameras[image.name]
        np.testing.assert_allclose(image.cam_from_world().matrix(), camera.viewmat[:3], atol=1e-12)
        np.testing.assert_allclose(model.cameras[image.camera_id].calibration_matrix(), camera.K, atol=1e-12)
    theirs = tmp_path / "theirs"
    theirs.mkdir()
    (model.write_text if text else model.write_binary)(str(theirs))
    assert camera_difference(cameras, read_colmap(theirs)) < 1e-9
    np.testing.assert_allclose(np.sort(read_points(theirs)[0], axis=0), np.sort(POINTS[0], axis=0))


def test_text_with_empty_keypoint_lines_and_spaces_in_names(tmp_path: Path) -> None:
    images = "1 2 0 0 0 0 0 0 1 b c.jpg\n\n2 1 0 0 0 0 0 0 1 a.jpg\n1.5 2.5 -1 3 4 7\n"
    cameras = read_colmap(text_model(tmp_path, "1 SIMPLE_PINHOLE 40 30 50 20 15", images))
    assert cameras.names == ("a.jpg", "b c.jpg")
    assert cameras[0].K.tolist() == [[50, 0, 20], [0, 50, 15], [0, 0, 1]]
    assert torch.equal(cameras[1].viewmat, torch.eye(4, dtype=torch.float64))  # of a quaternion of any norm


@pytest.mark.parametrize("line", DISTORTED.values(), ids=DISTORTED)
def test_distortion_is_kept_where_it_may_be(tmp_path: Path, line: str) -> None:
    camera = read_colmap(text_model(tmp_path, line), distorted="undistort")[0]
    coefficients = line.partition(" 20 15 ")[2]
    assert camera.distortion == tuple(map(float, f"{coefficients} 0 0 0".split()[:4]))
    assert camera.K[:2, 2].tolist() == [20, 15]
    zeros = " ".join("0" if "0." in value else value for value in line.split())
    assert read_colmap(text_model(tmp_path, zeros))[0].distortion == ()


def test_no_model(tmp_path: Path) -> None:
    for read in (read_colmap, read_points, read_tracks):
        with refuses(MissingFileError):
            read(tmp_path)


# ---- tracks of COLMAP's points

NAMES = {7: "b.png", 3: "sub/a.png"}
TRACKS = [[3, 7], [7], [], [3, 3, 7]]


def write_binary(folder: Path, tracks: list[list[int]] = TRACKS) -> None:
    images, points = struct.pack("<Q", len(NAMES)), struct.pack("<Q", len(tracks))
    for number, name in NAMES.items():
        images += struct.pack("<I7dI", number, 1, 0, 0, 0, 0, 0, 0, 1) + name.encode() + b"\0"
        images += struct.pack("<Q", 2) + struct.pack("<ddQ", 1, 2, 0) * 2
    for number, track in enumerate(tracks):
        points += struct.pack("<Q3d3BdQ", number, number, 0.5, -1, 1, 2, 3, 0.1, len(track))
        points += b"".join(struct.pack("<II", image, 9) for image in track)
    (folder / "images.bin").write_bytes(images)
    (folder / "points3D.bin").write_bytes(points)


def write_text(folder: Path) -> None:
    text_model(folder, "", "".join(f"{n} 1 0 0 0 0 0 0 1 {name}\n1.0 2.0 -1\n" for n, name in NAMES.items()))
    points = ["# comment"]
    for number, track in enumerate(TRACKS):
        points.append(f"{number} {number} 0.5 -1 1 2 3 0.1 " + " ".join(f"{image} 9" for image in track))
    (folder / "points3D.txt").write_text("\n".join(points))


@pytest.mark.parametrize("write", [write_binary, write_text])
def test_tracks_by_image_name(tmp_path: Path, write: Callable[[Path], None]) -> None:
    write(tmp_path)
    positions, tracks = read_tracks(tmp_path)
    np.testing.assert_array_equal(positions, [[n, 0.5, -1] for n in range(4)])
    assert tracks == [["sub/a.png", "b.png"], ["b.png"], [], ["sub/a.png", "b.png"]]


def test_damaged_tracks(tmp_path: Path) -> None:
    write_binary(tmp_path, [[3, 4]])
    with refuses(FileFormatError):
        read_tracks(tmp_path)
    write_binary(tmp_path)
    for name in ("points3D.bin", "images.bin"):
        whole = (tmp_path / name).read_bytes()
        for length in range(0, len(whole), 5):
            (tmp_path / name).write_bytes(whole[:length])
            with pytest.raises(FileFormatError, match=name.split(".")[0]):
                read_tracks(tmp_path)
        (tmp_path / name).write_bytes(whole)


# ---- transforms.json


def test_opengl_axes_and_defaults(tmp_path: Path) -> None:
    camera = read_transforms(transforms(tmp_path))[0]
    assert camera.name == "a.png"
    # A point in front of an OpenGL camera lies at negative z; OpenCV sees it at positive depth.
    seen = camera.viewmat.numpy() @ np.array([1.5, 2.25, -1.0, 1.0])
    np.testing.assert_allclose(seen, [0.5, -0.25, 4.0, 1.0])
    np.testing.assert_allclose(camera.position, [1, 2, 3])


OWN = {"frame": {"fl_x": 40, "fl_y": 41, "w": 64, "h": 48, "cx": 30}}


@pytest.mark.parametrize(("settings", "options", "expected"), [
    ({}, {}, [30, 30, 16, 12, 32]), ({"fl_x": None, "camera_angle_x": math.pi / 2}, {}, [16, 16, 16, 12, 32]),
    (OWN, {}, [40, 41, 30, 24, 64]), (OWN, {"by_nerfstudio": True}, [30, 41, 30, 12, 32]),
])  # fmt: skip
def test_intrinsics_of_transforms(tmp_path: Path, settings: Any, options: Any, expected: list[float]) -> None:
    with warns(ScoupWarning) if expected[0] == 40 else contextlib.nullcontext():
        camera = read_transforms(transforms(tmp_path, **settings), **options)[0]
    assert [camera.fx, camera.fy, camera.cx, camera.cy, camera.width] == pytest.approx(expected)


def test_lenses_of_transforms(tmp_path: Path) -> None:
    straight = {"is_fisheye": False, "latlong": None, "ftheta_p0": 0.0, "k3": 0.0, "camera_model": "pinhole"}
    labelled = (
        {"camera_name": "panorama_03"},
        {"panorama_name": "room"},
        {"lens_model": "fisheye, undistorted"},
    )
    for words in labelled:
        for model in ({"camera_model": "PINHOLE", "camera_type": "omni"}, {"fisheye_crop_radius": 9}):
            assert len(read_transforms(transforms(tmp_path, **words, frame=model))) == 1
    own = {"is_fisheye": True, "frame": {"is_fisheye": False, "file_path": "fisheye/a.png"}}
    for settings in (straight, own):
        assert not read_transforms(transforms(tmp_path, **settings))[0].distortion
    path = transforms(tmp_path, frame={"distortion_params": [0.1, 0.2, 0, 0, 0.3, 0.4]})
    assert read_transforms(path, "undistort")[0].distortion == (0.1, 0.2, 0.3, 0.4)
    bent = Cameras(replace(camera, distortion=(0.1, 0.0, 0.0, 0.01)) for camera in some_cameras(4))
    write_transforms(bent, path, overwrite=True)
    with refuses(FileFormatError):
        read_transforms(path)
    assert read_transforms(path, "undistort")[0].distortion == (0.1, 0.0, 0.0, 0.01)


def test_masks_of_photographs(tmp_path: Path) -> None:
    save_images(some_cameras(1), tmp_path / "masks")
    (tmp_path / "a").mkdir()
    camera = read_transforms(transforms(tmp_path, frame={"mask_path": "masks/view_00.png"}))[0]
    assert camera.mask_path == tmp_path / "masks" / "view_00.png"
    for name in ("masks/none.png", "../masks/view_00.png"):
        with warns(ScoupWarning):
            assert read_transforms(transforms(tmp_path / "a", frame={"mask_path": name}))[0].mask_path is None


def test_image_gives_size_and_extension(tmp_path: Path) -> None:
    save_images(some_cameras(1, width=20, height=10), tmp_path / "images")
    path = transforms(
        tmp_path, frame={"file_path": "images/view_00"}, w=None, h=None, fl_x=None, camera_angle_x=1.0
    )
    camera = read_transforms(path)[0]
    assert (camera.width, camera.height, camera.name) == (20, 10, "view_00.png")
    assert camera.image_path == tmp_path / "images" / "view_00.png"
    add_frame(path, "images/gone")
    with warns(ScoupWarning):
        assert len(read_transforms(path)) == 1


def add_frame(path: Path, name: str) -> None:
    """The first frame again, of another photograph."""
    content = json.loads(path.read_text())
    content["frames"].append({**content["frames"][0], "file_path": name})
    path.write_text(json.dumps(content))


def test_same_file_names_in_two_folders(tmp_path: Path) -> None:
    path = transforms(tmp_path)
    add_frame(path, "other\\a.png")
    assert read_transforms(path).names == ("images/a.png", "other/a.png")
    add_frame(path, "./images/a.png")
    with refuses(FileFormatError):
        read_transforms(path)


# ---- Inria's output


def test_cfg_args(tmp_path: Path) -> None:
    expected = {"sh_degree": 3, "source_path": "C:\\data", "images": "images", "eval": False}
    (tmp_path / "cfg_args").write_text(str(Namespace(**expected)))
    assert read_cfg_args(tmp_path / "cfg_args") == expected


def test_latest_point_cloud(tmp_path: Path) -> None:
    with refuses(MissingFileError):
        latest_point_cloud(tmp_path)
    for step in (7000, 30000, 900):
        folder = tmp_path / "point_cloud" / f"iteration_{step}"
        folder.mkdir(parents=True)
        (folder / "point_cloud.ply").write_text("x")
    (tmp_path / "point_cloud" / "iteration_best").mkdir()
    for place in (tmp_path, tmp_path / "point_cloud"):
        assert latest_point_cloud(place).parent.name == "iteration_30000"
    splat = tmp_path / "point_cloud" / "final" / "point_cloud.ply"  # of MonoGS
    splat.parent.mkdir()
    splat.write_text("x")
    assert latest_point_cloud(tmp_path) == splat
    other = tmp_path / "other" / "point_cloud" / "best" / "splat.ply"
    other.parent.mkdir(parents=True)
    other.write_text("x")
    assert latest_point_cloud(tmp_path / "other") == other
    other.with_name("second.ply").write_text("x")
    with refuses(MissingFileError):
        latest_point_cloud(tmp_path / "other")


# ---- the frame that nerfstudio trains in


@ALONE
def test_cameras_follow_the_splat_into_its_frame(tmp_path: Path) -> None:
    """nerfstudio turned, shifted and scaled the cameras of transforms.json, and wrote a record of it. A point and its
    image in its world are seen at the same pixel, at depths that differ by the scale."""
    turn, applied, scale = np.eye(4), np.vstack([APPLIED, [0, 0, 0, 1]]), 0.35
    turn[:3] = np.hstack([Rotation.from_rotvec([0.3, -0.8, 0.4]).as_matrix(), [[0.5], [-2.0], [1.5]]])
    record, cameras = tmp_path / "dataparser_transforms.json", some_cameras(4)
    record.write_text(json.dumps({"transform": (turn @ applied)[:3].tolist(), "scale": scale}))
    points = np.random.default_rng(0).normal(size=(20, 3)) * 3

    def check(path: Path, world: np.ndarray, scale: float) -> None:
        moved = load_cameras(path, dataparser_transforms=record)
        images = scale * (points @ world[:3, :3].T + world[:3, 3])
        for camera in cameras:
            seen = points @ camera.viewmat[:3, :3].numpy().T + camera.viewmat[:3, 3].numpy()
            now = moved[camera.name]
            again = images @ now.viewmat[:3, :3].numpy().T + now.viewmat[:3, 3].numpy()
            np.testing.assert_allclose(again, scale * seen, atol=1e-9)
            assert torch.equal(now.K, camera.K)

    file = tmp_path / "transforms.json"
    write_transforms(cameras, file)
    content = json.loads(file.read_text())
    for said, world, factor in (
        ({"applied_transform": APPLIED}, turn, scale),
        ({"applied_transform": APPLIED, "applied_scale": 0.5}, turn, scale / 0.5),
        # Older data do not say what was applied; nerfstudio then goes by the model beside them.
        ({}, turn @ applied, scale),
    ):
        file.write_text(json.dumps(content | said))
        check(file, world, factor)
    (tmp_path / "colmap" / "sparse" / "0").mkdir(parents=True)
    check(file, turn, scale)
    assert camera_difference(load_cameras(file), cameras) < 1e-12
    write_colmap(cameras, tmp_path / "model" / "sparse" / "0")
    check(tmp_path / "model", turn @ applied, scale)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-be", "cp1252"])
def test_encodings_of_text(tmp_path: Path, encoding: str, recwarn: pytest.WarningsRecorder) -> None:
    mark = b"\xfe\xff" if encoding == "utf-16-be" else b""
    (tmp_path / "words.txt").write_bytes(mark + "Küche\r\n".encode(encoding))
    assert read_text(tmp_path / "words.txt").split() == ["Küche"]
    assert len(recwarn) == (encoding == "cp1252")


@pytest.mark.parametrize("binary", [True, False])
def test_image_names_of_another_code_page(tmp_path: Path, binary: bool) -> None:
    (write_colmap if binary else write_colmap_text)(some_cameras(1), tmp_path / "sparse/0")
    path = tmp_path / "sparse/0" / ("images.bin" if binary else "images.txt")
    path.write_bytes(path.read_bytes().replace(b"view_00.png", b"K\xfcche.png"))
    with warns(ScoupWarning):
        assert load_cameras(tmp_path, missing_images="keep").names == ("Küche.png",)


@pytest.mark.parametrize(("file", "old", "new"), [
    ("cameras.txt", "# ", " \t# "), ("images.txt", "\n1 ", "\n1.0 "), ("cameras.txt", " 32 24 ", " 32.0 24. "),
    ("images.txt", "\n\n", "\n 1.5 2.5 -1.0\n"), ("images.txt", ".png\n\n", "\n"),
    ("images.txt", ".png\n\n", "\n1 2 3 4 5 6\n"),
])  # fmt: skip
def test_text_models_of_other_programs(tmp_path: Path, file: str, old: str, new: str) -> None:
    cameras = Cameras(
        replace(camera, name=f"{number:06}.png") for number, camera in enumerate(some_cameras(4))
    )
    write_colmap_text(cameras, tmp_path)
    text = (tmp_path / file).read_text()
    (tmp_path / file).write_text(text.replace(old, new))
    found = load_cameras(tmp_path, missing_images="keep")
    for one, other in zip(found, cameras, strict=True):
        assert one.name in (other.name, other.stem)
        assert torch.equal(one.K, other.K)
        torch.testing.assert_close(one.viewmat, other.viewmat)


@pytest.mark.parametrize("binary", [True, False])
def test_of_several_models_the_largest(tmp_path: Path, binary: bool) -> None:
    for number, count in enumerate((1, 3, 2)):
        (write_colmap if binary else write_colmap_text)(some_cameras(count), tmp_path / f"sparse/{number}")
    with warns(ScoupWarning):
        assert len(load_cameras(tmp_path, missing_images="keep")) == 3
    assert len(load_cameras(tmp_path / "sparse/2", missing_images="keep")) == 2
    write_colmap_text(some_cameras(3, seed=1), tmp_path / "sparse/2")
    if binary:
        write_colmap(some_cameras(3, seed=1), tmp_path / "sparse/2", overwrite=True)
    for read in (load_cameras, find_photographs):
        with refuses(FileFormatError):
            read(tmp_path)


@pytest.mark.parametrize("name", ["colmap", "sparse", "0", "colmap/colmap"])
def test_scenes_with_names_of_parts(tmp_path: Path, name: str) -> None:
    write_colmap(some_cameras(2), tmp_path / name / "sparse/0")
    save_images(some_cameras(2), tmp_path / name / "images")
    for path in (tmp_path / name, tmp_path / name / "sparse/0"):
        assert [item.path.parent for item in find_photographs(path)] == [tmp_path / name / "images"] * 2


@pytest.mark.parametrize("format", ["colmap", "transforms"])
@pytest.mark.parametrize("ending", [".HEIC", ".jxl", ".NEF"])
def test_converted_photographs(tmp_path: Path, format: str, ending: str) -> None:
    cameras = Cameras(replace(camera, name=f"{camera.stem}{ending}") for camera in some_cameras(2))
    save_images(some_cameras(2), tmp_path / "images")
    (tmp_path / "images" / cameras[0].name).write_bytes(b"original")
    if format == "colmap":
        write_colmap(cameras, tmp_path / "sparse/0")
    else:
        write_transforms(cameras, tmp_path / "transforms.json")
    assert [item.path.suffix for item in find_photographs(tmp_path)] == [".png"] * 2
    for photograph in tmp_path.glob("images/*.png"):
        photograph.rename(photograph.with_suffix(ending)).write_bytes(b"original")
    with warns(ScoupWarning):
        load_cameras(tmp_path)
    with refuses(MissingFileError):
        find_photographs(tmp_path / "images")


def test_one_line_per_image(tmp_path: Path) -> None:
    cameras = some_cameras(4)
    write_colmap_text(cameras, tmp_path)
    path = tmp_path / "images.txt"
    lines = [line for line in path.read_text().splitlines() if line]
    path.write_text("\n".join([*lines[:-1], "1.5 2.5 7 3 4 -1", lines[-1], ""]))
    (tmp_path / "points3D.txt").write_text("7 0 0 0 1 2 3 0 3 0\n")
    assert camera_difference(load_cameras(tmp_path, missing_images="keep"), cameras) < 1e-12
    assert read_tracks(tmp_path)[1] == [["view_02.png"]]


@pytest.mark.parametrize(("end", "gone", "has"), [(".bin", "images", "cameras"), (".txt", "images", "cameras"),
                                                  (".bin", "cameras", "images")])  # fmt: skip
def test_half_a_colmap_model(tmp_path: Path, end: str, gone: str, has: str) -> None:
    (write_colmap_text if end == ".txt" else write_colmap)(some_cameras(2), tmp_path / "sparse/0")
    (tmp_path / "sparse/0" / f"{gone}{end}").unlink()
    for folder in (tmp_path, tmp_path / "sparse/0"):
        with refuses(MissingFileError):
            load_cameras(folder)
