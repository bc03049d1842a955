"""Region features in SCOUP's compact layout: one ``.regions`` file per view, at its path (docs/formats.md).

A safetensors file with a JSON header, which has checksums of itself and of every array. Label maps are deflated after
each row was XORed with the row above it, which leaves little but zeros; embeddings are float16, or float32 on request.
"""

from __future__ import annotations

import json
import os
import re
import zlib
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scoup.base import FileFormatError, JsonNode, SealedFile, check_format_version
from scoup.io.image_folder import EXTENSIONS
from scoup.io.reading import MAX_IMAGE_SIDE
from scoup.io.regions.manifest import SCHEMA, VERSION
from scoup.io.regions.views import REMEDY, ViewRegions

ENDINGS = (".regions",)  # of the files of a view, labels first
_DEFLATE_LIMIT = 1040  # deflate never packs more bytes than this into one


@dataclass(frozen=True)
class CompactView:
    """A view: the header of its file, checked against the file. Arrays are read when they are needed."""

    labels_path: Path  # of its file, as that of the embeddings
    name: str  # of the image, as the cameras call it
    width: int  # of the label maps, as the height
    height: int
    counts: dict[str, int]  # level -> number of embeddings, in order
    dim: int  # D of the embeddings
    manifest: str  # fingerprint of the manifest it was made under
    photograph: str  # SHA-256 of the photograph's file, "" if it is not known
    checksums: dict[str, str] | None  # of the arrays; None in files of before release 0.1.0

    @property
    def levels(self) -> tuple[str, ...]:
        return tuple(self.counts)

    @property
    def embeddings_path(self) -> Path:
        return self.labels_path

    def labels(self, levels: Sequence[str]) -> NDArray[np.int32]:
        """Return [levels, H, W] labels as stored; the file is opened once."""
        with _opened(self.labels_path) as file:
            packed = [self._array(file, f"labels.{level}").tobytes() for level in levels]
        labels = np.empty((len(levels), self.height, self.width), np.int32)
        for level, data, out in zip(levels, packed, labels, strict=True):
            _unpack(self, level, data, out)
        return labels

    def embeddings(self, level: str) -> NDArray[np.floating]:
        """Return [R, D] embeddings of a level, as stored."""
        with _opened(self.labels_path) as file:
            return self._array(file, f"embeddings.{level}")

    def _array(self, file: SealedFile, name: str) -> NDArray[Any]:
        array = file.stream.get_tensor(name)
        if self.checksums is not None:
            file.check_array(name, array, self.checksums.get(name))
        return array


def stem_of(name: str) -> str:
    """Return the path of an image without its ending, which stays in the folder of the features."""
    parts = [item for item in re.split(r"[\\/]", name) if item.strip(".") and not item.endswith(":")]
    *folders, last = parts or [name]
    stem, ending = os.path.splitext(last)
    return "/".join([*folders, stem if ending.lower() in EXTENSIONS else last])


def open_view(folder: Path, stem: str) -> CompactView:
    """Return a view whose file is there."""
    path = folder / f"{stem}{ENDINGS[0]}"
    with _opened(path) as file:
        header = JsonNode(path, json.loads(file.text), REMEDY)
        header.get("schema").text((SCHEMA,))
        check_format_version(path, header.get("version").value, VERSION)
        checksums, checksum = (header.get(key).value for key in ("checksums", "checksum"))
        if (checksums, checksum) != (None, None):
            file.check_header(checksum if isinstance(checksums, dict) else None)
        width, height = (header.get(key).whole(1, MAX_IMAGE_SIDE) for key in ("width", "height"))
        levels = [level.text() for level in header.get("levels").items()]
        if not levels:
            raise FileFormatError(path, "has no levels", REMEDY)
        shapes = {level: _shape_of_level(path, file.stream, level, (width, height)) for level in levels}
        dims = {dim for _, dim in shapes.values()}
        if len(dims) > 1:
            raise FileFormatError(path, f"has embeddings of different sizes {sorted(dims)}", REMEDY)
        counts = {level: count for level, (count, _) in shapes.items()}
        name, manifest, photograph = (
            str(header.get(key).value or "") for key in ("view", "manifest", "photograph")
        )
        return CompactView(
            path, name or stem, width, height, counts, dims.pop(), manifest, photograph, checksums
        )


