"""Word tables, files of name -> embedding: .npz, .json, .safetensors."""

from __future__ import annotations

import json
import math
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from scoup.base import FileFormatError, InputError, existing_file, foreign_kind, write_npz

MODEL_KEY = "model"  # array, JSON entry or metadata entry that may name the embedding model; never a word

_OTHER_SUFFIXES = frozenset(
    {".npy", ".pt", ".pth", ".ckpt", ".bin", ".pkl", ".txt", ".csv", ".tsv", ".yaml", ".h5", ".parquet"}
)
_FORMS = (
    "pass a table (.npz with names and vectors, .json with name: numbers, or .safetensors; scoup words writes one), "
    "or a model by folder or hub id"
)
_MAX_BYTES = 1 << 31  # a word table is small; a damaged size must not fill the memory
_RATIO, _ANY_BYTES = 20, 16 << 20  # numbers hardly shrink: what unpacks to more than both is not a table
_USE = "use a table that scoup words wrote"
_REMEDY = "the file is damaged or of another kind; write it again with scoup words"


class WordTable:
    """Names and their unit vectors."""

    def __init__(self, path: Path, names: Sequence[str], vectors: np.ndarray, model: str = "") -> None:
        self.path = path
        self.names = tuple(names)
        self.vectors = _unit_vectors(path, self.names, vectors)  # [M, D] float32
        self.model = model  # that embedded the names, "" if unknown

    @classmethod
    def of(cls, vectors: Mapping[str, Tensor | ArrayLike]) -> WordTable:
        """Return a table in memory, of name -> vector [D]."""
        if not all(isinstance(name, str) for name in vectors):
            raise InputError("a dict of text embeddings must have texts as its keys")
        try:
            rows = {name: torch.as_tensor(row).detach().cpu() for name, row in vectors.items()}
        except (TypeError, ValueError, RuntimeError) as error:
            raise InputError(f"a dict of text embeddings must contain vectors ({error})") from error
        if len({tuple(row.shape) for row in rows.values()}) != 1 or next(iter(rows.values())).dim() != 1:
            raise InputError("a dict of text embeddings must contain vectors of one length, and at least one")
        stacked = torch.stack(list(rows.values())).float().numpy()
        return cls(Path("the dict of text embeddings"), list(rows), stacked)

    @staticmethod
    def load(path: str | Path) -> WordTable:
        """Read a table; see ``save`` for one of its forms.

        Forms: .npz with arrays ``names`` [M] and ``vectors`` [M, D], or one array [D] per name; .json with
        ``{name: [numbers]}``; .safetensors with one tensor per name, or a tensor ``vectors`` and the names as a
        JSON list in its metadata entry ``names``. The embedding model may be named under ``model``.
        """
        remedy = "check the path, or name a CLIP model instead"
        path = existing_file(path, "a table of text embeddings", remedy)
        read = _READERS.get(path.suffix.lower())
        if read is None:
            raise FileFormatError(path, "is not a table of text embeddings", _FORMS)
        try:
            return read(path)
        except FileFormatError:
            raise
        except OSError as error:
            raise FileFormatError.unreadable(path, error) from error
        except Exception as error:  # zip, zlib, json, numpy and safetensors raise kinds of their own
            raise FileFormatError(path, "is not a readable table of text embeddings", _REMEDY) from error

    @classmethod
    def save(
        cls,
        path: str | Path,
        names: Sequence[str],
        vectors: Any,  # [M, D]
        overwrite: bool = False,
        model: str = "",
    ) -> None:
        """Write a table, whose name ends in .npz, with arrays ``names`` [M], all different, and ``vectors`` [M, D]
        float32, scaled to unit norm, of an embedding model."""
        cls.check_name(path)
        if len(set(names)) != len(names):
            raise InputError(f"{path}: two names of the table are the same")
        table = cls(Path(path), names, np.asarray(vectors), model)
        arrays = {"names": np.array(table.names), "vectors": table.vectors, MODEL_KEY: np.array(model)}
        write_npz(path, arrays, overwrite)

    @staticmethod
    def is_meant(model_or_table: str | Path) -> bool:
        """Return whether the text means a table file and not a model, by its extension."""
        return Path(model_or_table).suffix.lower() in _READERS

    @staticmethod
    def check_name(path: str | Path) -> None:
        """Refuse a name that no table may be written under."""
        if Path(path).suffix.lower() != ".npz":
            raise InputError(f"{path}: tables are written as .npz; change the file's extension")


def refuse_other_file(model_or_table: str) -> None:
    """Raise FileFormatError for a file, existing or by its extension, that is not a table."""
    path = Path(model_or_table)
    if path.is_file() or path.suffix.lower() in _OTHER_SUFFIXES:
        raise FileFormatError(path, "is not a table of text embeddings", _FORMS)


