"""Region features in SCOUP's compact layout: one ``<stem>.regions`` file a view (docs/formats.md).

A safetensors file with a JSON header. Label maps are deflated after each row was XORed with the row above it,
which leaves little but zeros; embeddings are float16, or float32 on request.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from scoup.base.atomic import atomic_file
from scoup.base.errors import FileFormatError
from scoup.io.reading import MAX_IMAGE_SIDE, existing_file, safetensors_damage_named
from scoup.io.regions.manifest import SCHEMA, VERSION, read_manifest
from scoup.io.regions.views import (
    REMEDY,
    at_camera,
    check_aspect,
    refuse_without_features,
    unit_rows,
    view_files,
    warn_of_missing,
)
from scoup.scene.cameras import Camera
from scoup.scene.regions import LEVELS, RegionMap, Regions

ENDING = ".regions"
_KEY = "scoup"
_DEFLATE_LIMIT = 1040  # deflate never packs more bytes than this into one


@dataclass(frozen=True)
class CompactView:
    """What the header of a ``.regions`` file says; checked against the file.

    Attributes:
        path: the file.
        name: of the image, as the cameras call it.
        width, height: of the label maps.
        levels: level names in order.
        rows: number of embeddings of each level.
        dim: D of the embeddings.
        manifest: fingerprint of the manifest it was made under.
        photograph: SHA-256 of the photograph's file, "" if it is not known.
    """

    path: Path
    name: str
    width: int
    height: int
    levels: tuple[str, ...]
    rows: Mapping[str, int]
    dim: int
    manifest: str
    photograph: str


def holds_compact(folder: Path) -> bool:
    """Whether a folder's manifest says that its views are in the compact layout."""
    manifest = read_manifest(folder)
    return manifest is not None and manifest.layout == "compact"


def write_compact_view(
    path: Path,
    name: str,
    labels: Mapping[str, NDArray[np.int32]],
    embeddings: Mapping[str, NDArray[np.floating]],
    manifest: str = "",
    photograph: str = "",
    overwrite: bool = False,
) -> int:
    """Write the regions of one view atomically.

    Args:
        labels: level -> [H, W] row of that level's embeddings, or -1; one size for all levels.
        embeddings: level -> [R, D] float16 or float32, stored as they are.
        manifest, photograph: as in ``CompactView``.

    Returns:
        Bytes of the file.

    Raises:
        OutputExistsError, InputError: as ``atomic.check_output``.
    """
    from safetensors.numpy import save

    levels = tuple(labels)
    height, width = labels[levels[0]].shape
    tensors: dict[str, np.ndarray] = {}
    for level in levels:
        tensors[f"labels.{level}"] = np.frombuffer(_packed(labels[level], len(embeddings[level])), np.uint8)
        tensors[f"embeddings.{level}"] = np.ascontiguousarray(embeddings[level])
    header = {
        "schema": SCHEMA,
        "version": VERSION,
        "view": name,
        "width": width,
        "height": height,
        "levels": list(levels),
        "manifest": manifest,
        "photograph": photograph,
    }
    data = save(tensors, {_KEY: json.dumps(header, sort_keys=True)})
    with atomic_file(path, overwrite) as stream:
        stream.write(data)
    return len(data)


def read_compact_view(path: Path) -> CompactView:
    """The header of a ``.regions`` file.

    Raises:
        MissingFileError: there is no such file.
        FileFormatError: it is something else, damaged, or of a newer version.
    """
    with _opened(path) as stream:
        header = json.loads((stream.metadata() or {}).get(_KEY, "{}"))
        if not isinstance(header, dict) or header.get("schema") != SCHEMA:
            raise FileFormatError(path, "is not a file of region features", REMEDY)
        if int(header["version"]) > VERSION:
            problem = f"was written by a newer SCOUP (format {header['version']})"
            raise FileFormatError(path, problem, "pip install -U scoup")
        levels = tuple(str(level) for level in header["levels"])
        width, height = int(header["width"]), int(header["height"])
        if not levels or not (1 <= width <= MAX_IMAGE_SIDE and 1 <= height <= MAX_IMAGE_SIDE):
            raise FileFormatError(path, f"claims {len(levels)} levels of {width} x {height} pixels", REMEDY)
        rows: dict[str, int] = {}
        dims: set[int] = set()
        for level in levels:
            table = stream.get_slice(f"embeddings.{level}")
            count, dim = table.get_shape()
            packed = stream.get_slice(f"labels.{level}")
            if table.get_dtype() not in ("F16", "F32") or packed.get_dtype() != "U8":
                raise FileFormatError(path, f"level {level!r} has tensors of another type", REMEDY)
            if width * height * _label_type(count).itemsize > packed.get_shape()[0] * _DEFLATE_LIMIT:
                raise FileFormatError(path, f"cannot hold {width} x {height} labels", REMEDY)
            rows[level] = count
            dims.add(dim)
        if len(dims) > 1:
            raise FileFormatError(path, f"has embeddings of different sizes {sorted(dims)}", REMEDY)
        texts = (str(header.get(key, "")) for key in ("view", "manifest", "photograph"))
        name, manifest, photograph = texts
        return CompactView(path, name, width, height, levels, rows, dims.pop(), manifest, photograph)


