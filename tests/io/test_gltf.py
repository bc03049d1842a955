"""glTF: what is written by its rules, files as others write them, .spz inside, its axes and its frame of the world."""

from __future__ import annotations

import contextlib
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from gltf_samples import (
    SPLATS,
    check_rules,
    columns_of,
    features_of,
    foreign,
    opened,
    packed,
    read_in_its_axes,
    spz_in_gltf,
)
from io_samples import PLACE, covariances, heights, same_gaussians, some_cameras, some_gaussians
from messages import refuses, warns
from scoup.base import FileFormatError, MissingFileError, ScoupWarning, WorldFrame
from scoup.io import load_gaussians, save_gaussians, write_gltf
from scoup.io.splats.axes import Axis, turned
from scoup.io.splats.gltf import read_gltf
from scoup.io.splats.spz import read_spz
from scoup.raster import view_colors
from support import examples


@settings(max_examples=examples(60))
@given(st.integers(1, 5), st.sampled_from([".glb", ".gltf"]), st.data())
def test_features_are_written_by_the_rules(tmp_path_factory, count, suffix, data) -> None:
    path, names = tmp_path_factory.mktemp("features") / f"a{suffix}", ("chair", "Tür", "窓")
    ids = data.draw(st.none() | st.lists(st.integers(-1, 2), min_size=count, max_size=count))
    write_gltf(some_gaussians(count, 3), path, ids=None if ids is None else torch.tensor(ids), names=names)
    check_rules(path)
    assert features_of(path) == (None if ids is None else (ids, names))


