"""glTF files made and taken apart by means of the specification alone, shared by the tests of glTF."""

from __future__ import annotations

import base64
import json
import struct
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from tests.fuzzing.containers import GLB
from tests.io_samples import save_spz

from scoup.io import load_gaussians
from scoup.scene import Gaussians

SPLATS = "KHR_gaussian_splatting"
CODES = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
SIZES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5126: 4}
DTYPES = {5121: "u1", 5123: "<u2", 5126: "<f4"}


def opened(path: Path) -> tuple[dict[str, Any], bytes]:
    """JSON and buffer of a file with one buffer, by means of the specification alone."""
    data = path.read_bytes()
    if path.suffix == ".gltf":
        root = json.loads(data)
        return root, base64.b64decode(root["buffers"][0]["uri"].split(",")[1])
    magic, version, length, size, kind = struct.unpack_from("<4sIII4s", data)
    assert (magic, version, length, kind) == (b"glTF", 2, len(data), b"JSON")
    text = data[20 : 20 + size]
    binary_size, binary_kind = struct.unpack_from("<I4s", data, 20 + size)
    assert (28 + size + binary_size, binary_kind) == (len(data), b"BIN\0")
    assert size % 4 == len(data) % 4 == 0
    assert len(text) - len(text.rstrip(b" ")) < 4
    return json.loads(text), data[28 + size :]


def read_in_its_axes(path: Path) -> Gaussians:
    """The numbers of the file, not turned to the axes of 3DGS."""
    return load_gaussians(path, keep_axes=True)


def packed(path: Path, root: dict[str, Any], binary: bytes) -> Path:
    """A .glb file; its first buffer is stated as long as ``binary``."""
    text = json.dumps({**root, "buffers": [{"byteLength": len(binary)}]}).encode()
    path.write_bytes(GLB.join(b"", [text, binary]))
    return path


def foreign(
    columns: dict[str, np.ndarray], normalised: tuple[str, ...] = (), stride: int = 0
) -> tuple[dict[str, Any], bytes]:
    """JSON and buffer of one primitive, by other means than those tested; all rows interleaved by ``stride``."""
    views, accessors, parts, place = [], [], [], 0
    count = len(next(iter(columns.values())))
    rows = np.zeros((count, stride), np.uint8)
    for name, values in columns.items():
        column = np.ascontiguousarray(values).view(np.uint8).reshape(count, -1)
        accessor = {"componentType": CODES[values.dtype.str[1:]], "count": count}
        accessor |= {"type": TYPES[values.shape[1]], "normalized": name in normalised}
        if stride:
            rows[:, place : place + column.shape[1]] = column
            accessor |= {"bufferView": 0, "byteOffset": place}
            place += column.shape[1]
        else:
            padded = np.pad(column, ((0, 0), (0, -column.shape[1] % 4)))
            accessor["bufferView"] = len(views)
            view = {
                "buffer": 0,
                "byteOffset": place,
                "byteLength": padded.size,
                "byteStride": padded.shape[1],
            }
            views.append(view)
            parts.append(padded.tobytes())
            place += padded.size
        accessors.append(accessor)
    if stride:
        views, parts = [{"buffer": 0, "byteLength": rows.size, "byteStride": stride}], [rows.tobytes()]
    primitive = {"mode": 0, "attributes": {name: index for index, name in enumerate(columns)}}
    primitive["extensions"] = {SPLATS: {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}}
    root = {
        "asset": {"version": "2.0"}, "extensionsUsed": [SPLATS], "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}], "accessors": accessors, "bufferViews": views,
    }  # fmt: skip
    return root, b"".join(parts)


def columns_of(gaussians: Gaussians) -> dict[str, np.ndarray]:
    degrees = range(gaussians.sh_degree + 1)
    orders = [(degree, order) for degree in degrees for order in range(2 * degree + 1)]
    return {
        "POSITION": gaussians.means.numpy(),
        f"{SPLATS}:ROTATION": gaussians.quats.numpy()[:, [1, 2, 3, 0]],
        f"{SPLATS}:SCALE": gaussians.scales.numpy(),
        f"{SPLATS}:OPACITY": gaussians.opacities.numpy()[:, None],
        **{
            f"{SPLATS}:SH_DEGREE_{degree}_COEF_{order}": gaussians.sh.numpy()[:, index]
            for index, (degree, order) in enumerate(orders)
        },
    }


