"""Files as other people's programs write them: encodings, headers, and kinds of the same thing."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest

from io_samples import camera_difference, same_gaussians, some_cameras, some_gaussians
from scoup.base.errors import FileFormatError, ScoupWarning
from scoup.io import as_stored, load_cameras, load_gaussians, save_gaussians, write_colmap
from scoup.io.cameras.colmap import read_tracks
from scoup.io.reading import read_text


@pytest.mark.parametrize(
    "line",
    [
        *(f"comment {text}".encode() for text in ("by Ångström lab", "/全景/光学.jpg", "Συντάκτης", "хлеб")),
        b"comment scan\x85 final",
        "obj_info Ångström".encode(),
        "comment 部屋".encode("shift_jis"),
        "property float scalar_voilà".encode(),
    ],
)
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
    names = ["x", "y", "z", *(f"f_dc_{n}" for n in range(3)), "opacity", *(f"scale_{n}" for n in range(3))]
    names += [f"rot_{n}" for n in range(4)]
    head = ["ply", "format ascii 1.0", "element vertex 2", *(f"property float {name}" for name in names)]
    row = b" ".join([b"0.5"] * 14)
    content = "\n".join([*head, "end_header", ""]).encode() + b"\xef\xbb\xbf" + row + b"\n"
    (tmp_path / "a.ply").write_bytes(content + row.replace(b"0.5", nan, 1))
    with pytest.warns(ScoupWarning, match="dropped 1 of 2"):
        assert len(load_gaussians(tmp_path / "a.ply")) == 1
    (tmp_path / "a.ply").write_bytes(content + row.replace(b"0.5", b"0,5"))
    with pytest.raises(FileFormatError, match=r"has '0,5' in place of a number \(row 2\)"):
        load_gaussians(tmp_path / "a.ply")


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-be", "cp1252"])
def test_encodings_of_text(tmp_path: Path, encoding: str, recwarn: pytest.WarningsRecorder) -> None:
    mark = b"\xfe\xff" if encoding == "utf-16-be" else b""
    (tmp_path / "words.txt").write_bytes(mark + "Küche\r\n".encode(encoding))
    assert read_text(tmp_path / "words.txt").split() == ["Küche"]
    assert len(recwarn) == (encoding == "cp1252")


@pytest.mark.parametrize("binary", [True, False])
def test_image_names_of_another_code_page(tmp_path: Path, binary: bool) -> None:
    write_colmap(some_cameras(1), tmp_path / "sparse/0", text=not binary)
    path = tmp_path / "sparse/0" / ("images.bin" if binary else "images.txt")
    path.write_bytes(path.read_bytes().replace(b"view_00.png", b"K\xfcche.png"))
    with pytest.warns(ScoupWarning, match="is not in UTF-8"):
        assert load_cameras(tmp_path, missing_images="keep").names == ("Küche.png",)


@pytest.mark.parametrize(("number", "model", "parameters"), [
    (12, "SIMPLE_DIVISION", 4), (13, "DIVISION", 5), (14, "SIMPLE_FISHEYE", 3), (15, "FISHEYE", 4), (16, "EUCM", 6),
    (17, "EQUIRECTANGULAR", 2), (99, "99", 4),
])  # fmt: skip
def test_lenses_of_colmap_4(tmp_path: Path, number: int, model: str, parameters: int) -> None:
    remedy = "panorama_sfm" if model == "EQUIRECTANGULAR" else "colmap image_undistorter"
    for text in (False, True):
        folder = tmp_path / str(text) / "sparse/0"
        write_colmap(some_cameras(1), folder, text=text)
        if text:
            (folder / "cameras.txt").write_text(f"1 {model} 480 360 " + "433 " * parameters)
        else:
            lens = struct.pack(f"<QiiQQ{parameters}d", 1, 1, number, 480, 360, *[433.0] * parameters)
            (folder / "cameras.bin").write_bytes(lens)
        with pytest.raises(FileFormatError, match=f"camera.* model {model}.*{remedy}"):
            load_cameras(folder)


def test_one_line_per_image(tmp_path: Path) -> None:
    cameras = some_cameras(4)
    write_colmap(cameras, tmp_path, text=True)
    path = tmp_path / "images.txt"
    lines = [line for line in path.read_text().splitlines() if line]
    path.write_text("\n".join([*lines[:-1], "1.5 2.5 7 3 4 -1", lines[-1], ""]))
    (tmp_path / "points3D.txt").write_text("7 0 0 0 1 2 3 0 3 0\n")
    assert camera_difference(load_cameras(tmp_path, missing_images="keep"), cameras) < 1e-12
    assert read_tracks(tmp_path)[1] == [["view_02.png"]]
