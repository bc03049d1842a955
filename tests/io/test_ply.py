"""PLY: layout, activation, rows kept as they are, and large files; compressed PLY, .splat, labelled points."""

from __future__ import annotations

import contextlib
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from splat_damages import record, stored_as_they_are

from io_samples import (
    POINT_HEADER,
    ply_file,
    raw_columns,
    same_gaussians,
    save_compressed_ply,
    save_spz,
    some_gaussians,
)
from messages import refuses, warns
from scoup.base import FileFormatError, MissingFileError, OutputExistsError, ScoupWarning, WriteError
from scoup.io import load_gaussians, save_gaussians
from scoup.io.splats import ply, ply_rows
from scoup.io.splats.activation import (
    logits_from_opacities,
    logs_from_scales,
    opacities_from_logits,
    scales_from_logs,
)
from scoup.io.splats.ply import PlyTable, read_ply, write_ply
from scoup.io.splats.splat import read_splat
from scoup.scene import SH_C0, Gaussians
from scoup_lab.data.labelled_points import LabelledPoints, read_labelled_ply, write_labelled_ply
from support import random_gaussians

RAW = st.floats(width=32, allow_nan=False)


@given(arrays.arrays(np.float32, 16, elements=RAW))
def test_every_raw_scale_and_opacity_survives(raw):
    scales, opacities = scales_from_logs(raw), opacities_from_logits(raw)
    assert np.array_equal(scales_from_logs(logs_from_scales(scales)), scales)
    assert np.array_equal(opacities_from_logits(logits_from_opacities(opacities)), opacities)


def test_activation_and_layout(tmp_path):
    columns = raw_columns(3, rest=9)
    gaussians = read_ply(ply_file(tmp_path / "a.ply", columns))
    np.testing.assert_allclose(gaussians.scales[:, 1], np.exp(columns["scale_1"]), rtol=1e-6)
    np.testing.assert_allclose(gaussians.opacities, 1 / (1 + np.exp(-columns["opacity"])), rtol=1e-6)
    quats = np.stack([columns[f"rot_{part}"] for part in range(4)], 1)
    np.testing.assert_allclose(
        gaussians.quats, quats / np.linalg.norm(quats, axis=1, keepdims=True), rtol=1e-5
    )
    # f_rest is channel-major: green's second coefficient is number 1 * 3 + 1.
    assert np.array_equal(gaussians.sh[:, 2, 1], columns["f_rest_4"])


def test_order_extras_and_types_do_not_matter(tmp_path):
    columns = raw_columns(6, rest=24)
    plain = read_ply(ply_file(tmp_path / "a.ply", columns))
    shuffled = dict(sorted(columns.items(), key=lambda item: item[0][::-1]))
    added = {"label": np.arange(6, dtype=np.int32), "voilà": np.zeros(6, np.uint8)}
    doubles = {name: values.astype(np.float64) for name, values in columns.items()}
    for number, (other, encoding) in enumerate([
        ({**added, **shuffled, "red": np.zeros(6, np.uint8)}, "binary_little_endian"),
        (doubles, "binary_little_endian"), (columns, "binary_big_endian"), (columns, "ascii"),
    ]):  # fmt: skip
        assert same_gaussians(plain, read_ply(ply_file(tmp_path / f"{number}.ply", other, encoding)))


@pytest.mark.parametrize("names", ["opacity|scale_.", "opacity", "scale_.", "none"])
def test_scales_and_opacities_as_they_are(tmp_path, names):
    found = load_gaussians(stored_as_they_are(tmp_path, names), activated=True)
    raw = raw_columns(60, seed=1)
    scales = np.exp(np.stack([raw[f"scale_{axis}"] for axis in range(3)], 1) - 3 * ("scale" in names))
    opacities = 1 / (1 + np.exp(-raw["opacity"] * (3 if "opacity" in names else 1)))
    np.testing.assert_allclose(found.scales, scales, rtol=1e-5)
    np.testing.assert_allclose(found.opacities, opacities, rtol=1e-5)
    save_gaussians(found, tmp_path / "b.ply")
    torch.testing.assert_close(
        found.tensors(), load_gaussians(tmp_path / "b.ply").tensors(), rtol=1e-5, atol=1e-6
    )
    save_gaussians(found, tmp_path / "b.splat")
    with refuses():
        load_gaussians(tmp_path / "b.splat", activated=True)


