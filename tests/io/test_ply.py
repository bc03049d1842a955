from __future__ import annotations

import contextlib
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from io_samples import same_gaussians, save_spz, some_gaussians
from scoup.base import FileFormatError, InputError, MissingFileError, ScoupWarning
from scoup.io import load_gaussians, save_gaussians
from scoup.io.splats.activation import (
    logits_from_opacities,
    logs_from_scales,
    opacities_from_logits,
    scales_from_logs,
)
from scoup.io.splats.ply import (
    as_stored,
    gaussians_from_table,
    read_ply,
    read_ply_table,
    table_from_gaussians,
    write_ply,
    write_ply_table,
)
from support import examples

RAW = st.floats(width=32, allow_nan=False)


def file_of(path: Path, columns: dict[str, np.ndarray], encoding: str = "binary_little_endian") -> Path:
    """A PLY written by other means than those tested."""
    order = ">" if "big" in encoding else "<"
    names = {"f4": "float", "f8": "double", "u1": "uchar", "i4": "int"}
    kinds = [(name, order + values.dtype.str[1:]) for name, values in columns.items()]
    rows = np.empty(len(next(iter(columns.values()))), kinds)
    for key, values in columns.items():
        rows[key] = values
    lines = [f"property {names[values.dtype.str[1:]]} {name}" for name, values in columns.items()]
    start = ["ply", f"format {encoding} 1.0", f"element vertex {len(rows)}"]
    header = "\n".join([*start, *lines, "end_header", ""])
    if encoding == "ascii":
        body = "\n".join(" ".join(repr(float(value)) for value in row.tolist()) for row in rows) + "\n"
        path.write_bytes((header + body).encode())
    else:
        path.write_bytes(header.encode() + rows.tobytes())
    return path


def raw_columns(count: int = 5, rest: int = 0, seed: int = 0) -> dict[str, np.ndarray]:
    generator = np.random.default_rng(seed)
    names = ["x", "y", "z", *(f"f_dc_{c}" for c in range(3)), *(f"f_rest_{number}" for number in range(rest))]
    names += ["opacity", *(f"scale_{axis}" for axis in range(3)), *(f"rot_{part}" for part in range(4))]
    return {name: generator.normal(size=count).astype(np.float32) for name in names}


def test_rounding_of_new_values_is_small():
    gaussians = some_gaussians(500)
    stored = as_stored(gaussians)
    torch.testing.assert_close(stored.scales, gaussians.scales, rtol=1e-6, atol=0)
    torch.testing.assert_close(stored.opacities, gaussians.opacities, rtol=1e-6, atol=0)
    assert torch.equal(stored.means, gaussians.means)
    assert torch.equal(stored.sh, gaussians.sh)


@given(arrays.arrays(np.float32, 16, elements=RAW))
def test_every_raw_scale_and_opacity_survives(raw):
    scales, opacities = scales_from_logs(raw), opacities_from_logits(raw)
    assert np.array_equal(scales_from_logs(logs_from_scales(scales)), scales)
    assert np.array_equal(opacities_from_logits(logits_from_opacities(opacities)), opacities)


@settings(max_examples=examples(40))
@given(st.data())
def test_any_finite_file_reads_writes_reads_the_same(data):
    count, degree = data.draw(st.integers(1, 4)), data.draw(st.integers(0, 4))
    columns = raw_columns(count, 3 * ((degree + 1) ** 2 - 1))
    for name in columns:
        columns[name] = data.draw(arrays.arrays(np.float32, count, elements=st.floats(-80, 80, width=32)))
    columns["rot_0"] = np.maximum(np.abs(columns["rot_0"]), np.float32(1e-3))
    with tempfile.TemporaryDirectory() as folder:
        first = read_ply(file_of(Path(folder) / "a.ply", columns))
        write_ply(first, Path(folder) / "b.ply")
        again = read_ply(Path(folder) / "b.ply")
    assert same_gaussians(first, again)
    assert first.fingerprint() == again.fingerprint()


def test_opacity_one_and_zero(tmp_path):
    gaussians = replace(some_gaussians(2), opacities=torch.tensor([1.0, 0.0]))
    write_ply(gaussians, tmp_path / "a.ply")
    assert read_ply_table(tmp_path / "a.ply").rows["opacity"].tolist() == [np.inf, -np.inf]
    assert read_ply(tmp_path / "a.ply").opacities.tolist() == [1.0, 0.0]