def check_rules(path: Path) -> None:
    """The rules of glTF 2.0 and of the extensions that a file of ours is subject to."""
    root, binary = opened(path)
    assert root["asset"]["version"] == "2.0"
    used = set(root["extensionsUsed"])
    assert set(root.get("extensionsRequired", ())) <= used
    assert [len(binary)] == [buffer["byteLength"] for buffer in root["buffers"]]
    for view in root["bufferViews"]:
        assert view["byteLength"] >= 1
        assert view["byteOffset"] % 4 == 0
        assert view["byteOffset"] + view["byteLength"] <= len(binary)
        assert view.get("byteStride", 4) in range(4, 253, 4)
        assert ("target" in view) == ("byteStride" in view)
    primitive = root["meshes"][0]["primitives"][0]
    assert primitive["mode"] == 0
    assert set(primitive["extensions"]) <= used
    splats = primitive["extensions"][SPLATS]
    assert (splats["kernel"], splats["colorSpace"]) == ("ellipse", "srgb_rec709_display")
    columns = {}
    for name, index in primitive["attributes"].items():
        accessor = root["accessors"][index]
        view, count = root["bufferViews"][accessor["bufferView"]], accessor["count"]
        size = SIZES[accessor["componentType"]] * {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor["type"]]
        assert view["target"] == 34962
        assert size <= view["byteStride"]
        assert view["byteStride"] * (count - 1) + size <= view["byteLength"]
        starts = range(
            view["byteOffset"], view["byteOffset"] + count * view["byteStride"], view["byteStride"]
        )
        rows = b"".join(binary[start : start + size] for start in starts)
        columns[name] = np.frombuffer(rows, DTYPES[accessor["componentType"]]).reshape(count, -1)
        assert np.isfinite(columns[name]).all()
        if accessor["componentType"] != 5126:
            assert accessor.get("normalized", False) == (name == "COLOR_0")
    (count,) = {len(column) for column in columns.values()}
    assert count >= 1
    position = root["accessors"][primitive["attributes"]["POSITION"]]
    assert position["min"] == columns["POSITION"].min(0).tolist()
    assert position["max"] == columns["POSITION"].max(0).tolist()
    assert (columns[f"{SPLATS}:SCALE"] >= 0).all()
    opacities = columns[f"{SPLATS}:OPACITY"]
    assert ((opacities >= 0) & (opacities <= 1)).all()
    norms = np.linalg.norm(columns[f"{SPLATS}:ROTATION"].astype(np.float64), axis=1)
    np.testing.assert_allclose(norms, 1, atol=1e-6)
    found = {name for name in columns if "SH_DEGREE" in name}
    degrees = range(round(len(found) ** 0.5))
    orders = [(degree, order) for degree in degrees for order in range(2 * degree + 1)]
    assert found == {f"{SPLATS}:SH_DEGREE_{degree}_COEF_{order}" for degree, order in orders}


def features_of(path: Path) -> tuple[list[int], tuple[str, ...]] | None:
    """Class of each Gaussian, -1 for none, and the names of the classes, of a file of ours, by the rules of the
    extensions."""
    root, binary = opened(path)
    primitive = root["meshes"][0]["primitives"][0]
    if "EXT_mesh_features" not in primitive["extensions"]:
        return None

    def data(index: int) -> bytes:
        view = root["bufferViews"][index]
        assert view["byteOffset"] % 8 == 0
        return binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]

    features = primitive["extensions"]["EXT_mesh_features"]["featureIds"][0]
    metadata = root["extensions"]["EXT_structural_metadata"]
    table = metadata["propertyTables"][features["propertyTable"]]
    assert features["featureCount"] == table["count"] == features["nullFeatureId"] >= 1
    properties = table["properties"]
    assert set(metadata["schema"]["classes"][table["class"]]["properties"]) == set(properties)
    offsets = np.frombuffer(data(properties["name"]["stringOffsets"]), "<u4").tolist()
    text = data(properties["name"]["values"])
    assert (len(offsets), offsets[-1]) == (table["count"] + 1, len(text))
    accessor = root["accessors"][primitive["attributes"]["_FEATURE_ID_0"]]
    assert accessor["type"] == "SCALAR"
    dtype = DTYPES[accessor["componentType"]]
    column = np.frombuffer(data(accessor["bufferView"]), dtype).reshape(accessor["count"], -1)[:, 0]
    counts = np.frombuffer(data(properties["count"]["values"]), "<u4")
    assert counts.tolist() == [int((column == row).sum()) for row in range(table["count"])]
    ids = [-1 if value == table["count"] else int(value) for value in column.tolist()]
    return ids, tuple(text[start:end].decode() for start, end in pairwise(offsets))


def spz_in_gltf(folder: Path, gaussians: Gaussians, name: str = "_2", version: int = 3) -> Path:
    """A .glb file whose attributes are a .spz file, by the draft of the extension."""
    save_spz(gaussians, folder / "inner.spz", version)
    data = (folder / "inner.spz").read_bytes()
    root, _ = foreign(columns_of(gaussians))
    compression = f"{SPLATS}_compression_spz{name}"
    primitive = root["meshes"][0]["primitives"][0]
    primitive["extensions"][SPLATS] = {"extensions": {compression: {"bufferView": 0}}}
    root["bufferViews"] = [{"buffer": 0, "byteLength": len(data)}]
    for accessor in root["accessors"]:
        accessor.pop("bufferView", None)
    root["extensionsUsed"] = root["extensionsRequired"] = [SPLATS, compression]
    return packed(folder / "spz.glb", root, data)