def test_the_filter_of_mip_splatting_is_applied(tmp_path):
    columns = raw_columns(5)
    columns["filter_3D"] = np.array([0, 0.05, 0.5, 1e-3, 7], np.float32)
    found = read_ply(ply_file(tmp_path / "a.ply", columns))
    filters = columns.pop("filter_3D")
    raw = read_ply(ply_file(tmp_path / "b.ply", columns))
    before = raw.scales.double() ** 2
    after = before + torch.from_numpy(filters).double()[:, None] ** 2
    torch.testing.assert_close(found.scales, after.sqrt().float())
    weaker = (before.prod(1) / after.prod(1)).sqrt()
    torch.testing.assert_close(found.opacities, (raw.opacities * weaker).float())
    assert (found.antialiased, raw.antialiased) == (True, False)


@pytest.mark.parametrize(
    ("comment", "antialiased"),
    [("SplatRenderMode: mip", True), ("SplatRenderMode: default", False), ("antialiased 1", True)],
)
def test_antialiasing_is_kept_by_ply_and_spz(tmp_path, comment, antialiased):
    table = replace(PlyTable.of(some_gaussians(3)), comments=(comment,))
    table.write(tmp_path / "a.ply")
    gaussians = load_gaussians(tmp_path / "a.ply")
    for name in ("b.ply", "b.compressed.ply", "b.spz"):
        save_gaussians(gaussians.select([0, 1]), tmp_path / name)
        assert load_gaussians(tmp_path / name).antialiased == antialiased, name
    save_spz(gaussians, tmp_path / "c.spz", 4)
    assert load_gaussians(tmp_path / "c.spz", keep_axes=True).antialiased == antialiased
    with pytest.warns(ScoupWarning) if antialiased else contextlib.nullcontext():
        save_gaussians(gaussians, tmp_path / "b.splat")


@pytest.mark.parametrize(("old", "new", "before", "after"), [
    (b"float ", b"float scalar_", b"", b""), (b"ply\n", b"\xef\xbb\xbfply\n", b"", b""), (b"\n", b"\r\n", b"", b""),
    *((b"element", line + b"\nelement", b"", b"") for line in (
        *(f"comment {text}".encode() for text in ("by Ångström lab", "/全景/光学.jpg", "Συντάκτης", "хлеб")),
        b"comment scan\x85 final", "obj_info Ångström".encode(), "comment 部屋".encode("shift_jis"))),
    (b"element", b"element chunk 2\nproperty double a\nelement", bytes(16), b""),
    (b"end_header", b"element face 1\nproperty list uchar int i\nend_header", b"", b"\0"),
])  # fmt: skip
def test_headers_of_other_programs(
    tmp_path: Path, old: bytes, new: bytes, before: bytes, after: bytes
) -> None:
    path = ply_file(tmp_path / "a.ply", raw_columns())
    plain = read_ply(path)
    header, body = path.read_bytes().split(b"end_header\n", 1)
    path.write_bytes((header + b"end_header\n").replace(old, new) + before + body + after)
    assert same_gaussians(plain, read_ply(path))


@pytest.mark.parametrize(("encoding", "end"), [("utf-8", b"\n"), ("latin-1", b"\n"), ("utf-8", b"\r\n")])
def test_comments_are_read_and_written(tmp_path, encoding, end):
    path = ply_file(tmp_path / "a.ply", raw_columns())
    comment = "made by Zoë\N{NO-BREAK SPACE}à"
    header, body = path.read_bytes().split(b"end_header\n", 1)
    header = header.replace(b"ply\n", f"ply\ncomment {comment}\nobj_info x\n".encode(encoding), 1)
    path.write_bytes((header + b"end_header\n").replace(b"\n", end) + body)
    for _ in range(2):
        table = PlyTable.read(path)
        assert table.comments == (comment,)
        table.write(path, overwrite=True)