def test_activation_and_layout(tmp_path):
    columns = raw_columns(3, rest=9)
    gaussians = read_ply(file_of(tmp_path / "a.ply", columns))
    np.testing.assert_allclose(gaussians.scales[:, 1], np.exp(columns["scale_1"]), rtol=1e-6)
    np.testing.assert_allclose(gaussians.opacities, 1 / (1 + np.exp(-columns["opacity"])), rtol=1e-6)
    np.testing.assert_allclose(gaussians.quats.norm(dim=1), 1, rtol=1e-6)
    ratio = gaussians.quats[:, 2].numpy() / gaussians.quats[:, 0].numpy()
    np.testing.assert_allclose(ratio, columns["rot_2"] / columns["rot_0"], rtol=1e-5)
    # f_rest is channel-major: green's second coefficient is number 1 * 3 + 1.
    assert np.array_equal(gaussians.sh[:, 2, 1], columns["f_rest_4"])


def test_order_extras_and_types_do_not_matter(tmp_path):
    columns = raw_columns(6, rest=24)
    plain = read_ply(file_of(tmp_path / "a.ply", columns))
    shuffled = dict(sorted(columns.items(), key=lambda item: item[0][::-1]))
    shuffled = {"label": np.arange(6, dtype=np.int32), **shuffled, "red": np.zeros(6, dtype=np.uint8)}
    assert same_gaussians(plain, read_ply(file_of(tmp_path / "b.ply", shuffled)))
    doubles = {name: values.astype(np.float64) for name, values in columns.items()}
    assert same_gaussians(plain, read_ply(file_of(tmp_path / "c.ply", doubles)))
    assert same_gaussians(plain, read_ply(file_of(tmp_path / "d.ply", columns, "binary_big_endian")))
    assert same_gaussians(plain, read_ply(file_of(tmp_path / "e.ply", columns, "ascii")))


def test_the_filter_of_mip_splatting_is_applied(tmp_path):
    columns = raw_columns(5)
    columns["filter_3D"] = np.array([0, 0.05, 0.5, 1e-3, 7], np.float32)
    found = read_ply(file_of(tmp_path / "a.ply", columns))
    filters = columns.pop("filter_3D")
    raw = read_ply(file_of(tmp_path / "b.ply", columns))
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
    table = replace(table_from_gaussians(some_gaussians(3)), comments=(comment,))
    write_ply_table(table, tmp_path / "a.ply")
    gaussians = load_gaussians(tmp_path / "a.ply")
    for name in ("b.ply", "b.compressed.ply", "b.spz"):
        save_gaussians(gaussians.select([0, 1]), tmp_path / name)
        assert load_gaussians(tmp_path / name).antialiased == antialiased, name
    save_spz(gaussians, tmp_path / "c.spz", 4)
    assert load_gaussians(tmp_path / "c.spz", keep_axes=True).antialiased == antialiased
    with pytest.warns(ScoupWarning) if antialiased else contextlib.nullcontext():
        save_gaussians(gaussians, tmp_path / "b.splat")


def test_windows_line_ends_and_comments(tmp_path):
    path = file_of(tmp_path / "a.ply", raw_columns())
    plain = read_ply(path)
    header, body = path.read_bytes().split(b"end_header\n", 1)
    header = header.replace(b"ply\n", b"ply\ncomment made by hand\nobj_info x\n", 1)
    path.write_bytes(header.replace(b"\n", b"\r\n") + b"end_header\r\n" + body)
    assert same_gaussians(plain, read_ply(path))
    assert read_ply_table(path).comments == ("made by hand",)


@pytest.mark.parametrize("encoding", ["utf-8", "latin-1"])
def test_comments_beyond_ascii_are_read_and_written(tmp_path, encoding):
    path = file_of(tmp_path / "a.ply", raw_columns())
    comment = "made by Zoë\N{NO-BREAK SPACE}à"
    path.write_bytes(path.read_bytes().replace(b"ply\n", f"ply\ncomment {comment}\n".encode(encoding), 1))
    for _ in range(2):
        table = read_ply_table(path)
        assert table.comments == (comment,)
        write_ply_table(table, path, overwrite=True)


def test_elements_before_and_after(tmp_path):
    path = file_of(tmp_path / "a.ply", raw_columns())
    plain = read_ply(path)
    header, body = path.read_bytes().split(b"end_header\n", 1)
    before = header.replace(b"element vertex", b"element chunk 2\nproperty double a\nelement vertex")
    after = b"element face 1\nproperty list uchar int i\nend_header\n"
    path.write_bytes(before + after + bytes(16) + body + b"\0")
    assert same_gaussians(plain, read_ply(path))


def test_rows_that_are_not_finite_are_dropped_and_counted(tmp_path):
    columns = raw_columns(8, rest=9)
    columns["x"][1] = np.nan
    columns["scale_2"][2] = np.inf
    columns["f_rest_3"][3] = -np.inf
    columns["opacity"][4] = np.nan
    for name in ("rot_0", "rot_1", "rot_2", "rot_3"):
        columns[name][5] = 0
    columns["opacity"][6] = np.inf
    table = read_ply_table(file_of(tmp_path / "a.ply", columns))
    with pytest.warns(ScoupWarning, match="dropped 5 of 8"):
        gaussians, kept = gaussians_from_table(table)
    assert np.flatnonzero(kept).tolist() == [0, 6, 7]
    assert len(gaussians) == 3
    assert gaussians.opacities[1] == 1