@pytest.mark.parametrize(("count", "code"), [(255, 5121), (256, 5123), (65_535, 5123), (65_536, 5126)])
def test_ids_take_the_smallest_type_that_holds_them(tmp_path, count, code):
    ids, names = [0, -1, count - 1, count // 2], tuple(f"class {number}" for number in range(count))
    write_gltf(some_gaussians(4, 0), tmp_path / "a.glb", ids=torch.tensor(ids), names=names)
    check_rules(tmp_path / "a.glb")
    assert opened(tmp_path / "a.glb")[0]["accessors"][-1]["componentType"] == code
    assert features_of(tmp_path / "a.glb") == (ids, names)


def test_the_fallback_is_linear_rgb_of_degree_0(tmp_path):
    gaussians, wanted = some_gaussians(3, 1), torch.tensor([[0.0, 0.5, 1.0], [0.02, 0.2, 0.8], [-3, 9, 0.25]])
    gaussians.sh[:, 0] = (wanted - 0.5) / 0.28209479177387814
    write_gltf(gaussians, tmp_path / "a.glb")
    root, binary = opened(tmp_path / "a.glb")
    accessor = root["accessors"][root["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"]]
    start = root["bufferViews"][accessor["bufferView"]]["byteOffset"]
    color = np.frombuffer(binary[start : start + 24], "<u2").reshape(3, 4) / 65_535
    # sRGB 0.5 is 0.2140 in linear RGB, 0.02 is 0.02 / 12.92, 0.2 is 0.0331, 0.8 is 0.6038, 0.25 is 0.0509.
    expected = [[0, 0.21404, 1], [0.001548, 0.03310, 0.60383], [0, 1, 0.05088]]
    np.testing.assert_allclose(color[:, :3], expected, atol=2e-5)
    np.testing.assert_allclose(color[:, 3], gaussians.opacities, atol=0.5 / 65_535 + 1e-7)


def test_rows_that_are_not_finite_are_dropped(tmp_path):
    gaussians = some_gaussians(5, 0)
    columns = {name: values.copy() for name, values in columns_of(gaussians).items()}
    columns["POSITION"][1], columns[f"{SPLATS}:ROTATION"][4] = np.inf, 0
    with warns(ScoupWarning):
        found = read_in_its_axes(packed(tmp_path / "a.glb", *foreign(columns)))
    assert same_gaussians(found, gaussians.select(torch.tensor([0, 2, 3])))


def test_interleaved_rows_and_several_primitives(tmp_path):
    gaussians, other = some_gaussians(5, 1), some_gaussians(3, 0, seed=1)
    root, binary = foreign(columns_of(gaussians), stride=100)
    assert same_gaussians(read_in_its_axes(packed(tmp_path / "a.glb", root, binary)), gaussians)
    flat, flat_binary = foreign(columns_of(other))
    for view in flat["bufferViews"]:
        view["byteOffset"] += len(binary)
    for accessor in flat["accessors"]:
        accessor["bufferView"] += 1
    primitive = flat["meshes"][0]["primitives"][0]
    primitive["attributes"] = {key: n + len(root["accessors"]) for key, n in primitive["attributes"].items()}
    root["meshes"][0]["primitives"] += [{"attributes": {}, "mode": 4}, primitive]
    root["accessors"] += flat["accessors"]
    root["bufferViews"] += flat["bufferViews"]
    both = read_in_its_axes(packed(tmp_path / "b.glb", root, binary + flat_binary))
    assert torch.equal(both.means, torch.cat([gaussians.means, other.means]))
    assert torch.equal(both.sh, torch.cat([gaussians.sh, torch.nn.functional.pad(other.sh, (0, 0, 0, 3))]))


def test_integers(tmp_path):
    generator = np.random.default_rng(0)
    names = rotation, scale, opacity = [f"{SPLATS}:{name}" for name in ("ROTATION", "SCALE", "OPACITY")]
    quats = generator.integers(-127, 128, (9, 4), dtype=np.int8)
    quats[:, 3] = -128
    columns = {
        "POSITION": generator.integers(-(2**15), 2**15, (9, 3)).astype("<i2"), rotation: quats,
        scale: generator.integers(0, 2**16, (9, 3)).astype("<u2"),
        opacity: generator.integers(0, 256, (9, 1), dtype=np.uint8),
        f"{SPLATS}:SH_DEGREE_0_COEF_0": generator.normal(size=(9, 3)).astype("<f4"),
    }  # fmt: skip
    gaussians = read_in_its_axes(packed(tmp_path / "a.glb", *foreign(columns, tuple(names))))
    assert torch.equal(gaussians.means, torch.from_numpy(columns["POSITION"].astype(np.float32)))
    expected = np.maximum(quats[:, [3, 0, 1, 2]] / 127, -1)
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    np.testing.assert_allclose(gaussians.quats, expected, atol=1e-6)
    np.testing.assert_allclose(gaussians.scales, columns[scale] / 65_535, rtol=1e-6)
    np.testing.assert_allclose(gaussians.opacities, columns[opacity][:, 0] / 255, rtol=1e-6)
    with refuses(FileFormatError):
        read_in_its_axes(packed(tmp_path / "b.glb", *foreign(columns, (rotation, scale))))


OUTER = {"children": [1, 2], "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 5, 0, -1, 1]}
INNER = {"mesh": 0, "translation": [1.0, -2.0, 3.0], "rotation": [0, 0, 0, 1], "scale": [1, 1, 1]}
NODES = {"nodes": [{"children": [1]}, {"mesh": 0}, {"mesh": 0, "translation": [10, 0, 0]}]}
SCENES = {**NODES, "scenes": [{"nodes": [0]}, {"nodes": [2]}]}


@pytest.mark.parametrize(("parts", "shift"), [
    ({"nodes": [OUTER, INNER, {"mesh": 1, "rotation": [1, 0, 0, 0]}]}, [6, -2, 2]),  # identities, and other meshes
    (SCENES, [0, 0, 0]), ({**SCENES, "scene": 1}, [10, 0, 0]),
    ({"nodes": NODES["nodes"][:2], "scenes": None}, [0, 0, 0]),
])  # fmt: skip
def test_translations_of_nodes_add_up(tmp_path: Path, parts: dict[str, Any], shift: list[float]) -> None:
    gaussians = some_gaussians(20, 3)
    root, binary = foreign(columns_of(gaussians))
    root["meshes"].append({"primitives": [{"attributes": {}, "mode": 4}]})
    root = {key: value for key, value in {**root, **parts}.items() if value is not None}
    found = read_in_its_axes(packed(tmp_path / "a.glb", root, binary))
    moved = gaussians.means.double() + torch.tensor(shift, dtype=torch.float64)
    assert same_gaussians(found, replace(gaussians, means=moved.float()))


@pytest.mark.parametrize(
    "frame", [WorldFrame(0.25), WorldFrame(2.0, (0.1, -0.9, 0.2)), WorldFrame(up=(0, 1, 0))]
)
def test_gltf_is_written_upright_and_in_metres(tmp_path: Path, frame: WorldFrame) -> None:
    gaussians = replace(some_gaussians(9, 1), world=frame)
    save_gaussians(gaussians, tmp_path / "a.gltf")
    found = load_gaussians(tmp_path / "a.gltf")
    assert torch.equal(found.means, gaussians.means)
    assert found.world.metres_per_unit == pytest.approx(frame.metres_per_unit)
    np.testing.assert_allclose(heights(found), heights(gaussians), rtol=1e-6)


def test_a_node_of_gltf_is_the_frame(tmp_path: Path) -> None:
    """Three metres per unit, a quarter turn about z, and a translation: seen in the axes of the Gaussians."""
    gaussians = some_gaussians(9, 1)
    root, binary = foreign(columns_of(turned(gaussians, "z")))
    turn = [0.0, 0.0, 0.5**0.5, 0.5**0.5]
    root["nodes"] = [
        {"children": [1], "scale": [3, 3, 3]},
        {"mesh": 0, "rotation": turn, "translation": [0, 2, 0]},
    ]
    found = load_gaussians(packed(tmp_path / "a.glb", root, binary))
    assert found.world.metres_per_unit == pytest.approx(3)
    assert found.world.up == pytest.approx((-1, 0, 0), abs=1e-9), "x of the file, left, points up"
    moved = (found.means - gaussians.means).numpy()
    np.testing.assert_allclose(moved, np.tile([-2, 0, 0], (9, 1)), atol=1e-6)


def test_files_beside_and_below(tmp_path):
    gaussians, path = some_gaussians(4, 1), tmp_path / "a.gltf"
    root, binary = foreign(columns_of(gaussians))
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "a b.bin").write_bytes(binary)
    for uri, file in (("data/a%20b.bin", path), ("other.bin", path), ("", tmp_path / "none.glb")):
        path.write_text(json.dumps({**root, "buffers": [{"byteLength": len(binary), "uri": uri}]}))
        with contextlib.nullcontext() if "data" in uri else refuses(MissingFileError):
            assert same_gaussians(read_in_its_axes(file), gaussians)


def test_another_colour_space_is_warned_of(tmp_path):
    root, binary = foreign(columns_of(some_gaussians(2, 0)))
    root["meshes"][0]["primitives"][0]["extensions"][SPLATS]["colorSpace"] = "lin_rec709_display"
    with warns(ScoupWarning):
        read_in_its_axes(packed(tmp_path / "a.glb", root, binary))


TURNS: dict[Axis, list[float]] = {"x": [1, -1, -1], "y": [-1, 1, -1], "z": [-1, -1, 1]}


@pytest.mark.parametrize("axis", TURNS)
def test_a_half_turn_is_the_rotation(axis: Axis) -> None:
    gaussians, camera = replace(some_gaussians(9, 4), world=PLACE), some_cameras(1)[0]
    turn = torch.diag(torch.tensor([*TURNS[axis], 1.0], dtype=torch.float64))
    linear, found = turn[:3, :3], turned(gaussians, axis)
    assert torch.equal(found.means.double(), gaussians.means.double() @ linear)
    torch.testing.assert_close(covariances(found), linear @ covariances(gaussians) @ linear)
    colors = view_colors(found, replace(camera, viewmat=camera.viewmat @ turn))
    torch.testing.assert_close(colors, view_colors(gaussians, camera), rtol=0, atol=2e-5)
    np.testing.assert_allclose(heights(found), heights(gaussians), rtol=1e-5)
    again = turned(found, axis)
    assert same_gaussians(again, gaussians)
    assert again.world == PLACE


@pytest.mark.parametrize("name", ["", "_2"])
@pytest.mark.parametrize("version", [2, 4])
def test_spz_in_gltf_is_read(tmp_path: Path, name: str, version: int) -> None:
    gaussians = some_gaussians(30, 3)
    path = spz_in_gltf(tmp_path, gaussians, name, version)
    assert same_gaussians(read_gltf(path), read_spz(tmp_path / "inner.spz"))
