"""Damaged files of every format are refused, each in the words of the snapshot. Those of splats: splat_damages.py."""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import splat_damages
from safetensors.numpy import load_file, save
from splat_damages import Change, Kind, altered, written
from tests.fuzzing.containers import SEALED

from io_samples import (
    APPLIED,
    DISTORTED,
    POINT_HEADER,
    TURNED,
    planes_of,
    save_compact,
    save_images,
    save_npy,
    some_cameras,
    text_model,
    transforms,
    unit_rows,
    write_colmap_text,
    write_inria_cameras,
)
from messages import refuses
from scoup.base import FileFormatError, MissingFileError
from scoup.io import load_cameras, load_regions, read_points, read_similarity, read_tracks
from scoup.io.cameras.colmap import read_colmap
from scoup.io.cameras.inria import read_cfg_args, read_inria_cameras
from scoup.io.cameras.nerfstudio import read_transforms
from scoup.io.cameras.trained_frame import in_trained_frame
from scoup.io.images import image_size
from scoup.io.regions.manifest import MANIFEST
from scoup.scene import LEVELS
from scoup_lab.data.colmap_model import write_colmap
from scoup_lab.data.labelled_points import read_labelled_ply

CAMERA = some_cameras(1)

# ---- cameras

TRANSFORMS = {
    "fisheye": {"camera_model": "OPENCV_FISHEYE"}, "is_fisheye": {"is_fisheye": True}, "latlong": {"latlong": True},
    "fisheye frame": {"frame": {"is_fisheye": True}}, "equirectangular": {"equirectangular": 1},
    "ftheta": {"ftheta_p0": 0.0, "ftheta_p1": 0.02}, "spherical": {"camera_type": "spherical"}, "k3": {"k3": 0.1},
    "k6": {"k6": 0.1}, "parameters": {"distortion_params": [0.1, 0, 0.2, 0, 0, 0]},
    "two parameters": {"distortion_params": [0.1, 0.2]}, "no length": {"fl_x": None}, "w 0": {"w": 0},
    "w large": {"w": 10**12}, "w 2.5": {"w": 2.5}, "wide": {"fl_x": "wide"}, "negative": {"fl_x": -3},
    "nan": {"cx": float("nan")}, "no size": {"h": None}, "2 x 2": {"frame": {"transform_matrix": [[1, 2], [3, 4]]}},
    "scaled": {"frame": {"transform_matrix": np.diag([2.0, 2, 2, 1]).tolist()}},
    "no pose": {"frame": {"transform_matrix": None}}, "path": {"frame": {"file_path": 3}}, "no frame": {"frames": []},
    "no frames": {"frames": None},
}  # fmt: skip
JSON = {
    "empty": b"", "open": b"[1, 2", "number": b"[1]", "object": b"{}", "deep": b"[" * 100_000, "zero": b"\0",
    "digits": b'{"a": 1' + b"0" * 5000 + b"}", "no text": b"\xff\x00[",
}  # fmt: skip
CFG_ARGS = {
    "empty": b"", "open": b"Namespace(", "call": b"Namespace(a=open('x'))", "import": b"__import__('os')",
    "other": b"Other(a=1)", "deep": b"(" * 5000,
}  # fmt: skip


def cut_names(folder: Path, name: str) -> Path:
    """Cameras whose names Inria's code has cut to one."""
    write_inria_cameras(some_cameras(2), folder / "cameras.json")
    text = re.sub(r"view_0[01]\.png", name, (folder / "cameras.json").read_text())
    return text_file("cameras.json", folder, text)


def damaged_model(folder: Path, damage: tuple[str, Change]) -> Path:
    points = np.ones((2, 3)), np.ones((2, 3), np.uint8)
    return altered(damage[0], lambda _: write_colmap(some_cameras(2), folder, points))(
        folder, damage[1]
    ).parent


