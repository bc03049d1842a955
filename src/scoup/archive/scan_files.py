"""One scan of an archive: a Parquet file with a row per thing, written by DuckDB, for people and for conditions in SQL.
The data for comparing its things with a text is in the metadata, and their vectors are in the matrix.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load, save
from torch import Tensor

from scoup.archive.database import call, connect, patterns, quoted
from scoup.archive.scan_header import (
    COLUMNS,
    FORMAT,
    OWN_TYPES,
    VERSION,
    OwnColumns,
    check_columns,
    checksum,
    headers,
    read_each,
)
from scoup.base import FileFormatError, WorldFrame, WriteError, atomic_path
from scoup.field import NO_THING, NameTable, ThingTable, place_of
from scoup.query import OrientedBox, Thing, ThingIndex

if TYPE_CHECKING:
    from duckdb import DuckDBPyConnection

_PLACE = {"position": (3,), "box_centre": (3,), "box_axes": (3, 3), "box_extent": (3,)}
_PLAIN = {"field": str, "row": int, "vectors_checksum": int, "words": str}
"""Attributes of a scan that its metadata have as they are, and their types."""
_PER_THING = ("levels", "counts", "mass", "usable", "doubt", "spread", "hubs", "placed")
_TYPES = {"levels": torch.uint8, "usable": torch.bool, "placed": torch.bool, "ends": torch.int64,
          "others": torch.int32}  # of arrays; else float32  # fmt: skip
_OF_NAMES = ("presence", "rows", "things", "votes")


@dataclass(frozen=True, kw_only=True, eq=False)
class Scan:
    """The metadata of a scan: all of its T things together."""

    file: Path
    field: str  # its file, relative to the folder of the archive
    levels: tuple[str, ...]
    columns: OwnColumns
    world: WorldFrame  # of its field
    row: int  # of the vector of its first thing in the matrix
    vectors_checksum: int  # CRC-32
    words: str  # digest of the everyday words that its things were compared with
    texts: tuple[str, ...]  # that a model with words looked for
    arrays: Mapping[str, Tensor]
    """Those of ``ThingIndex.arrays`` and of ``NameTable``, and ``placed``, [T] boolean: things with a place."""

    def __len__(self) -> int:
        return len(self.arrays["levels"])

    @property
    def name(self) -> str:
        """Return its name."""
        return self.file.stem

    @cached_property
    def field_path(self) -> Path:
        """File of the field."""
        return place_of(self.file, self.field) or self.file

    @cached_property
    def names(self) -> NameTable | None:
        """The names that its things have."""
        return NameTable(self.texts, *map(self.arrays.__getitem__, _OF_NAMES)) if self.texts else None

    def index(self, vectors: Tensor, words: Tensor, digest: str) -> ThingIndex:
        """Return its things with their vectors [T, D], compared with words of a digest; "" if any will do."""
        known = ThingIndex.from_arrays(self.arrays, vectors, words)
        if digest not in (self.words, ""):
            return known.with_words(words)
        if digest and self.arrays["best_fits"].shape[1] != len(words):
            problem = "is damaged: its things were compared with other words than it says"
            raise FileFormatError(self.file, problem, "add its field again, or remove the file")
        return known


def arrays_of(index: ThingIndex, names: NameTable | None, placed: Tensor) -> dict[str, Tensor]:
    """Return the arrays of a scan."""
    arrays = index.arrays() | {"placed": placed}
    return arrays | ({} if names is None else {name: getattr(names, name) for name in _OF_NAMES})


def read_scans(files: Sequence[Path], connection: DuckDBPyConnection) -> list[Scan]:
    """Read the metadata of scans; errors as of ``read_each``."""

    def read(files: Sequence[Path]) -> list[Scan]:
        return [*map(_scan, files, headers(files, connection))]

    return read_each(read, files, lambda file: file)


def _scan(file: Path, header: Mapping[str, Any]) -> Scan:
    plain = {name: kind(header[name]) for name, kind in _PLAIN.items()}
    try:
        arrays = load(base64.b64decode(header["arrays"]))
    except SafetensorError as error:
        raise ValueError(f"its arrays: {error}") from error
    texts = (tuple(map(str, header[name])) for name in ("levels", "texts"))
    levels, columns = next(texts), check_columns(header["columns"])
    _check_arrays(arrays, len(levels))
    world = WorldFrame.of_header(header)
    scan = Scan(
        file=file, levels=levels, columns=columns, world=world, texts=next(texts), arrays=arrays, **plain
    )
    if scan.names is not None:
        scan.names.check(len(scan))
    if scan.row < 0:
        raise ValueError("its first row is negative")
    return scan


def _check_arrays(arrays: Mapping[str, Tensor], n_levels: int) -> None:
    """Refuse arrays that do not fit together, even if the checksum is right."""
    count, pairs = len(arrays["levels"]), len(arrays["others"])
    fits = arrays["best_fits"]
    shapes = {**dict.fromkeys(_PER_THING, (count,)), "ends": (count + 1,), "others": (pairs,),
              "gaussians": (pairs,), "best_fits": (1, fits.shape[-1])}  # fmt: skip
    for name, shape in shapes.items():
        array, wanted = arrays[name], _TYPES.get(name, torch.float32)
        # Where a scan has a single thing, words have -inf as their best fit.
        damaged = array.isnan() if name == "best_fits" else ~array.isfinite()
        if array.shape != shape or array.dtype != wanted or damaged.any():
            raise ValueError(f"{name} is not finite, or not {wanted} {list(shape)}")
    if not count or int(arrays["levels"].max()) >= n_levels:
        raise ValueError("a thing is of an unknown level")
    ends, others = arrays["ends"], arrays["others"]
    if int(ends[0]) or int(ends[-1]) != pairs or (ends.diff() < 0).any():
        raise ValueError("pairs of things are not in order")
    if not ((others >= 0) & (others < count)).all():
        raise ValueError(f"a pair names a thing beyond the {count}")


def read_places(
    wanted: Sequence[tuple[Scan, int]], connection: DuckDBPyConnection
) -> list[tuple[Tensor, OrientedBox]]:
    """Read positions [3] and boxes of things, by scan and number; errors as of ``read_each``."""

    def read(wanted: Sequence[tuple[Scan, int]]) -> list[tuple[Tensor, OrientedBox]]:
        query = (
            f"SELECT filename, thing, {', '.join(_PLACE)} FROM read_parquet($files, filename := true)"
            " WHERE list_contains($things, thing)"
        )
        asked = {
            "files": patterns({scan.file for scan, _ in wanted}),
            "things": list({thing for _, thing in wanted}),
        }
        rows = call(connection, query, asked)
        places = {(file, thing): values for file, thing, *values in rows}
        located = []
        for scan, thing in wanted:
            parts = zip(places[str(scan.file), thing], _PLACE.values(), strict=True)
            position, *box = (torch.tensor(data, dtype=torch.float64).reshape(shape) for data, shape in parts)
            located.append((position, OrientedBox(*box)))
        return located

    return read_each(read, wanted, lambda pair: pair[0].file)


def write_scan(scan: Scan, table: ThingTable, things: Sequence[Thing]) -> None:
    """Write the file of a scan, of its table and of those things that have a position, in place of the one that is
    there; another writer of the file is waited for.

    Raises:
        InputError: a column of the user's has no usable name.
        WriteError: the system refuses.
    """
    names: list[list[dict[str, Any]]] = [[] for _ in range(len(scan))]
    if (given := scan.names) is not None:
        for row, thing, vote in zip(*(scan.arrays[name].tolist() for name in _OF_NAMES[1:]), strict=True):
            names[thing].append({"name": given.texts[row], "vote": vote})
    places: dict[str, list[Any]] = {name: [None] * len(scan) for name in _PLACE}
    for thing in things:
        parts = (thing.position, thing.box.centre, thing.box.axes, thing.box.extent)
        for name, tensor in zip(_PLACE, parts, strict=True):
            places[name][thing.number or 0] = tensor.flatten().tolist()
    values: dict[str, Sequence[Any]] = {
        "scan": [scan.name] * len(scan),
        "thing": list(range(len(scan))),
        "row": list(range(scan.row, scan.row + len(scan))),
        "level": [scan.levels[level] for level in table.levels.tolist()],
        "parent": [None if parent == NO_THING else parent for parent in table.parents.tolist()],
        **places,
        "gaussians": scan.arrays["counts"].int().tolist(),
        "regions": table.n_regions.tolist(),
        "stability": table.stability.tolist(),
        "names": names,
    }
    columns = ", ".join(f"unnest(${name}::{kind}[]) AS {name}" for name, kind in COLUMNS.items())
    extra = "".join(
        f", $own_{name}::{OWN_TYPES[type(value)]} AS {name}" for name, value in scan.columns.items()
    )
    given_values = {**values, **{f"own_{name}": value for name, value in scan.columns.items()}}
    metadata = quoted(json.dumps(_header(scan)))
    table_of, connection = f"CREATE TABLE things AS SELECT {columns}{extra}", connect()
    with atomic_path(scan.file, overwrite=True, wait=True) as temporary:
        file = f"COPY things TO {quoted(str(temporary))} (FORMAT parquet, KV_METADATA {{scoup: {metadata}}})"
        try:
            call(connection, table_of, given_values)
            call(connection, file)
        except OSError as error:
            raise WriteError.of(temporary, error) from error


def _header(scan: Scan) -> dict[str, Any]:
    data = save({name: tensor.contiguous() for name, tensor in scan.arrays.items()})
    header = {
        "format": FORMAT,
        "version": VERSION,
        **{name: getattr(scan, name) for name in (*_PLAIN, "levels", "columns", "texts")},
        **scan.world.entry(),
        "arrays": base64.b64encode(data).decode(),
    }
    return {**header, "checksum": checksum(header)}
