"""Files as other people's programs write them: encodings, headers, and kinds of the same thing."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from io_samples import (
    camera_difference,
    ply_file,
    raw_columns,
    same_gaussians,
    save_images,
    some_cameras,
    some_gaussians,
    write_colmap_text,
)
from messages import refuses, warns
from scoup.base import FileFormatError, MissingFileError, ScoupWarning, UnknownNameError
from scoup.extract import find_photographs
from scoup.io import (
    as_stored,
    load_cameras,
    load_gaussians,
    save_gaussians,
    write_colmap,
    write_transforms,
)
from scoup.io.cameras.colmap import read_tracks
from scoup.io.reading import read_text
from scoup.io.splats.ply import PlyTable
from scoup.scene import SH_C0, Cameras


@pytest.mark.parametrize("line", [
    *(f"comment {text}".encode() for text in ("by Ångström lab", "/全景/光学.jpg", "Συντάκτης", "хлеб")),
    b"comment scan\x85 final", "obj_info Ångström".encode(), "comment 部屋".encode("shift_jis"),
    "property float scalar_voilà".encode(),
])  # fmt: skip
def test_ply_headers_of_any_text(tmp_path: Path, line: bytes) -> None:
    given = some_gaussians(3, 0)
    save_gaussians(given, tmp_path / "a.ply")
    content = (tmp_path / "a.ply").read_bytes()
    rows = 0
    if line.startswith(b"property"):
        head, body = content.split(b"end_header\n", 1)
        rows = len(body) // 3
        body = b"".join(body[rows * row : rows * (row + 1)] + b"\0\0\0\0" for row in range(3))
        content = head + line + b"\nend_header\n" + body
    else:
        content = content.replace(b"element", line + b"\nelement", 1)
    (tmp_path / "a.ply").write_bytes(b"\xef\xbb\xbf" + content)
    assert same_gaussians(load_gaussians(tmp_path / "a.ply"), as_stored(given))


@pytest.mark.parametrize("nan", [b"nan", b"-nan(ind)", b"1.#QNAN", b"-1.#IND00", b"1.#INF"])
def test_numbers_of_ascii_ply_files(tmp_path: Path, nan: bytes) -> None:
    path = ply_file(tmp_path / "a.ply", dict.fromkeys(raw_columns(2), np.full(2, 0.5, np.float32)), "ascii")
    row = b" ".join([b"0.5"] * 14)
    content = path.read_bytes().replace(row + b"\n" + row + b"\n", b"\xef\xbb\xbf" + row + b"\n")
    (tmp_path / "a.ply").write_bytes(content + row.replace(b"0.5", nan, 1))
    with warns(ScoupWarning):
        assert len(load_gaussians(tmp_path / "a.ply")) == 1
    (tmp_path / "a.ply").write_bytes(content + row.replace(b"0.5", b"0,5"))
    with refuses(FileFormatError):
        load_gaussians(tmp_path / "a.ply")


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


@pytest.mark.parametrize(("end", "gone", "has"), [(".bin", "images", "cameras"), (".txt", "images", "cameras"),
                                                  (".bin", "cameras", "images")])  # fmt: skip
def test_half_a_colmap_model(tmp_path: Path, end: str, gone: str, has: str) -> None:
    (write_colmap_text if end == ".txt" else write_colmap)(some_cameras(2), tmp_path / "sparse/0")
    (tmp_path / "sparse/0" / f"{gone}{end}").unlink()
    for folder in (tmp_path, tmp_path / "sparse/0"):
        with refuses(MissingFileError):
            load_cameras(folder)


def test_cameras_are_found_by_names_of_any_form() -> None:
    names = ("cam1/0.png", "cam2/0.png", "K\u00fcche.a.png")
    cameras = Cameras(replace(each, name=name) for each, name in zip(some_cameras(3), names, strict=True))
    assert cameras["cam1/0"] is cameras["cam1/0.png"] is cameras[0]
    for name in ("Ku\u0308che.a", "Ku\u0308che.a.png", "Ku\u0308che"):
        assert cameras[name] is cameras[2]
    with refuses(UnknownNameError):
        cameras["0"]


def changed_columns(path: Path, gone: str, **added: np.ndarray) -> None:
    """Rewrite a PLY without some properties, and with others."""
    table = PlyTable.read(path)
    kept = [name for name in table.names if not re.fullmatch(gone, name)]
    table = replace(table, rows=table.rows[kept].astype([(name, table.rows.dtype[name]) for name in kept]))
    for name, column in added.items():
        table = table.with_column(name, column)
    table.write(path, overwrite=True)


@pytest.mark.parametrize(("gone", "added", "change"), [
    ("scale_2", {}, {"scales": lambda given: torch.cat([given.scales[:, :2], torch.full((5, 1), 1e-6)], 1)}),
    ("scale_[12]", {}, {"scales": lambda given: given.scales[:, :1].expand(-1, 3)}),
    ("f_dc_.", {"red": 255, "green": 0, "blue": 51}, {}),
    ("f_dc_.", {"red": 1.0, "green": 0.0, "blue": 0.2}, {}),
    ("f_dc_.", {"red": 65535, "green": 0, "blue": 13107}, {}),
])  # fmt: skip
def test_splats_with_other_properties(tmp_path: Path, gone: str, added: Any, change: Any) -> None:
    given = some_gaussians(5, 1)
    save_gaussians(given, tmp_path / "a.ply")
    kinds = {float: np.float32, int: np.uint16 if 65535 in added.values() else np.uint8}
    columns = {name: np.full(5, value, kinds[type(value)]) for name, value in added.items()}
    changed_columns(tmp_path / "a.ply", gone, **columns)
    found = load_gaussians(tmp_path / "a.ply")
    expected = given.tensors() | {name: function(given) for name, function in change.items()}
    if added:
        expected["sh"] = given.sh.clone()
        expected["sh"][:, 0] = (torch.tensor([1.0, 0.0, 0.2]) - 0.5) / SH_C0
    for name, tensor in found.tensors().items():
        torch.testing.assert_close(tensor, expected[name], rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize(
    "name", ["trbf_center", "trbf_scale_0", "motion_3", "t", "scale_3", "nu_degree", "beta"]
)
def test_gaussians_that_are_not_plain(tmp_path: Path, name: str) -> None:
    save_gaussians(some_gaussians(5, 0), tmp_path / "a.ply")
    changed_columns(tmp_path / "a.ply", "", semantic_0=np.zeros(5), label=np.zeros(5, np.int32))
    assert len(load_gaussians(tmp_path / "a.ply")) == 5
    changed_columns(tmp_path / "a.ply", "", **{name: np.zeros(5, np.float32)})
    with warns(ScoupWarning):
        load_gaussians(tmp_path / "a.ply")