MODEL = {
    "images cut": ("images.bin", lambda whole: whole[:-3]), "no images": ("images.bin", lambda _: struct.pack("<Q", 0)),
    "images claimed": ("images.bin", lambda whole: struct.pack("<Q", 10**12) + whole[8:]),
    "no lenses": ("cameras.bin", lambda _: struct.pack("<Q", 0)),
}  # fmt: skip
POINTS = {"claimed": ("points3D.bin", lambda whole: whole[:-8] + struct.pack("<Q", 2**60))}
UNKNOWN = {
    "fisheye": "1 OPENCV_FISHEYE 40 30 50 50 20 15 0 0 0 0", "FOV": "1 FOV 40 30 50 50 20 15 1", "own": "1 MYOWN 4 3 1",
}  # fmt: skip
LENSES = {
    "SIMPLE_DIVISION": (12, 4), "DIVISION": (13, 5), "SIMPLE_FISHEYE": (14, 3), "FISHEYE": (15, 4), "EUCM": (16, 6),
    "EQUIRECTANGULAR": (17, 2), "99": (99, 4),
}  # fmt: skip


def lens_of_colmap_4(folder: Path, lens: tuple[int, int]) -> Path:
    write_colmap(CAMERA, folder)
    row = struct.pack(f"<QiiQQ{lens[1]}d", 1, 1, lens[0], 480, 360, *[433.0] * lens[1])
    return written("cameras.bin", folder, row).parent


def impossible_lens(folder: Path, line: str) -> Path:
    """Of cameras that are brought to the size of their images, half of their own."""
    write_colmap_text(CAMERA, folder / "sparse" / "0")
    save_images(CAMERA, folder / "images", divisor=2)
    text_file("sparse/0/cameras.txt", folder, line)
    return folder


IMPOSSIBLE = {
    "lengths": "1 PINHOLE 32 24 5e-324 5e-324 16 12\n",
    "size": "1 PINHOLE 100000 75000 9 9 16 12\n",
}


def damaged_tracks(folder: Path, line: str) -> Path:
    text_model(folder, "1 PINHOLE 32 24 9 9 16 12", "3 1 0 0 0 0 0 0 1 a.png\n\n")
    return text_file("points3D.txt", folder, line).parent


TRACKS = {
    "short": "1 2", "words": "1 a b c 1 2 3 0.1 3 9", "no image": "1 0 0 0 1 2 3 0.1 99 9",
    "large": f"1 0 0 0 1 2 3 0.1 {10**30} 9",
}  # fmt: skip

# ---- transforms

SHEARED = TURNED @ (np.eye(4) + 0.1 * np.eye(4, k=1))
PROJECTIVE = TURNED + 0.5 * np.eye(4)[[0, 1, 2, 2]] * [[0], [0], [0], [1]]
SIMILARITIES: dict[str, Any] = {
    "short": "1 0 0 0\n0 1 0 0\n0 0 1\n0 0 0 1", "word": "1 0 0 0\n0 1 0 x\n0 0 1 0\n0 0 0 1", "empty": "",
    "rows": json.dumps(TURNED[:3].tolist()), "mirrored": json.dumps((TURNED @ np.diag([-1, 1, 1, 1])).tolist()),
    "sheared": json.dumps(SHEARED.tolist()), "projective": json.dumps(PROJECTIVE.tolist()),
    "zero": json.dumps((0 * TURNED).tolist()),
}  # fmt: skip
FRAMES: dict[str, Any] = {
    "list": [], "no transform": {"scale": 1.0}, "no scale": {"transform": APPLIED},
    "scale 0": {"transform": APPLIED, "scale": 0},
    "scaled": {"transform": [[0.0, 2, 0, 0], [2, 0, 0, 0], [0, 0, -2, 0]], "scale": 1.0},
    "mirrored": {"transform": np.eye(4)[[1, 0, 2]].tolist(), "scale": 1.0},
    "huge": {"transform": [[1e200, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]], "scale": 1.0},
    "far": {"transform": [[1, 0, 0, 1e308], [0, 1, 0, 1e308], [0, 0, 1, 1e308]], "scale": 1e300},
}  # fmt: skip

# ---- regions


def damaged_view(folder: Path, planes: np.ndarray | None = None, rows: np.ndarray | None = None) -> Path:
    return save_npy(
        folder, "view_00", PLANES if planes is None else planes, unit_rows(4) if rows is None else rows
    )


