from __future__ import annotations

import struct
from typing import Any

import pytest

from gltf_samples import SPLATS, columns_of, foreign, packed
from io_samples import some_gaussians
from scoup.base import FileFormatError, MissingFileError
from scoup.io.splats.gltf import read_gltf
from scoup.io.splats.gltf_write import write_gltf


def refusals() -> dict[str, tuple[Any, str]]:
    """What is done to a valid file, and what is said about it."""

    def primitive(root: dict[str, Any]) -> dict[str, Any]:
        return root["meshes"][0]["primitives"][0]

    def compress(root: dict[str, Any]) -> None:
        primitive(root)["extensions"][SPLATS]["extensions"] = {f"{SPLATS}_compression_other": {}}

    def node(**values: Any) -> Any:
        return lambda root: root["nodes"][0].update(values)

    def accessor(**values: Any) -> Any:
        return lambda root: root["accessors"][2].update(values)

    def view(**values: Any) -> Any:
        return lambda root: root["bufferViews"][2].update(values)

    def without(name: str) -> tuple[Any, str]:
        return lambda root: primitive(root)["attributes"].pop(f"{SPLATS}:{name}"), f"have no {SPLATS}:{name}"

    def of_root(**values: Any) -> Any:
        return lambda root: root.update(values)

    shear = [1, 0, 0, 0, 0.5, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
    above = [{"rotation": [0, 0.6, 0, 0.8], "children": [1]}, {"mesh": 0}]
    turn = r"nodes\[0\] rotates or scales its Gaussians; export .* apply .* with splat-transform"
    both = r"nodes\[0\] and nodes\[1\] both contain Gaussians; export .* merge .* with splat-transform"
    return {
        "compressed": (compress, "are compressed"),
        "required": (of_root(extensionsRequired=["KHR_meshopt"]), "needs the extension"),
        "mesh": (lambda root: primitive(root).update(extensions={}), "contains no Gaussians"),
        "no node": (of_root(scenes=[{"nodes": []}]), "no node of its scene contains"),
        "triangles": (lambda root: primitive(root).update(mode=4), "not points"),
        "draft": without("SCALE"),
        "partial": without("SH_DEGREE_1_COEF_1"),
        "rotation": (node(rotation=[0, 0.6, 0, 0.8]), turn),
        "rotation above": (of_root(nodes=above), turn),
        "scale": (node(scale=[2, 2, 2]), turn),
        "mirror": (node(scale=[-1, 1, 1]), turn),
        "shear": (node(matrix=shear), turn),
        "instances": (
            of_root(nodes=[{"mesh": 0, "children": [1]}, {"mesh": 0, "translation": [1, 0, 0]}]),
            both,
        ),
        "huge": (node(matrix=[10**400] + [0] * 15), "finite number"),
        "quaternion": (node(rotation=[0, 0, 0]), "expected 4 numbers"),
        "perspective": (node(matrix=[1, 0, 0, 1] + [0] * 12), turn),
        "cycle": (node(children=[0]), "below itself"),
        "two parents": (of_root(nodes=[{"mesh": 0, "children": [1, 1]}, {}]), "several parents"),
        "child": (node(children=[5]), r"nodes\[0\]\.children\[0\] is 5, but nodes has 1"),
        "count": (accessor(count=2), "different counts"),
        "counts": (lambda root: [a.update(count=2**40) for a in root["accessors"]], "beyond its buffer view"),
        "zero": (accessor(count=0), "whole number from 1"),
        "offset": (accessor(byteOffset=2**52), "beyond its buffer view"),
        "negative": (accessor(byteOffset=-4), "whole number from 0"),
        "sparse": (accessor(sparse={}), "sparse accessor"),
        "type": (accessor(type="VEC4"), r"accessors\[2\].type is 'VEC4', expected VEC3"),
        "component": (accessor(componentType=5125), "component type"),
        "view": (accessor(bufferView=99), "has 8"),
        "stride": (view(byteStride=4), "rows of .* overlap"),
        "length": (view(byteLength=2**50), "beyond its buffer"),
        "buffer": (view(buffer=1), "but buffers has 1"),
        "version": (of_root(asset={"version": "1.0"}), "other than 2"),
        "no version": (of_root(asset=3), "not glTF 2"),
        "list": (of_root(nodes={}), "nodes is an object of 0, expected a list"),
    }


@pytest.mark.parametrize("case", refusals())
def test_refusals(tmp_path, case):
    change, message = refusals()[case]
    root, binary = foreign(columns_of(some_gaussians(3, 1)))
    change(root)
    with pytest.raises(FileFormatError, match=message) as caught:
        read_gltf(packed(tmp_path / "a.glb", root, binary))
    assert "\n" not in str(caught.value)
    assert caught.value.remedy


def test_primitives_repeated_to_no_end(tmp_path):
    root, binary = foreign(columns_of(some_gaussians(3000, 0)))
    root["meshes"][0]["primitives"] *= 1000
    with pytest.raises(FileFormatError, match="repeats its Gaussians"):
        read_gltf(packed(tmp_path / "a.glb", root, binary))


def test_wrong_containers(tmp_path):
    path = tmp_path / "a.glb"
    write_gltf(some_gaussians(3, 0), path)
    data = path.read_bytes()
    size = struct.unpack_from("<I", data, 12)[0]
    for damaged, message in [
        (b"", "is empty"),
        (b"hello", "JSON is damaged"),
        (b'{"a": NaN}', "JSON is damaged"),
        (b"[" * 100_000, "JSON is damaged"),
        (b"[]", "not glTF 2"),
        (data[:11], "within its header"),
        (data[:-1], "header says"),
        (data + b"\0", "header says"),
        (data[:4] + struct.pack("<I", 1) + data[8:], "other than 2"),
        (data[:12] + struct.pack("<I", 2**32 - 1) + data[16:], "beyond its end"),
        (data[: 20 + size] + struct.pack("<I", 2**31) + data[24 + size :], "beyond its end"),
        (data[:16] + b"JSOM" + data[20:], "does not begin with JSON"),
        (data[: 24 + size] + b"BIM\0" + data[28 + size :], "has no data"),
    ]:
        path.write_bytes(damaged)
        with pytest.raises(FileFormatError, match=message):
            read_gltf(path)
    with pytest.raises(MissingFileError):
        read_gltf(tmp_path / "none.glb")
