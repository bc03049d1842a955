"""Damaged files of splats, of every format: a table for the test of damage."""

from __future__ import annotations

import gzip
import json
import re
import struct
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from gltf_samples import SPLATS, columns_of, foreign, packed, spz_in_gltf
from io_samples import ply_file, raw_columns, save_compressed_ply, some_gaussians
from scoup.io import load_gaussians
from scoup.io.splats.gltf import read_gltf
from scoup.io.splats.gltf_write import write_gltf
from scoup.io.splats.ply import read_ply
from scoup.io.splats.splat import read_splat

Change = Callable[[bytes], bytes]


@dataclass(frozen=True)
class Kind:
    """A kind of file, and what can be wrong with it."""

    make: Callable[[Path, Any], Path]  # writes a file with one of the damages into a folder
    read: Callable[[Path], object]
    damages: dict[str, Any]


def swapped(old: bytes, new: bytes) -> Change:
    return lambda whole: whole.replace(old, new)


# ---- PLY


def damaged_ply(folder: Path, change: Change, encoding: str = "binary_little_endian") -> Path:
    path = ply_file(folder / "a.ply", raw_columns(5), encoding)
    path.write_bytes(change(path.read_bytes()))
    return path


def damaged_compressed(folder: Path, change: Change) -> Path:
    save_compressed_ply(folder / "a.ply", count=300)
    (folder / "a.ply").write_bytes(change((folder / "a.ply").read_bytes()))
    return folder / "a.ply"


def columns(gone: str, *added: str, rest: int = 0) -> dict[str, np.ndarray]:
    """Without some columns, and with others."""
    kept = {name: column for name, column in raw_columns(rest=rest).items() if not re.fullmatch(gone, name)}
    return kept | dict.fromkeys(added, np.zeros(5, np.uint8))


PLY = {
    "cut": lambda whole: whole[:-1], "long": swapped(b"vertex 5", b"vertex 1000000000000"), "empty": lambda _: b"",
    "no end": swapped(b"end_header", b"end_huader"), "twice": swapped(b"property float y", b"property float x"),
    "list": swapped(b"property float x", b"property list uchar float x"),
}  # fmt: skip
ASCII_PLY = {
    "row": lambda whole: b"\n".join(whole.splitlines()[:-1]), "word": lambda whole: whole[:-9] + b"kettle\n",
}  # fmt: skip
COLUMNS = {
    "opacity": columns("opacity"), "harmonics": columns("", rest=5), "cloud": columns("(?![xyz]).*"),
    "rotation": columns("rot_."), "red": columns("f_dc_.", "red"), "scale": columns("scale_0"),
    "anchors": columns("f_dc_.", "f_anchor_feat_0", "scale_3"),
    "mesh": columns("(scale|rot|f_dc)_.|opacity", "red", "green", "blue"),
}  # fmt: skip
COMPRESSED = {
    "chunks": swapped(b"element chunk 2", b"element chunk 1"), "names": swapped(b"min_scale_y", b"min_scale_q"),
}  # fmt: skip

# ---- .splat


def record(
    center: tuple[float, ...] = (1.0, 2.0, 3.0),
    scale: tuple[float, ...] = (0.1, 0.2, 0.3),
    color: tuple[int, ...] = (255, 128, 0, 51),
    rotation: tuple[int, ...] = (255, 128, 128, 128),
) -> bytes:
    return struct.pack("<6f8B", *center, *scale, *color, *rotation)


def written(name: str, folder: Path, content: bytes) -> Path:
    (folder / name).write_bytes(content)
    return folder / name


def beginning(start: bytes) -> bytes:
    """A whole number of rows that begins like a file of another kind."""
    return start + np.random.default_rng(0).bytes(-len(start) % 32 + 64 * (len(start) < 60))


SPLAT = {
    "cut": record()[:-1], "empty": b"", "beyond": record() * 9 + record(scale=(0.1, 2e9, 0.1)),
    "ksplat": beginning(struct.pack("<2B2x4IH", 0, 1, 1, 0, 0, 64, 0)),  # as gaussforge writes it
    "gzip": beginning(b"\x1f\x8b\x08\0"), "zip": beginning(b"PK\x03\x04"), "spz": beginning(b"NGSP\4\0\0\0"),
    "ply": beginning(b"ply\nformat binary_little_endian 1.0\n"), "glb": beginning(b"glTF\2\0\0\0"),
    "page": beginning(b"\xef\xbb\xbf\n<!DOCTYPE html>" + b" " * 99), "JSON": beginning(b'{"a": 1}' + b" " * 88),
    "text": beginning(b"404: Not Found\n" + b" " * 81),
}  # fmt: skip