def load_view(folder: Path) -> None:
    regions = load_regions(folder, CAMERA)
    for level in LEVELS:
        regions.load("view_00.png", level)


PLANES = planes_of([0], [1], [2], [3])
LABELS = {
    "beyond": planes_of([0], [1], [2], [4]), "negative": planes_of([0], [1], [2], [-2]),
    "overlap": planes_of([0], [1, 2], [2], [3]), "order": planes_of([0], [3], [2], [1]), "halves": PLANES + 0.25,
    "nan": PLANES * np.float32("nan"), "inf": PLANES + np.float32("inf"), "three": PLANES[:3],
    "other image": planes_of([0], [1], [2], [3], width=30), "no pixels": PLANES[:, :0], "one": PLANES[0],
}  # fmt: skip
ROWS = {
    "nan": np.where(np.arange(16).reshape(4, 4) == 4, np.float32("nan"), unit_rows(4)), "one": unit_rows(4)[0],
    "inf": np.where(np.arange(16).reshape(4, 4) == 4, np.float32("inf"), unit_rows(4)),
    "integers": unit_rows(4).astype(np.int32), "no dimension": np.zeros((4, 0), np.float32),
    "objects": np.array([{"a": 1}] * 4),
}  # fmt: skip


def damaged_header(folder: Path, change: dict[str, Any]) -> Path:
    """A file with a header of other values, and checksums that fit."""
    save_compact(folder, CAMERA, bits=16)
    whole = (folder / "view_00.regions").read_bytes()
    header, body = SEALED.split(whole)
    parts = [json.dumps({**json.loads(header), **change}).encode(), body]
    return written("view_00.regions", folder, SEALED.join(whole, parts)).parent


def damaged_embeddings(folder: Path, change: Callable[[np.ndarray], np.ndarray]) -> Path:
    """Of the small level."""
    header = SEALED.split(damaged_header(folder, {}).joinpath("view_00.regions").read_bytes())[0]
    tensors = load_file(folder / "view_00.regions")
    tensors["embeddings.s"] = change(tensors["embeddings.s"])
    whole = save(tensors, {"scoup": header.decode()})
    return written("view_00.regions", folder, SEALED.join(whole, SEALED.split(whole))).parent


HEADERS: dict[str, dict[str, Any]] = {
    "size": {"width": 90_000, "height": 90_000}, "larger": {"width": 33, "height": 25},
    "smaller": {"width": 31, "height": 23}, "width 0": {"width": 0}, "no levels": {"levels": []},
    "other levels": {"levels": ["s", "m", "x"]}, "two levels": {"levels": ["s", "m"]}, "version 2": {"version": 2},
    "version text": {"version": "1"}, "schema": {"schema": "other"},
}  # fmt: skip
EMBEDDINGS = {"rows": lambda rows: rows[:2], "nan": lambda rows: rows * np.float16(np.nan)}


def damaged_manifest(folder: Path, text: str) -> Path:
    save_compact(folder, CAMERA)
    return text_file(MANIFEST, folder, text).parent


MANIFESTS = {
    "open": "{", "list": "[]", "version 9": '{"schema": "scoup.regions", "version": 9}',
    "layout": '{"schema": "scoup.regions", "version": 1, "layout": "other", "settings": {}, "embedding_model": "a"}',
}  # fmt: skip

# ---- labelled points

TEXT = POINT_HEADER.format(encoding="ascii", count=1)
LABELLED = {
    "no label": TEXT.replace("property ushort label\n", "") + "1 2 3 0 0 0 255\n3 0 0 0\n",
    "halves": TEXT.replace("ushort label", "float label") + "1 2 3 0 0 0 255 7.5\n3 0 0 0\n",
    "nan": TEXT + "1 nan 3 0 0 0 255 7\n3 0 0 0\n",
    "cut": POINT_HEADER.format(encoding="binary_little_endian", count=1_000_000_000) + "\0" * 100,
}
PICTURES = {
    "HEIC": b"\0\0\0\x18ftypheic\0\0\0\0mif1heic", "AVIF": b"\0\0\0\x20ftypavif\0\0\0\0avifmif1",
    "AVIF by its brands": b"\0\0\0\x20ftypmif1\0\0\0\0mif1avif", "JPEG XL": b"\xff\x0a\0",
    "CR3": b"\0\0\0\x18ftypcrx \0",
    "boxed JPEG XL": b"\0\0\0\x0cJXL \r\n\x87\n", "JPEG 2000": b"\0\0\0\x0cjP  \r\n\x87\n",
    "bare JPEG 2000": b"\xff\x4f\xff\x51\0", "OpenEXR": b"v/1\x01\2\0\0\0",
}  # fmt: skip
PROGRAM = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n%%EndComments\n%%EOF\n"