def test_rows_that_are_not_finite_are_dropped_and_counted(tmp_path):
    columns = raw_columns(8, rest=9)
    for name, row, value in (
        ("x", 1, np.nan), ("scale_2", 2, np.inf), ("f_rest_3", 3, -np.inf), ("opacity", 4, np.nan),
        *((f"rot_{part}", 5, 0) for part in range(4)), ("opacity", 6, np.inf),
    ):  # fmt: skip
        columns[name][row] = value
    with warns(ScoupWarning):
        gaussians, kept = PlyTable.read(ply_file(tmp_path / "a.ply", columns)).gaussians()
    assert np.flatnonzero(kept).tolist() == [0, 6, 7]
    assert len(gaussians) == 3
    assert gaussians.opacities[1] == 1


def test_select_keeps_rows_byte_for_byte(tmp_path):
    columns = {"label": np.arange(6, dtype=np.int32), **raw_columns(6)}
    path = ply_file(tmp_path / "a.ply", columns)
    table = PlyTable.read(path)
    table.write(tmp_path / "b.ply")
    assert (tmp_path / "b.ply").read_bytes() == path.read_bytes()
    big = ply_file(tmp_path / "big.ply", columns, "binary_big_endian")
    PlyTable.read(big).write(tmp_path / "little.ply")
    assert (tmp_path / "little.ply").read_bytes() == path.read_bytes()
    chosen = np.array([True, False, True, False, False, True])
    table.select(chosen).write(tmp_path / "c.ply")
    assert PlyTable.read(tmp_path / "c.ply").rows.tobytes() == table.rows[chosen].tobytes()


def test_a_column_can_be_added(tmp_path):
    table = PlyTable.read(ply_file(tmp_path / "a.ply", raw_columns(4)))
    table.with_column("object", np.array([7, 8, 9, 10], ">i8")).write(tmp_path / "b.ply")
    again = PlyTable.read(tmp_path / "b.ply")
    assert again.rows["object"].tolist() == [7, 8, 9, 10]
    assert np.array_equal(again.rows["x"], table.rows["x"])
    for kind, stored in ((bool, np.uint8), (np.uint16, np.uint16)):
        replaced = again.with_column("object", np.ones(4, kind))
        assert (replaced.names, replaced.rows.dtype["object"]) == (again.names, stored)
    with refuses():
        table.with_column("name", np.array(["a"] * 4))


def test_a_longer_file_is_read_with_a_warning(tmp_path):
    path = ply_file(tmp_path / "a.ply", raw_columns())
    path.write_bytes(path.read_bytes() + b"12345")
    with warns(ScoupWarning):
        assert len(read_ply(path)) == 5


def test_empty_tables_and_flat_gaussians(tmp_path):
    gaussians = some_gaussians(0, degree=2)
    for name in ("a.ply", "a.compressed.ply"):
        save_gaussians(gaussians, tmp_path / name)
        assert same_gaussians(gaussians, read_ply(tmp_path / name))
    save_gaussians(replace(some_gaussians(3), scales=torch.zeros(3, 3)), tmp_path / "b.compressed.ply")
    assert float(read_ply(tmp_path / "b.compressed.ply").scales.max()) < 1e-8