def write_view(folder: Path, stem: str, regions: ViewRegions, manifest: str, overwrite: bool = False) -> None:
    """Write a view atomically, embeddings as they are (float16 or float32), under a manifest of this fingerprint."""
    levels = list(regions.labels)
    height, width = regions.labels[levels[0]].shape
    tensors: dict[str, np.ndarray] = {}
    for level in levels:
        kind = _label_type(len(regions.embeddings[level]))
        values = (regions.labels[level].astype(np.int64) + 1).astype(kind)
        steps = values.copy()
        steps[1:] ^= values[:-1]
        tensors[f"labels.{level}"] = np.frombuffer(zlib.compress(steps.tobytes(), 6), np.uint8)
        tensors[f"embeddings.{level}"] = np.ascontiguousarray(regions.embeddings[level])
    header = {
        "schema": SCHEMA,
        "version": VERSION,
        "view": regions.name,
        "width": width,
        "height": height,
        "levels": levels,
        "manifest": manifest,
        "photograph": regions.photograph,
    }
    SealedFile.write(folder / f"{stem}{ENDINGS[0]}", header, tensors, overwrite)


def _shape_of_level(path: Path, stream: Any, level: str, size: tuple[int, int]) -> tuple[int, int]:
    """Return number and dimension of a level's embeddings; refuses data too short for labels of that size."""
    table = stream.get_slice(f"embeddings.{level}")
    count, dim = table.get_shape()
    packed = stream.get_slice(f"labels.{level}")
    if table.get_dtype() not in ("F16", "F32") or packed.get_dtype() != "U8":
        raise FileFormatError(path, f"level {level!r} has tensors of another type", REMEDY)
    if dim < 1:  # any number of rows of nothing fits into a file
        raise FileFormatError(path, f"level {level!r} has embeddings of no dimension", REMEDY)
    if size[0] * size[1] * _label_type(count).itemsize > packed.get_shape()[0] * _DEFLATE_LIMIT:
        raise FileFormatError(path, f"cannot contain {size[0]} x {size[1]} labels", REMEDY)
    return count, dim


def _unpack(view: CompactView, level: str, packed: bytes, out: NDArray[np.int32]) -> None:
    kind = _label_type(view.counts[level])
    wanted = view.width * view.height * kind.itemsize
    inflate = zlib.decompressobj()
    try:
        data = inflate.decompress(packed, wanted)
        # The checksum is read only after the last byte: request one more.
        rest = b"" if inflate.eof else inflate.decompress(inflate.unconsumed_tail, 1)
    except zlib.error as error:
        raise FileFormatError(view.labels_path, f"has damaged labels ({error})", REMEDY) from error
    if len(data) != wanted or rest or not inflate.eof:
        raise FileFormatError(view.labels_path, "has labels of another size than its header says", REMEDY)
    steps = np.frombuffer(data, kind).reshape(view.height, view.width)
    values = np.bitwise_xor.accumulate(steps, axis=0)  # labels plus one
    highest = int(values.max()) - 1
    if highest >= view.counts[level]:
        problem = f"level {level!r} has labels up to {highest} for {view.counts[level]} embeddings"
        raise FileFormatError(view.labels_path, problem, REMEDY)
    np.subtract(values, 1, out=out, dtype=np.int32, casting="unsafe")


def _label_type(rows: int) -> np.dtype:
    """Return the type in which label plus one fits: 0 is "no region"."""
    return np.dtype("<u2" if rows < 1 << 16 else "<u4")


def _opened(path: Path) -> AbstractContextManager[SealedFile]:
    return SealedFile.open(path, "a file of region features", REMEDY)