# ---- .spz

AXES = struct.pack("<II", 0xADBE0003, 4)


def spz(version: int, count: int, degree: int, flags: int = 0, body: bytes = b"") -> bytes:
    head = struct.pack("<IIIBBBB", 0x5053474E, version, count, degree, 12, flags, 0)
    return gzip.compress(head + body, mtime=0)


def streams(table: int, rest: int = 0) -> bytes:
    """Version 4: one Gaussian, five streams, and a table of them at a place."""
    return struct.pack("<IIIBBBBI12x", 0x5053474E, 4, 1, 0, 12, 0, 5, table) + bytes(rest)


SPZ = {
    "nothing": b"", "zip": b"PK\x03\x04", "short": gzip.compress(b"abc"),
    "other": gzip.compress(b"these are not the bytes you are looking for"),
    "version 9": spz(9, 1, 0, body=bytes(20)), "degree 7": spz(3, 1, 7, body=bytes(20)),
    "two": spz(3, 2, 0, body=bytes(20)), "a byte more": spz(3, 1, 0, body=bytes(21)),
    "short extension": spz(3, 1, 0, 2, bytes(23)), "axes 17": spz(3, 1, 0, 2, bytes(20) + AXES + b"\x11\0\0\0"),
    "no table": streams(32), "table within": streams(8, 90), "no positions": streams(32, 90),
    "no streams": struct.pack("<IIIBBBB", 0x5053474E, 3, 1, 0, 12, 0, 5),
}  # fmt: skip

# ---- glTF

Root = dict[str, Any]


def damaged_gltf(folder: Path, change: Callable[[Root], object]) -> Path:
    root, binary = foreign(columns_of(some_gaussians(3, 1)))
    change(root)
    return packed(folder / "a.glb", root, binary)


def primitive(root: Root) -> Root:
    return root["meshes"][0]["primitives"][0]


def of_root(**values: Any) -> Callable[[Root], object]:
    return lambda root: root.update(values)


def node(**values: Any) -> Callable[[Root], object]:
    return lambda root: root["nodes"][0].update(values)


def accessor(**values: Any) -> Callable[[Root], object]:
    return lambda root: root["accessors"][2].update(values)


def view(**values: Any) -> Callable[[Root], object]:
    return lambda root: root["bufferViews"][2].update(values)


def without(name: str) -> Callable[[Root], object]:
    return lambda root: primitive(root)["attributes"].pop(f"{SPLATS}:{name}")


