from __future__ import annotations

import struct
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from gltf_samples import SPLATS, check_rules, features_of, opened, packed
from io_samples import same_gaussians, some_gaussians
from scoup.base import InputError, ScoupWarning
from scoup.io.splats.gltf import read_gltf
from scoup.io.splats.gltf_write import GaussianFeatures, write_gltf
from scoup.scene import Gaussians
from support import examples

NUMBERS = st.floats(-(2.0**99), 2.0**99, width=32)


@settings(max_examples=examples(60), deadline=None)
@given(data=st.data(), degree=st.integers(0, 3), suffix=st.sampled_from([".glb", ".gltf"]))
def test_ugly_gaussians_survive_bit_by_bit(data, degree, suffix):
    count = data.draw(st.integers(1, 5))

    def draw(width: int, values: st.SearchStrategy[float]) -> np.ndarray:
        size = count * width
        drawn = data.draw(st.lists(values, min_size=size, max_size=size))
        return np.array(drawn, np.float32).reshape(count, width)

    quats = draw(4, st.floats(-1, 1, width=32)) + np.array([2, 0, 0, 0], np.float32)
    quats = (quats / np.linalg.norm(quats.astype(np.float64), axis=1, keepdims=True)).astype(np.float32)
    gaussians = Gaussians(
        means=torch.from_numpy(draw(3, NUMBERS)),
        quats=torch.from_numpy(quats),
        scales=torch.from_numpy(draw(3, st.floats(0, 2.0**99, width=32))),
        opacities=torch.from_numpy(draw(1, st.sampled_from([0.0, 1.0, 1e-30, 0.5]))[:, 0]),
        sh=torch.from_numpy(draw(3 * (degree + 1) ** 2, NUMBERS).reshape(count, -1, 3)),
    )
    drawn = st.lists(st.integers(-1, 2), min_size=count, max_size=count)
    ids = data.draw(st.none() | drawn)
    names = ("chair", "Tür", "窓")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"a{suffix}"
        features = None if ids is None else GaussianFeatures(torch.tensor(ids), names)
        write_gltf(gaussians, path, features=features)
        check_rules(path)
        again = read_gltf(path)
        for name in ("means", "quats", "scales", "opacities", "sh"):
            one, other = getattr(gaussians, name), getattr(again, name)
            assert torch.equal(one.view(torch.int32), other.view(torch.int32)), name
        assert features_of(path) == (None if ids is None else (ids, names))


def test_what_gltf_does_not_allow_is_mended(tmp_path):
    gaussians = some_gaussians(4, 0)
    quats = gaussians.quats * torch.tensor([1, 3, 1, 0])[:, None]
    opacities = torch.tensor([0.5, 1.5, -0.5, torch.inf])
    ugly = Gaussians(gaussians.means, quats, -gaussians.scales, opacities, gaussians.sh)
    write_gltf(ugly, tmp_path / "a.glb")
    check_rules(tmp_path / "a.glb")
    again = read_gltf(tmp_path / "a.glb")
    assert torch.equal(again.scales, gaussians.scales)
    assert again.opacities.tolist() == [0.5, 1, 0, 1]
    torch.testing.assert_close(again.quats[:3], gaussians.quats[:3], atol=1e-6, rtol=0)
    assert again.quats[3].tolist() == [1, 0, 0, 0]


def test_degree_4_is_cut_to_3(tmp_path):
    gaussians = some_gaussians(3, 4)
    with pytest.warns(ScoupWarning, match="up to degree 3"):
        write_gltf(gaussians, tmp_path / "a.glb")
    assert torch.equal(read_gltf(tmp_path / "a.glb").sh, gaussians.sh[:, :16])


def test_the_fallback_is_linear_rgb_of_degree_0(tmp_path):
    gaussians = some_gaussians(3, 1)
    sh = gaussians.sh.clone()
    wanted = torch.tensor([[0.0, 0.5, 1.0], [0.02, 0.2, 0.8], [-3, 9, 0.25]])
    sh[:, 0] = (wanted - 0.5) / 0.28209479177387814
    write_gltf(replace(gaussians, sh=sh), tmp_path / "a.glb")
    root, binary = opened(tmp_path / "a.glb")
    accessor = root["accessors"][root["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"]]
    start = root["bufferViews"][accessor["bufferView"]]["byteOffset"]
    color = np.frombuffer(binary[start : start + 24], "<u2").reshape(3, 4) / 65_535
    # sRGB 0.5 is 0.2140 in linear RGB, 0.02 is 0.02 / 12.92, 0.2 is 0.0331, 0.8 is 0.6038, 0.25 is 0.0509.
    expected = [[0, 0.21404, 1], [0.001548, 0.03310, 0.60383], [0, 1, 0.05088]]
    np.testing.assert_allclose(color[:, :3], expected, atol=2e-5)
    np.testing.assert_allclose(color[:, 3], gaussians.opacities, atol=0.5 / 65_535 + 1e-7)


@pytest.mark.parametrize(("count", "code"), [(255, 5121), (256, 5123), (65_535, 5123), (65_536, 5126)])
def test_ids_take_the_smallest_type_that_holds_them(tmp_path, count, code):
    gaussians = some_gaussians(4, 0)
    names = tuple(f"class {number}" for number in range(count))
    ids = torch.tensor([0, -1, count - 1, count // 2])
    write_gltf(gaussians, tmp_path / "a.glb", features=GaussianFeatures(ids, names))
    check_rules(tmp_path / "a.glb")
    root, _ = opened(tmp_path / "a.glb")
    assert root["accessors"][-1]["componentType"] == code
    assert features_of(tmp_path / "a.glb") == (ids.tolist(), names)


def test_refused_outputs(tmp_path):
    gaussians = some_gaussians(2, 0)
    for refused, said in (
        (gaussians.select([]), "no Gaussians to write"),
        (replace(gaussians, means=gaussians.means * torch.nan), "not finite"),
    ):
        with pytest.raises(InputError, match=said):
            write_gltf(refused, tmp_path / "a.glb")
    assert not list(tmp_path.iterdir())


def test_rows_that_are_not_finite_are_dropped(tmp_path):
    path = tmp_path / "a.glb"
    gaussians = some_gaussians(5, 0)
    write_gltf(gaussians, path)
    root, binary = opened(path)
    damaged = bytearray(binary)
    attributes = root["meshes"][0]["primitives"][0]["attributes"]
    for name, row, size, value in [("POSITION", 1, 12, np.inf), (f"{SPLATS}:ROTATION", 4, 16, 0)]:
        start = root["bufferViews"][root["accessors"][attributes[name]]["bufferView"]]["byteOffset"]
        width = size // 4
        damaged[start + row * size : start + (row + 1) * size] = struct.pack(f"<{width}f", *[value] * width)
    packed(path, root, bytes(damaged))
    with pytest.warns(ScoupWarning, match="dropped 2 of 5 Gaussians"):
        assert same_gaussians(read_gltf(path), gaussians.select(torch.tensor([0, 2, 3])))