def _read_npz(path: Path) -> WordTable:
    arrays: dict[str, np.ndarray] = {}
    with zipfile.ZipFile(path) as archive:
        members = archive.infolist()
        most = min(_MAX_BYTES, max(_ANY_BYTES, _RATIO * path.stat().st_size))
        if sum(member.file_size for member in members) > most:
            raise FileFormatError(path, "is too large for a word table", _REMEDY)
        for member in members:
            with archive.open(member) as stream:
                arrays[member.filename.removesuffix(".npy")] = _read_array(path, stream, member.file_size)
    model = str(arrays.pop(MODEL_KEY)) if arrays.get(MODEL_KEY, np.zeros(1)).dtype.kind == "U" else ""
    if "names" in arrays and "vectors" in arrays:
        names = arrays["names"]
        if names.dtype.kind not in "US" or names.ndim != 1:
            raise FileFormatError(path, "its array 'names' is not a list of words", _REMEDY)
        words = [name.decode("utf-8") if isinstance(name, bytes) else str(name) for name in names.tolist()]
        return WordTable(path, words, arrays["vectors"], model)
    return WordTable(path, list(arrays), _stacked(path, arrays), model)


def _read_array(path: Path, stream: Any, size: int) -> np.ndarray:
    """Read one .npy member; refuse it before any memory is taken if it claims more than it has."""
    version = np.lib.format.read_magic(stream)
    header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = header(stream)
    if dtype.kind not in "fiuUS" or any(side < 0 for side in shape):
        raise FileFormatError(path, f"contains an array of type {dtype}, expected words and numbers", _REMEDY)
    if math.prod(shape) * dtype.itemsize > size:
        raise FileFormatError(path, "is cut short: an array is larger than its data", _REMEDY)
    stream.seek(0)
    return np.lib.format.read_array(stream, allow_pickle=False)


def _read_json(path: Path) -> WordTable:
    content = json.loads(path.read_bytes())
    if not isinstance(content, dict):
        raise FileFormatError(path, "is not a JSON object of name -> list of numbers", _REMEDY)
    model = content.pop(MODEL_KEY) if isinstance(content.get(MODEL_KEY), str) else ""
    rows: dict[str, np.ndarray] = {}
    for name, values in content.items():
        numbers = isinstance(values, list) and all(
            isinstance(value, (int, float)) and not isinstance(value, bool) for value in values
        )
        if not numbers:
            problem = f"is not a word table: its entry {name[:40]!r} is not a list of numbers"
            raise FileFormatError(path, *(foreign_kind(content) or (problem, _USE)))
        rows[name] = np.array(values, dtype=np.float64)
    return WordTable(path, list(rows), _stacked(path, rows), model)


def _read_safetensors(path: Path) -> WordTable:
    from safetensors import safe_open

    with safe_open(path, framework="pt") as content:
        metadata = content.metadata() or {}
        model = metadata.get(MODEL_KEY, "")
        # Through torch, which also knows the half types numpy lacks.
        tensors = {name: content.get_tensor(name).float().numpy() for name in content.keys()}  # noqa: SIM118
    if "names" in metadata and "vectors" in tensors:
        names = json.loads(metadata["names"])
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise FileFormatError(path, "its metadata entry 'names' is not a JSON list of words", _REMEDY)
        return WordTable(path, names, tensors["vectors"], model)
    return WordTable(path, list(tensors), _stacked(path, tensors), model)


_READERS = {".npz": _read_npz, ".json": _read_json, ".safetensors": _read_safetensors}


def _stacked(path: Path, rows: dict[str, np.ndarray]) -> np.ndarray:
    if not rows:
        raise FileFormatError(path, "contains no names", _REMEDY)
    shapes = {row.shape for row in rows.values()}
    if len(shapes) > 1 or len(next(iter(shapes))) != 1:
        problem = "is not a word table: its entries are not vectors of one length"
        raise FileFormatError(path, *(foreign_kind(rows) or (problem, _USE)))
    return np.stack(list(rows.values()))


def _unit_vectors(path: Path, names: tuple[str, ...], vectors: np.ndarray) -> np.ndarray:
    if vectors.ndim != 2 or len(vectors) != len(names) or vectors.dtype.kind not in "fiu":
        raise FileFormatError(
            path, f"{len(names)} names but vectors of shape {list(vectors.shape)} ({vectors.dtype})", _REMEDY
        )
    if not len(names) or vectors.shape[1] == 0:
        raise FileFormatError(path, "contains no vectors", _REMEDY)
    wide = vectors.astype(np.float64)
    norms = np.linalg.norm(wide, axis=1)
    bad = ~np.isfinite(norms) | (norms == 0)
    if bad.any():
        name = names[int(bad.argmax())][:40]
        raise FileFormatError(path, f"the vector of {name!r} is zero or not finite", "encode that name again")
    return (wide / norms[:, None]).astype(np.float32)