def test_select_keeps_rows_byte_for_byte(tmp_path):
    columns = {"label": np.arange(6, dtype=np.int32), **raw_columns(6)}
    path = file_of(tmp_path / "a.ply", columns)
    table = read_ply_table(path)
    write_ply_table(table, tmp_path / "b.ply")
    assert (tmp_path / "b.ply").read_bytes() == path.read_bytes()
    big = file_of(tmp_path / "big.ply", columns, "binary_big_endian")
    write_ply_table(read_ply_table(big), tmp_path / "little.ply")
    assert (tmp_path / "little.ply").read_bytes() == path.read_bytes()
    chosen = np.array([True, False, True, False, False, True])
    write_ply_table(table.select(chosen), tmp_path / "c.ply")
    assert read_ply_table(tmp_path / "c.ply").rows.tobytes() == table.rows[chosen].tobytes()


def test_a_column_can_be_added(tmp_path):
    table = read_ply_table(file_of(tmp_path / "a.ply", raw_columns(4)))
    wider = table.with_column("object", np.array([7, 8, 9, 10], ">i8"))
    write_ply_table(wider, tmp_path / "b.ply")
    again = read_ply_table(tmp_path / "b.ply")
    assert again.rows["object"].tolist() == [7, 8, 9, 10]
    assert np.array_equal(again.rows["x"], table.rows["x"])
    replaced = again.with_column("object", np.ones(4, dtype=bool))
    assert replaced.names == again.names
    with pytest.raises(InputError, match="cannot hold"):
        table.with_column("name", np.array(["a"] * 4))


def test_a_longer_file_is_read_with_a_warning(tmp_path):
    path = file_of(tmp_path / "a.ply", raw_columns())
    path.write_bytes(path.read_bytes() + b"12345")
    with pytest.warns(ScoupWarning, match="5 bytes more"):
        assert len(read_ply(path)) == 5


def test_empty_tables(tmp_path):
    gaussians = some_gaussians(0, degree=2)
    write_ply(gaussians, tmp_path / "a.ply")
    assert same_gaussians(gaussians, read_ply(tmp_path / "a.ply"))


NAMED = {
    "cut": (lambda whole: whole[:-1], r"cut short: its header says 5 rows of 'vertex', there is room for 4"),
    "long": (lambda whole: whole.replace(b"vertex 5", b"vertex 1000000000000"), "cut short"),
    "empty": (lambda _: b"", "is empty"),
    "no end": (lambda whole: whole.replace(b"end_header", b"end_huader"), "no end_header"),
    "list": (
        lambda whole: whole.replace(b"property float x", b"property list uchar float x"),
        "list property",
    ),
    "twice": (lambda whole: whole.replace(b"property float y", b"property float x"), "twice"),
}


@pytest.mark.parametrize("damage", NAMED)
def test_damage_is_named(tmp_path, damage):
    path = file_of(tmp_path / "a.ply", raw_columns(5))
    change, said = NAMED[damage]
    path.write_bytes(change(path.read_bytes()))
    with pytest.raises(FileFormatError, match=said):
        read_ply(path)


def test_files_without_a_splat_are_named(tmp_path):
    for path, said in ((tmp_path / "none.ply", "no such file"), (tmp_path, "is a folder")):
        with pytest.raises(MissingFileError, match=said):
            read_ply(path)
    columns = raw_columns()
    cloud = {name: columns[name] for name in ("x", "y", "z")}
    del columns["opacity"]
    files = ((columns, "lacks opacity"), (raw_columns(rest=5), "has 5 f_rest"), (cloud, "not a point cloud"))
    for wrong, said in files:
        with pytest.raises(FileFormatError, match=said):
            read_ply(file_of(tmp_path / "a.ply", wrong))


def test_text_that_does_not_fit_its_header(tmp_path):
    path = file_of(tmp_path / "a.ply", raw_columns(5), "ascii")
    whole = path.read_bytes()
    for content, said in (
        (b"\n".join(whole.splitlines()[:-1]), "has 4 rows of 14 numbers, but its header says 5 of 14"),
        (whole[:-9] + b"kettle\n", "kettle' in place of a number"),
    ):
        path.write_bytes(content)
        with pytest.raises(FileFormatError, match=said):
            read_ply(path)


def test_table_from_memory_has_the_inria_layout():
    names = table_from_gaussians(some_gaussians(2, degree=3)).names
    assert len(names) == 62
    assert names[:10] == ("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "f_rest_0")
    assert " ".join(names[-8:]) == "opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3"