def test_table_from_memory_has_the_inria_layout():
    table = PlyTable.of(replace(some_gaussians(2, degree=3), opacities=torch.tensor([1.0, 0.0])))
    names = table.names
    assert len(names) == 62
    assert names[:10] == ("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "f_rest_0")
    assert " ".join(names[-8:]) == "opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3"
    assert table.rows["opacity"].tolist() == [np.inf, -np.inf]


def test_a_folder_is_no_file(tmp_path):
    with refuses(MissingFileError):
        read_ply(tmp_path)


def test_rows_of_splat(tmp_path: Path) -> None:
    path = tmp_path / "a.splat"
    path.write_bytes(record() + record(rotation=(192, 192, 128, 128)))
    found = read_splat(path)
    assert found.means[0].tolist() == [1, 2, 3]
    np.testing.assert_allclose(found.scales[0], [0.1, 0.2, 0.3], rtol=1e-6)
    assert found.opacities[0].item() == np.float32(0.2)
    np.testing.assert_allclose(found.sh[0, 0] * SH_C0 + 0.5, [1, 128 / 255, 0], atol=1e-6)
    np.testing.assert_allclose(found.quats, [[1, 0, 0, 0], [0.5**0.5, 0.5**0.5, 0, 0]], atol=1e-6)
    nan, mirrored = record(center=(float("nan"), 0, 0)), record(scale=(-0.1, 0.2, 0.3))
    path.write_bytes(record() + record(rotation=(128,) * 4) + nan + mirrored)
    with warns(ScoupWarning):
        found = read_splat(path)
    assert found.scales[1, 0] > 0
    assert same_gaussians(found.select([0]), found.select([1]))
    path.write_bytes(record() * 20 + record(center=(2e9, 0, 0)))  # values beyond any scene, but few
    assert len(read_splat(path)) == 21


def test_rows_of_compressed_ply(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    save_compressed_ply(path, count=300)
    found = read_ply(path)
    assert found.sh.shape == (300, 4, 3)
    assert found.means.aminmax().min >= -1.5
    assert found.means.aminmax().max <= 0.5
    raw = np.frombuffer(path.read_bytes()[-300 * 9 :], np.uint8).reshape(300, 9)[:, 4]
    expected = np.select([raw == 0, raw == 255], [-4.0, 4.0], (raw + 0.5) / 32 - 4)
    np.testing.assert_allclose(found.sh[:, 2, 1].numpy(), expected, atol=1e-6)
    with refuses(FileFormatError):
        PlyTable.read(path).gaussians()


@pytest.fixture
def small_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ply, "MOST_ROWS_IN_MEMORY", 10)
    monkeypatch.setattr(ply_rows, "AT_A_TIME", 7)


@pytest.mark.parametrize(("count", "broken"), [(11, []), (14, []), (50, []), (40, [0, 13, 39])])
def test_large_files_are_read_as_in_memory(
    count: int, broken: list[int], tmp_path: Path, small_parts: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    table = PlyTable.of(random_gaussians(count, seed=0))
    table.rows["x"][broken] = np.nan
    table.write(tmp_path / "a.ply")
    found = []
    for most in (10, 1000):
        monkeypatch.setattr(ply, "MOST_ROWS_IN_MEMORY", most)
        with warns(ScoupWarning) if broken else contextlib.nullcontext([]) as caught:
            found.append(load_gaussians(tmp_path / "a.ply"))
        assert len(caught) == bool(broken)
    assert same_gaussians(*found)
    for rows in (each.source_rows for each in found):
        assert (~rows).nonzero()[:, 0].tolist() == broken if broken else rows is None
    assert len(found[0]) == count - len(broken)
    assert found[0].fingerprint() == found[1].fingerprint()


def test_no_room_for_temporary_files(
    tmp_path: Path, small_parts: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_ply(random_gaussians(20, seed=0), tmp_path / "a.ply")

    def full(*_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.posix_fallocate", full)
    with pytest.raises(WriteError, match="TMPDIR"):
        load_gaussians(tmp_path / "a.ply")


@pytest.mark.parametrize("nan", [b"nan", b"-nan(ind)", b"1.#QNAN", b"-1.#IND00", b"1.#INF"])
def test_numbers_of_ascii_ply_files(tmp_path: Path, nan: bytes) -> None:
    path = ply_file(tmp_path / "a.ply", dict.fromkeys(raw_columns(2), np.full(2, 0.5, np.float32)), "ascii")
    row = b" ".join([b"0.5"] * 14)
    content = path.read_bytes().replace(row + b"\n" + row + b"\n", b"\xef\xbb\xbf" + row + b"\n")
    path.write_bytes(content + row.replace(b"0.5", nan, 1))
    with warns(ScoupWarning):
        assert len(load_gaussians(path)) == 1
    path.write_bytes(content + row.replace(b"0.5", b"0,5"))
    with refuses(FileFormatError):
        load_gaussians(path)


def changed_columns(path: Path, gone: str, **added: np.ndarray) -> Gaussians:
    """Write Gaussians without some properties, and with others."""
    given = some_gaussians(5, 1)
    rows = PlyTable.of(given).rows
    kept = {name: rows[name] for name in rows.dtype.names or () if not re.fullmatch(gone, name)}
    ply_file(path, {**kept, **added})
    return given


def colors(*values: float, dtype: type = np.uint8) -> dict[str, np.ndarray]:
    return {
        name: np.full(5, value, dtype) for name, value in zip(("red", "green", "blue"), values, strict=True)
    }


@pytest.mark.parametrize(("gone", "added", "flat"), [
    ("scale_2", {}, lambda scales: torch.cat([scales[:, :2], 3e-4 * scales[:, :2].amin(1, True)], 1)),
    ("scale_[12]", {}, lambda scales: scales[:, :1].expand(-1, 3)), ("f_dc_.", colors(255, 0, 51), None),
    ("f_dc_.", colors(1.0, 0.0, 0.2, dtype=np.float32), None),
    ("f_dc_.", colors(65535, 0, 13107, dtype=np.uint16), None),
])  # fmt: skip
def test_splats_with_other_properties(tmp_path: Path, gone: str, added: Any, flat: Any) -> None:
    given = changed_columns(tmp_path / "a.ply", gone, **added)
    expected = given.tensors()
    if flat:
        expected["scales"] = flat(given.scales)
    else:
        given.sh[:, 0] = (torch.tensor([1.0, 0.0, 0.2]) - 0.5) / SH_C0
    for name, tensor in load_gaussians(tmp_path / "a.ply").tensors().items():
        torch.testing.assert_close(tensor, expected[name], rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize(
    "name", ["trbf_center", "trbf_scale_0", "motion_3", "t", "scale_3", "nu_degree", "beta"]
)
def test_gaussians_that_are_not_plain(tmp_path: Path, name: str) -> None:
    more = {"semantic_0": np.zeros(5), "label": np.zeros(5, np.int32)}
    changed_columns(tmp_path / "a.ply", "", **more)
    assert len(load_gaussians(tmp_path / "a.ply")) == 5
    changed_columns(tmp_path / "a.ply", "", **more, **{name: np.zeros(5, np.float32)})
    with warns(ScoupWarning):
        load_gaussians(tmp_path / "a.ply")


@pytest.mark.parametrize("encoding", ["binary_little_endian", "ascii"])
def test_a_mesh_as_scannet_writes_it(tmp_path: Path, encoding: str) -> None:
    kinds = [*((name, "<f4") for name in "xyz"), *((name, "u1") for name in "rgba"), ("label", "<u2")]
    rows = np.zeros(2, dtype=kinds)
    rows["x"], rows["label"] = [1.5, -2], [40, 5]
    body = rows.tobytes() + bytes([3]) + np.array([0, 1, 0], "<i4").tobytes()
    if encoding == "ascii":
        body = b"1.5 0 0 0 0 0 0 40\n-2 0 0 0 0 0 0 5\n3 0 1 0\n"
    (tmp_path / "a.ply").write_bytes(POINT_HEADER.format(encoding=encoding, count=2).encode() + body)
    points = read_labelled_ply(tmp_path / "a.ply")
    assert points.positions.tolist() == [[1.5, 0, 0], [-2, 0, 0]]
    assert points.labels.tolist() == [40, 5]
    assert points.labels.dtype == torch.int64


def test_labelled_points_that_are_written_are_read(tmp_path: Path) -> None:
    points = LabelledPoints(torch.rand(5, 3, generator=torch.Generator().manual_seed(0)), torch.arange(5) * 9)
    write_labelled_ply(points, tmp_path / "a.ply")
    found = read_labelled_ply(tmp_path / "a.ply")
    assert found.positions.equal(points.positions)
    assert found.labels.equal(points.labels)
    with pytest.raises(OutputExistsError):
        write_labelled_ply(points, tmp_path / "a.ply")
