"""Damaged files of splats and checkpoints: a table for the test of damage."""

from __future__ import annotations

import gzip
import importlib.util
import json
import pickle
import re
import struct
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from foreign_samples import captured, save_splatfacto
from gltf_samples import SPLATS, columns_of, foreign, packed, spz_in_gltf
from io_samples import ply_file, raw_columns, save_checkpoint, save_compressed_ply, some_gaussians
from scoup.io import load_gaussians, read_autoencoder, read_langsplat, save_gaussians, write_gltf
from scoup.io.splats.formats import FORMATS
from scoup.io.splats.gltf import read_gltf
from scoup.io.splats.ply import read_ply
from scoup.io.splats.splat import read_splat
from scoup.models import WordTable

Change = Callable[[bytes], bytes]


@dataclass(frozen=True)
class Kind:
    """A kind of file, and what can be wrong with it."""

    make: Callable[[Path, Any], Path]  # writes a file with one of the damages into a folder
    read: Callable[[Path], object]
    damages: dict[str, Any]


def swapped(old: bytes, new: bytes) -> Change:
    return lambda whole: whole.replace(old, new)


def altered(name: str, write: Callable[[Path], object]) -> Callable[[Path, Change], Path]:
    """Return a function that writes a valid file and changes its bytes."""

    def make(folder: Path, change: Change) -> Path:
        write(folder / name)
        return written(name, folder, change((folder / name).read_bytes()))

    return make


# ---- any format, as a whole