def text_file(name: str, folder: Path, text: str) -> Path:
    return written(name, folder, text.encode())


KINDS = {
    "transforms.json": Kind(lambda folder, changes: transforms(folder, **changes), read_transforms, TRANSFORMS),
    "cameras.json": Kind(partial(written, "cameras.json"), read_inria_cameras, JSON),
    "names of Inria's": Kind(cut_names, load_cameras, {"0000": "0000"}),
    "cfg_args": Kind(partial(written, "cfg_args"), read_cfg_args, CFG_ARGS),
    "COLMAP": Kind(damaged_model, read_colmap, MODEL),
    "points of COLMAP": Kind(damaged_model, read_points, POINTS),
    "tracks of COLMAP": Kind(damaged_model, read_tracks, POINTS),
    "text of COLMAP": Kind(text_model, read_colmap, DISTORTED),
    "other text of COLMAP": Kind(text_model, partial(read_colmap, distorted="undistort"), UNKNOWN),
    "lens of COLMAP": Kind(lens_of_colmap_4, load_cameras, LENSES),
    "named lens of COLMAP": Kind(
        text_model, load_cameras,
        {name: f"1 {name} 480 360 " + "433 " * count for name, (_, count) in LENSES.items()}),
    "impossible lens": Kind(impossible_lens, load_cameras, IMPOSSIBLE),
    "no rotation": Kind(
        lambda folder, line: text_model(folder, "1 SIMPLE_PINHOLE 40 30 50 20 15", line), read_colmap,
        {"zero": "1 0 0 0 0 0 0 0 1 a.jpg\n\n"}),
    "tracks": Kind(damaged_tracks, read_tracks, TRACKS),
    "similarity": Kind(partial(text_file, "t.txt"), read_similarity, SIMILARITIES),
    "trained frame": Kind(
        lambda folder, record: text_file("a.json", folder, json.dumps(record)),
        lambda path: in_trained_frame(some_cameras(2), path), FRAMES),
    "labels": Kind(damaged_view, load_view, LABELS),
    "embeddings": Kind(lambda folder, rows: damaged_view(folder, rows=rows), load_view, ROWS),
    "header of regions": Kind(damaged_header, load_view, HEADERS),
    "embeddings of regions": Kind(damaged_embeddings, load_view, EMBEDDINGS),
    "manifest": Kind(damaged_manifest, load_view, MANIFESTS),
    "labelled points": Kind(partial(text_file, "a.ply"), read_labelled_ply, LABELLED),
    "photograph": Kind(partial(written, "a.png"), image_size, {"program": PROGRAM, **PICTURES}),
}  # fmt: skip


KINDS |= splat_damages.KINDS
CASES = [(name, damage) for name, kind in KINDS.items() for damage in kind.damages]


@pytest.mark.parametrize(("kind", "damage"), CASES)
def test_damaged_files_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str, damage: str
) -> None:
    path = KINDS[kind].make(tmp_path, KINDS[kind].damages[damage])
    with refuses(FileFormatError) as error:
        KINDS[kind].read(path)
    assert isinstance(error.value, FileFormatError)
    assert error.value.remedy
    assert "\n" not in str(error.value)
    assert not capsys.readouterr().out  # nothing in the file was run


@pytest.mark.parametrize("kind", KINDS)
def test_missing_files_are_named(tmp_path: Path, kind: str) -> None:
    with refuses(MissingFileError):
        KINDS[kind].read(tmp_path / "none")
