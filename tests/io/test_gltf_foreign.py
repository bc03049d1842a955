from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from gltf_samples import SPLATS, columns_of, foreign, packed, read_in_its_axes
from io_samples import same_gaussians, some_gaussians
from scoup.base import FileFormatError, MissingFileError, ScoupWarning


def test_interleaved_rows_and_several_primitives(tmp_path):
    gaussians = some_gaussians(5, 1)
    root, binary = foreign(columns_of(gaussians), stride=100)
    assert same_gaussians(read_in_its_axes(packed(tmp_path / "a.glb", root, binary)), gaussians)
    flat, flat_binary = foreign(columns_of(some_gaussians(3, 0, seed=1)))
    for view in flat["bufferViews"]:
        view["byteOffset"] += len(binary)
    for accessor in flat["accessors"]:
        accessor["bufferView"] += 1
    other = flat["meshes"][0]["primitives"][0]
    other["attributes"] = {key: value + len(root["accessors"]) for key, value in other["attributes"].items()}
    root["meshes"][0]["primitives"] += [{"attributes": {}, "mode": 4}, other]
    root["accessors"] += flat["accessors"]
    root["bufferViews"] += flat["bufferViews"]
    both = read_in_its_axes(packed(tmp_path / "b.glb", root, binary + flat_binary))
    assert len(both) == 8
    assert torch.equal(both.sh[:5], gaussians.sh)
    assert not both.sh[5:, 1:].any()
    assert torch.equal(both.sh[5:, :1], some_gaussians(3, 0, seed=1).sh)


def test_integers(tmp_path):
    generator = np.random.default_rng(0)
    quats = generator.integers(-127, 128, (9, 4), dtype=np.int8)
    quats[:, 3] = -128
    columns = {
        "POSITION": generator.integers(-(2**15), 2**15, (9, 3)).astype("<i2"),
        f"{SPLATS}:ROTATION": quats,
        f"{SPLATS}:SCALE": generator.integers(0, 2**16, (9, 3)).astype("<u2"),
        f"{SPLATS}:OPACITY": generator.integers(0, 256, (9, 1), dtype=np.uint8),
        f"{SPLATS}:SH_DEGREE_0_COEF_0": generator.normal(size=(9, 3)).astype("<f4"),
    }
    names = (f"{SPLATS}:ROTATION", f"{SPLATS}:SCALE", f"{SPLATS}:OPACITY")
    root, binary = foreign(columns, normalised=names)
    gaussians = read_in_its_axes(packed(tmp_path / "a.glb", root, binary))
    assert torch.equal(gaussians.means, torch.from_numpy(columns["POSITION"].astype(np.float32)))
    expected = np.maximum(quats[:, [3, 0, 1, 2]] / 127, -1)
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    np.testing.assert_allclose(gaussians.quats, expected, atol=1e-6)
    np.testing.assert_allclose(gaussians.scales, columns[names[1]] / 65_535, rtol=1e-6)
    np.testing.assert_allclose(gaussians.opacities, columns[names[2]][:, 0] / 255, rtol=1e-6)
    root, binary = foreign(columns, normalised=names[:2])
    with pytest.raises(FileFormatError, match="OPACITY is stored as integers that are not normalised"):
        read_in_its_axes(packed(tmp_path / "b.glb", root, binary))


def test_translations_of_nodes_add_up(tmp_path: Path) -> None:
    """An identity may be said; what other nodes do is of no concern."""
    gaussians = some_gaussians(20, 3)
    root, binary = foreign(columns_of(gaussians))
    matrix = np.eye(4)
    matrix[:3, 3] = 5, 0, -1
    outer = {"children": [1, 2], "matrix": matrix.T.ravel().tolist()}
    inner = {"mesh": 0, "translation": [1.0, -2.0, 3.0], "rotation": [0, 0, 0, 1], "scale": [1, 1, 1]}
    root["nodes"] = [outer, inner, {"mesh": 1, "rotation": [1, 0, 0, 0]}]
    root["meshes"].append({"primitives": [{"attributes": {}, "mode": 4}]})
    moved = read_in_its_axes(packed(tmp_path / "a.glb", root, binary))
    shift = torch.tensor([6.0, -2.0, 2.0], dtype=torch.float64)
    assert same_gaussians(moved, replace(gaussians, means=(gaussians.means.double() + shift).float()))


def test_scenes_and_nodes_without_a_scene(tmp_path: Path) -> None:
    gaussians = some_gaussians(4, 0)
    root, binary = foreign(columns_of(gaussians))
    root["nodes"] = [{"children": [1]}, {"mesh": 0}, {"mesh": 0, "translation": [10, 0, 0]}]
    root["scenes"] = [{"nodes": [0]}, {"nodes": [2]}]
    assert same_gaussians(read_in_its_axes(packed(tmp_path / "a.glb", root, binary)), gaussians)
    second = read_in_its_axes(packed(tmp_path / "a.glb", {**root, "scene": 1}, binary))
    assert torch.equal(second.means, gaussians.means + torch.tensor([10.0, 0, 0]))
    del root["scenes"], root["nodes"][2]
    assert same_gaussians(read_in_its_axes(packed(tmp_path / "a.glb", root, binary)), gaussians)


def test_files_beside_and_below(tmp_path):
    gaussians = some_gaussians(4, 1)
    root, binary = foreign(columns_of(gaussians))
    place = tmp_path / "scene" / "data"
    place.mkdir(parents=True)
    (place / "a b.bin").write_bytes(binary)
    (place / "short.bin").write_bytes(binary[:-1])
    path = tmp_path / "scene" / "a.gltf"

    def write(uri: str) -> Path:
        buffers = [{"byteLength": len(binary), "uri": uri}]
        path.write_text(json.dumps({**root, "buffers": buffers}))
        return path

    assert same_gaussians(read_in_its_axes(write("data/a%20b.bin")), gaussians)
    (tmp_path / "secret.bin").write_bytes(binary)
    (place / "link.bin").symlink_to(tmp_path / "secret.bin")
    secret = str(tmp_path / "secret.bin")
    beside = ["../secret.bin", "data/../../secret.bin", "%2E%2E/secret.bin", "data/link.bin", secret]
    beside += ["file://" + secret, "https://localhost/a.bin", "data\\a.bin", "a%00b"]
    for uri, said in (
        *((uri, "not a file in its folder") for uri in beside),
        ("", "uri is '', expected a text"),
        ("data/short.bin", "cut short"),
        ("data:application/octet-stream;base64,????", "base64 is damaged"),
        ("data:text/plain,hello", "not base64"),
    ):
        with pytest.raises(FileFormatError, match=said):
            read_in_its_axes(write(uri))
    with pytest.raises(MissingFileError, match="a buffer of"):
        read_in_its_axes(write("other.bin"))


def test_warnings_of_other_kinds_of_gaussians(tmp_path):
    gaussians = some_gaussians(2, 0)
    root, binary = foreign(columns_of(gaussians))
    root["meshes"][0]["primitives"][0]["extensions"][SPLATS]["colorSpace"] = "lin_rec709_display"
    with pytest.warns(ScoupWarning, match="its colorSpace is 'lin_rec709_display'"):
        read_in_its_axes(packed(tmp_path / "a.glb", root, binary))