COMPRESSION = {SPLATS: {"extensions": {f"{SPLATS}_compression_other": {}}}}
SHEAR = [1, 0, 0, 0, 0.5, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
GLTF = {
    "compressed": lambda root: primitive(root).update(extensions=COMPRESSION),
    "required": of_root(extensionsRequired=["KHR_meshopt"]), "no node": of_root(scenes=[{"nodes": []}]),
    "mesh": lambda root: primitive(root).update(extensions={}),
    "triangles": lambda root: primitive(root).update(mode=4),
    "draft": without("SCALE"), "partial": without("SH_DEGREE_1_COEF_1"), "rotation": node(rotation=[0, 0.6, 0, 0.8]),
    "rotation above": of_root(nodes=[{"rotation": [0, 0.6, 0, 0.8], "children": [1]}, {"mesh": 0}]),
    "scale": node(scale=[2, 2, 2]), "mirror": node(scale=[-1, 1, 1]), "shear": node(matrix=SHEAR),
    "instances": of_root(nodes=[{"mesh": 0, "children": [1]}, {"mesh": 0, "translation": [1, 0, 0]}]),
    "huge": node(matrix=[10**400] + [0] * 15), "quaternion": node(rotation=[0, 0, 0]),
    "perspective": node(matrix=[1, 0, 0, 1] + [0] * 12), "cycle": node(children=[0]), "child": node(children=[5]),
    "two parents": of_root(nodes=[{"mesh": 0, "children": [1, 1]}, {}]), "count": accessor(count=2),
    "counts": lambda root: [each.update(count=2**40) for each in root["accessors"]], "zero": accessor(count=0),
    "offset": accessor(byteOffset=2**52), "negative": accessor(byteOffset=-4), "sparse": accessor(sparse={}),
    "type": accessor(type="VEC4"), "component": accessor(componentType=5125), "view": accessor(bufferView=99),
    "stride": view(byteStride=4), "length": view(byteLength=2**50), "buffer": view(buffer=1),
    "version": of_root(asset={"version": "1.0"}), "no version": of_root(asset=3), "list": of_root(nodes={}),
    "repeated": lambda root: root["meshes"][0].update(primitives=[primitive(root)] * 3000),
}  # fmt: skip


def damaged_glb(folder: Path, change: Callable[[bytes, int], bytes]) -> Path:
    """``change`` takes the content, and where its JSON ends."""
    # Whole numbers, which take as many bytes of its JSON on every machine.
    write_gltf(replace(some_gaussians(3, 0), means=torch.arange(9.0).view(3, 3)), folder / "a.glb")
    data = (folder / "a.glb").read_bytes()
    return written("a.glb", folder, change(data, 20 + struct.unpack_from("<I", data, 12)[0]))


GLB = {
    "empty": lambda data, end: b"", "hello": lambda data, end: b"hello", "NaN": lambda data, end: b'{"a": NaN}',
    "deep": lambda data, end: b"[" * 100_000, "list": lambda data, end: b"[]", "header": lambda data, end: data[:11],
    "cut": lambda data, end: data[:-1], "long": lambda data, end: data + b"\0",
    "version": lambda data, end: data[:4] + struct.pack("<I", 1) + data[8:],
    "JSON beyond": lambda data, end: data[:12] + struct.pack("<I", 2**32 - 1) + data[16:],
    "data beyond": lambda data, end: data[:end] + struct.pack("<I", 2**31) + data[end + 4 :],
    "JSOM": lambda data, end: data[:16] + b"JSOM" + data[20:],
    "BIM": lambda data, end: data[: end + 4] + b"BIM\0" + data[end + 8 :],
}  # fmt: skip


def damaged_buffer(folder: Path, uri: str) -> Path:
    """A buffer elsewhere, in a folder with a secret beside it."""
    root, binary = foreign(columns_of(some_gaussians(4, 1)))
    (folder / "scene" / "data").mkdir(parents=True)
    (folder / "scene" / "data" / "short.bin").write_bytes(binary[:-1])
    (folder / "secret.bin").write_bytes(binary)
    (folder / "scene" / "data" / "link.bin").symlink_to(folder / "secret.bin")
    buffers = [{"byteLength": len(binary), "uri": uri.replace("FOLDER", str(folder))}]
    return written("scene/a.gltf", folder, json.dumps({**root, "buffers": buffers}).encode())


URIS = [
    "../secret.bin", "data/../../secret.bin", "%2E%2E/secret.bin", "data/link.bin", "FOLDER/secret.bin", "a%00b", "",
    "file://FOLDER/secret.bin", "https://localhost/a.bin", "data\\a.bin", "data/short.bin", "data:text/plain,hello",
    "data:application/octet-stream;base64,????",
]  # fmt: skip


def damaged_spz_in_gltf(folder: Path, damage: str) -> Path:
    if damage == "degree":
        return spz_in_gltf(folder, some_gaussians(30, 4), version=4)
    path = spz_in_gltf(folder, some_gaussians(30, 1))
    path.write_bytes(path.read_bytes()[:-200] + bytes(200))
    return path


KINDS = {
    "PLY": Kind(damaged_ply, read_ply, PLY),
    "ASCII PLY": Kind(partial(damaged_ply, encoding="ascii"), read_ply, ASCII_PLY),
    "columns of PLY": Kind(lambda folder, found: ply_file(folder / "a.ply", found), load_gaussians, COLUMNS),
    "compressed PLY": Kind(damaged_compressed, read_ply, COMPRESSED),
    ".splat": Kind(partial(written, "a.splat"), read_splat, SPLAT),
    ".spz": Kind(partial(written, "a.spz"), load_gaussians, SPZ),
    "glTF": Kind(damaged_gltf, read_gltf, GLTF),
    ".glb": Kind(damaged_glb, read_gltf, GLB),
    "buffer of glTF": Kind(damaged_buffer, read_gltf, {uri: uri for uri in URIS}),
    "spz in glTF": Kind(damaged_spz_in_gltf, read_gltf, {"bytes": "bytes", "degree": "degree"}),
}