WHOLE = {
    "empty": lambda _: b"", "byte": lambda whole: whole[:1], "half": lambda whole: whole[: len(whole) // 2 - 1],
    "reversed": lambda whole: whole[::-1],
}  # fmt: skip
HAVE_GAUSSFORGE = importlib.util.find_spec("gaussforge") is not None
ENDINGS = [
    ending
    for kind in FORMATS.values()
    if kind.read and kind.write and (kind.extra != "splats" or HAVE_GAUSSFORGE)
    for ending in kind.endings
]
"""Of formats that are read and written here."""


def of_ending(ending: str) -> Kind:
    make = altered(f"a{ending}", lambda path: save_gaussians(some_gaussians(40), path))
    damages = [name for name in WHOLE if (ending, name) != (".splat", "reversed")]  # which is a valid one
    return Kind(make, load_gaussians, {name: WHOLE[name] for name in damages})


# ---- PLY


def columns(gone: str, *added: str, rest: int = 0) -> dict[str, np.ndarray]:
    """Without some columns, and with others."""
    kept = {name: column for name, column in raw_columns(rest=rest).items() if not re.fullmatch(gone, name)}
    return kept | dict.fromkeys(added, np.zeros(5, np.uint8))


PLY = {
    "cut": lambda whole: whole[:-1], "long": swapped(b"vertex 5", b"vertex 1000000000000"),
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
    "cut": record()[:-1], "beyond": record() * 9 + record(scale=(0.1, 2e9, 0.1)),
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
    "zip": b"PK\x03\x04", "short": gzip.compress(b"abc"),
    "other": gzip.compress(b"these are not the bytes you are looking for"),
    "version 9": spz(9, 1, 0, body=bytes(20)), "degree 7": spz(3, 1, 7, body=bytes(20)),
    "two": spz(3, 2, 0, body=bytes(20)), "a byte more": spz(3, 1, 0, body=bytes(21)),
    "no checksum": spz(3, 1, 0, body=bytes(20))[:-8],
    "short extension": spz(3, 1, 0, 2, bytes(23)), "axes 17": spz(3, 1, 0, 2, bytes(20) + AXES + b"\x11\0\0\0"),
    "no table": streams(32), "table within": streams(8, 90), "no positions": streams(32, 90),
    "no streams": struct.pack("<IIIBBBB", 0x5053474E, 3, 1, 0, 12, 0, 5),
}  # fmt: skip

# ---- glTF

Root = dict[str, Any]


def damaged_gltf(folder: Path, damage: tuple[str, Root]) -> Path:
    """Give a part of the JSON other values; those that are None are removed."""
    root, binary = foreign(columns_of(some_gaussians(3, 1)))
    part: Any = root
    for key in damage[0].split():
        part = part[int(key) if key.isdigit() else key]
    part.update(damage[1])
    for name in [name for name, value in damage[1].items() if value is None]:
        del part[name]
    return packed(folder / "a.glb", root, binary)


COMPRESSION = {SPLATS: {"extensions": {f"{SPLATS}_compression_other": {}}}}
SHEAR = [1, 0, 0, 0, 0.5, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
NODE, ACCESSOR, VIEW, PRIMITIVE = "nodes 0", "accessors 2", "bufferViews 2", "meshes 0 primitives 0"
VALID, _ = foreign(columns_of(some_gaussians(3, 1)))
GLTF: dict[str, tuple[str, Root]] = {
    "compressed": (PRIMITIVE, {"extensions": COMPRESSION}), "mesh": (PRIMITIVE, {"extensions": {}}),
    "triangles": (PRIMITIVE, {"mode": 4}), "draft": (f"{PRIMITIVE} attributes", {f"{SPLATS}:SCALE": None}),
    "partial": (f"{PRIMITIVE} attributes", {f"{SPLATS}:SH_DEGREE_1_COEF_1": None}),
    "required": ("", {"extensionsRequired": ["KHR_meshopt"]}), "no node": ("", {"scenes": [{"nodes": []}]}),
    "stretch": (NODE, {"scale": [2, 1, 2]}),
    "mirror": (NODE, {"scale": [-1, 1, 1]}), "shear": (NODE, {"matrix": SHEAR}),
    "instances": ("", {"nodes": [{"mesh": 0, "children": [1]}, {"mesh": 0, "translation": [1, 0, 0]}]}),
    "huge": (NODE, {"matrix": [10**400] + [0] * 15}), "quaternion": (NODE, {"rotation": [0, 0, 0]}),
    "perspective": (NODE, {"matrix": [1, 0, 0, 1] + [0] * 12}), "cycle": (NODE, {"children": [0]}),
    "child": (NODE, {"children": [5]}), "two parents": ("", {"nodes": [{"mesh": 0, "children": [1, 1]}, {}]}),
    "count": (ACCESSOR, {"count": 2}), "zero": (ACCESSOR, {"count": 0}), "offset": (ACCESSOR, {"byteOffset": 2**52}),
    "counts": ("", {"accessors": [{**each, "count": 2**40} for each in VALID["accessors"]]}),
    "negative": (ACCESSOR, {"byteOffset": -4}), "sparse": (ACCESSOR, {"sparse": {}}),
    "type": (ACCESSOR, {"type": "VEC4"}), "component": (ACCESSOR, {"componentType": 5125}),
    "view": (ACCESSOR, {"bufferView": 99}), "stride": (VIEW, {"byteStride": 4}), "buffer": (VIEW, {"buffer": 1}),
    "length": (VIEW, {"byteLength": 2**50}), "version": ("", {"asset": {"version": "1.0"}}),
    "no version": ("", {"asset": 3}), "list": ("", {"nodes": {}}),
    "repeated": ("meshes 0", {"primitives": VALID["meshes"][0]["primitives"] * 3000}),
}  # fmt: skip


def write_whole_numbers(path: Path) -> None:
    """Whose JSON takes as many bytes on every machine."""
    write_gltf(replace(some_gaussians(3, 0), means=torch.arange(9.0).view(3, 3)), path)


GLB: dict[str, Change] = {
    "hello": lambda _: b"hello", "NaN": lambda _: b'{"a": NaN}', "deep": lambda _: b"[" * 100_000,
    "list": lambda _: b"[]", "header": lambda whole: whole[:11], "cut": lambda whole: whole[:-1],
    "long": lambda whole: whole + b"\0", "version": lambda whole: whole[:4] + struct.pack("<I", 1) + whole[8:],
    "JSON beyond": lambda whole: whole[:12] + struct.pack("<I", 2**32 - 1) + whole[16:],
    "data beyond": lambda whole: re.sub(rb"(?s)....BIN\0", b"\0\0\0\x80BIN\0", whole),
    "JSOM": swapped(b"JSON", b"JSOM"), "BIM": swapped(b"BIN\0", b"BIM\0"),
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


class Runs:
    """Is not to be run by reading."""

    def __reduce__(self) -> Any:
        return print, ("this was run",)


def torch_file(name: str, folder: Path, content: Any) -> Path:
    torch.save(content, folder / name)
    return folder / name


def pickled(folder: Path, content: bytes) -> Path:
    """A checkpoint whose pickle is another."""
    path = folder / "a.pt"
    torch_file("valid.pt", folder, {"a": torch.zeros(4)})
    with zipfile.ZipFile(folder / "valid.pt") as valid, zipfile.ZipFile(path, "w") as made:
        for entry in valid.infolist():
            ours = entry.filename.endswith("data.pkl")
            made.writestr(entry.filename, content if ours else valid.read(entry))
    return path


def claiming_entries(folder: Path) -> Path:
    """Entries of an archive that claim more bytes than there are: packed, and unpacked as before."""
    content = bytearray(pickled(folder, b"\x80\x02}.").read_bytes())
    for entry in [found.start() for found in re.finditer(b"PK\1\2", content)]:
        content[entry + 20 : entry + 24] = (2**31 - 1).to_bytes(4, "little")
    return written("a.pt", folder, bytes(content))


def makes_memory(name: bytes) -> Callable[[Path], Path]:
    """A pickle that asks for any amount of memory."""
    call = b"\x80\x02c" + name + b"\n\x8a\x05" + (10**10).to_bytes(5, "little") + b"\x85R."
    return lambda folder: pickled(folder, call)


def splats(**changes: Any) -> Callable[[Path], Path]:
    return lambda folder: save_checkpoint(some_gaussians(4), folder / "a.pt", **changes)


def content(value: Any) -> Callable[[Path], Path]:
    return partial(torch_file, "a.pt", content=value)


CLAIMED = {"means": torch.zeros(1).expand(10**9, 3), "quats": torch.zeros(1).expand(10**9, 4)}
GSPLAT: dict[str, Callable[[Path], Path]] = {
    "model": content({"model": 1}), "list": content([1, 2]), "number": content({"splats": 3}),
    "means alone": content({"splats": {"means": torch.zeros(2, 3)}}), "objects": content({"splats": Runs()}),
    "bare": lambda folder: written("a.pt", folder, pickle.dumps({"splats": 1})), "entries": claiming_entries,
    "columns": splats(quats=torch.zeros(4, 3)), "rows": splats(scales=torch.zeros(3, 3)),
    "integers": splats(means=torch.zeros(4, 3, dtype=torch.int64)), "claimed": splats(**CLAIMED),
    "degree": splats(shN=torch.zeros(4, 4, 3)),
    **{name.decode().replace("\n", "."): makes_memory(name) for name in (
        b"builtins\nbytearray", b"torch\nFloatTensor", b"torch\nTensor", b"torch.storage\nUntypedStorage",
        b"torch.sparse\nFloatTensor")},
}  # fmt: skip


def damaged_splatfacto(folder: Path, changes: dict[str, Any] | None) -> Path:
    path = folder / "step-000000009.ckpt"
    save_splatfacto(some_gaussians(9, 0), path)
    valid = torch.load(path, weights_only=True)["pipeline"]
    return torch_file(path.name, folder, {"pipeline": None if changes is None else {**valid, **changes}})


def damaged_langsplat(folder: Path, damage: tuple[slice, list[Any]]) -> Path:
    entries = list(captured(some_gaussians(7, 1))[0])
    entries[damage[0]] = damage[1]
    return torch_file("a.pth", folder, (tuple(entries), 10000))


LANGSPLAT = {
    name: (slice(place, place + 1), [value]) for name, place, value in (
        ("features", 1, torch.zeros(6, 3)), ("logits", 7, torch.zeros(7, 9)), ("codebooks", 8, torch.zeros(8, 16)),
        ("nan", 8, torch.full((1, 8, 16), torch.nan)), ("claimed", 1, torch.zeros(1, 1).expand(10**9, 3)),
        ("text", 4, "scales"), ("objects", 13, Runs()),
    )
} | {"no features": (slice(7, 9), []), "five": (slice(5, None), [])}  # fmt: skip
AUTOENCODER = {
    "encoder": {"encoder.0.weight": torch.zeros(3, 3)}, "bias": {"decoder.0.weight": torch.zeros(3, 3)},
    "sizes": {"decoder.0.weight": torch.zeros(4, 3), "decoder.0.bias": torch.zeros(4),
              "decoder.2.weight": torch.zeros(5, 9), "decoder.2.bias": torch.zeros(5)},
    "list": [1, 2], "objects": nn.Linear(2, 2),
}  # fmt: skip

SPLATFACTO = {
    "scales": {"_model.gauss_params.scales": torch.zeros(8, 3)}, "pipeline": None,
    "four scales": {"_model.gauss_params.scales": torch.zeros(9, 4)},
    "appearance": {"_model.gauss_params.features_dc": None, "_model.gauss_params.colors": torch.zeros(9, 3)},
}  # fmt: skip

# ---- of other programs


def stored_as_they_are(folder: Path, names: str, count: int = 60) -> Path:
    """A PLY whose exporter forgot the logarithm or the logit of some properties."""
    columns = raw_columns(count, seed=1)
    for name, values in columns.items():
        if re.fullmatch(names, name):
            columns[name] = 1 / (1 + np.exp(-3 * values)) if name == "opacity" else np.exp(values - 3)
    return ply_file(folder / "a.ply", columns)


def file_of_others(folder: Path, entries: str) -> Path:
    """JSON or .npz with these entries."""
    name, *keys = entries.split()
    values: dict[str, Any] = {key: [[1.0, 2.0]] for key in keys}
    np.savez(folder / "a.npz", **values)
    (folder / "a.json").write_text(json.dumps(values))
    return (folder / f"a{Path(name).suffix}").rename(folder / name)


OTHERS = {entries.split()[0]: entries for entries in (
    "metadata.json fps K poses", "camera_path.json camera_path", "params.npz means3D log_scales cam_trans",
    "compression.json means scales quats sh0", "meta.json version count means scales sh0",
    "dataparser.json transform scale",
    "sfm_data.json sfm_data_version views", "cameras.json poses views", "reconstruction.json cameras reference_lla",
    "coco.json images annotations categories", "frame.json info objects",
)}  # fmt: skip


KINDS = {
    **{f"whole {ending}": of_ending(ending) for ending in ENDINGS},
    "PLY": Kind(altered("a.ply", lambda path: ply_file(path, raw_columns())), read_ply, PLY),
    "ASCII PLY": Kind(
        altered("a.ply", lambda path: ply_file(path, raw_columns(), "ascii")), read_ply, ASCII_PLY
    ),
    "columns of PLY": Kind(lambda folder, found: ply_file(folder / "a.ply", found), load_gaussians, COLUMNS),
    "compressed PLY": Kind(altered("a.ply", save_compressed_ply), read_ply, COMPRESSED),
    ".splat": Kind(partial(written, "a.splat"), read_splat, SPLAT),
    ".spz": Kind(partial(written, "a.spz"), load_gaussians, SPZ),
    "glTF": Kind(damaged_gltf, read_gltf, GLTF),
    ".glb": Kind(altered("a.glb", write_whole_numbers), read_gltf, GLB),
    "buffer of glTF": Kind(damaged_buffer, read_gltf, {uri: uri for uri in URIS}),
    "spz in glTF": Kind(damaged_spz_in_gltf, read_gltf, {"bytes": "bytes", "degree": "degree"}),
    "gsplat": Kind(lambda folder, make: make(folder), load_gaussians, GSPLAT),
    "nerfstudio": Kind(damaged_splatfacto, load_gaussians, SPLATFACTO),
    "LangSplatV2": Kind(damaged_langsplat, read_langsplat, LANGSPLAT),
    "stored as they are": Kind(
        stored_as_they_are, load_gaussians, {name: name for name in ("opacity|scale_.", "opacity", "scale_.")}
    ),
    "others": Kind(file_of_others, WordTable.load, OTHERS),
    "others as splats": Kind(
        file_of_others,
        load_gaussians,
        {name: OTHERS[name] for name in ("params.npz", "compression.json", "meta.json")},
    ),
    "autoencoder": Kind(partial(torch_file, "a.pth"), read_autoencoder, AUTOENCODER),
}