def read_compact_labels(view: CompactView, level: str) -> NDArray[np.int32]:
    """[H, W] labels of a level, as stored.

    Raises:
        FileFormatError: they are damaged.
    """
    return _read_labels(view, (level,))[0]


def _read_labels(view: CompactView, levels: Sequence[str]) -> NDArray[np.int32]:
    """[levels, H, W] labels as stored; the file is opened once."""
    with _opened(view.path) as stream:
        packed = [stream.get_tensor(f"labels.{level}").tobytes() for level in levels]
    labels = np.empty((len(levels), view.height, view.width), np.int32)
    for level, data, out in zip(levels, packed, labels, strict=True):
        _unpack(view, level, data, out)
    return labels


def _unpack(view: CompactView, level: str, packed: bytes, out: NDArray[np.int32]) -> None:
    kind = _label_type(view.rows[level])
    wanted = view.width * view.height * kind.itemsize
    inflate = zlib.decompressobj()
    try:
        data = inflate.decompress(packed, wanted)
        # The checksum is read only after the last byte, so one more is asked for.
        rest = b"" if inflate.eof else inflate.decompress(inflate.unconsumed_tail, 1)
    except zlib.error as error:
        raise FileFormatError(view.path, f"has damaged labels ({error})", REMEDY) from error
    if len(data) != wanted or rest or not inflate.eof:
        raise FileFormatError(view.path, "has labels of another size than it says", REMEDY)
    steps = np.frombuffer(data, kind).reshape(view.height, view.width)
    values = np.bitwise_xor.accumulate(steps, axis=0)  # labels plus one
    highest = int(values.max()) - 1
    if highest >= view.rows[level]:
        problem = f"level {level!r} has labels up to {highest} for {view.rows[level]} embeddings"
        raise FileFormatError(view.path, problem, REMEDY)
    np.subtract(values, 1, out=out, dtype=np.int32, casting="unsafe")


def read_compact_embeddings(view: CompactView, level: str) -> NDArray[np.floating]:
    """[R, D] embeddings of a level, as stored."""
    with _opened(view.path) as stream:
        return stream.get_tensor(f"embeddings.{level}")


def load_compact(folder: Path, cameras: Sequence[Camera]) -> Regions:
    """Open features in the compact layout; see ``io.load_regions``."""
    manifest = read_manifest(folder)
    current = None if manifest is None else manifest.fingerprint
    views: dict[str, tuple[Camera, CompactView]] = {}
    for camera in cameras:
        path = folder / f"{camera.stem}{ENDING}"
        if not path.is_file():
            continue
        view = read_compact_view(path)
        if view.manifest != current:
            continue  # left over from settings that were given up
        if not set(LEVELS) <= set(view.levels):
            raise FileFormatError(path, f"has levels {list(view.levels)}, not s, m and l", REMEDY)
        check_aspect(path, view.width, view.height, camera)
        first = next(iter(views.values()))[1] if views else view
        if view.dim != first.dim:
            problem = f"has {view.dim} dimensions, but {first.path.name} has {first.dim}"
            raise FileFormatError(path, problem, "the features come from different models; " + REMEDY)
        views[camera.name] = (camera, view)
    if not views:
        there = [path.name for path in view_files(folder, ENDING)]
        refuse_without_features(folder, cameras, (ENDING,), there)
    warn_of_missing(folder, len(views), len(cameras))

    def load(name: str, level: str) -> RegionMap:
        camera, view = views[name]
        labels = at_camera(torch.from_numpy(read_compact_labels(view, level)), camera)
        return RegionMap(labels, embeddings(name, level))

    def embeddings(name: str, level: str) -> torch.Tensor:
        view = views[name][1]
        return unit_rows(view.path, read_compact_embeddings(view, level))

    def labels(name: str) -> torch.Tensor:
        camera, view = views[name]
        return at_camera(torch.from_numpy(_read_labels(view, LEVELS)), camera)

    return Regions(LEVELS, views, load, embeddings, labels)


def _label_type(rows: int) -> np.dtype:
    """Label plus one fits: 0 is "no region"."""
    return np.dtype("<u2" if rows < 1 << 16 else "<u4")


def _packed(labels: NDArray[np.int32], rows: int) -> bytes:
    values = (labels.astype(np.int64) + 1).astype(_label_type(rows))
    steps = values.copy()
    steps[1:] ^= values[:-1]
    return zlib.compress(steps.tobytes(), 6)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """A safetensors file of arrays; every way in which it can be damaged becomes a FileFormatError."""
    from safetensors import safe_open

    what = "a file of region features"
    existing_file(path, what)
    with safetensors_damage_named(path, what, REMEDY), safe_open(path, framework="numpy") as stream:
        yield stream
