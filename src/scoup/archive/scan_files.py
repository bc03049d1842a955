"""One scan of an archive as a Parquet file with a row per thing, written by DuckDB."""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import torch
from torch import Tensor

from scoup.base.atomic import atomic_path
from scoup.base.errors import FileFormatError, InputError, ScoupError, check_format_version
from scoup.base.locks import WAIT
from scoup.field.container import place_of
from scoup.query.matching import ComparedTable
from scoup.scene.things import NO_THING, ThingTable

if TYPE_CHECKING:
    from duckdb import DuckDBPyConnection

FORMAT, VERSION = "scoup scan", 1
"""What the metadata of a Parquet file says under the key ``scoup``."""
OwnColumns: TypeAlias = "Mapping[str, str | int | float]"
"""What the user says of a scan: name of the column -> value in every row."""

_COLUMNS = {
    "scan": "VARCHAR",
    "thing": "INTEGER",  # its number in the field
    "level": "VARCHAR",
    "parent": "INTEGER",
    # Three numbers each, nine for the axes, row by row; NULL for things without a usable Gaussian.
    "position": "DOUBLE[]",
    "box_centre": "DOUBLE[]",
    "box_axes": "DOUBLE[]",
    "box_extent": "DOUBLE[]",
    "gaussians": "INTEGER",
    "regions": "INTEGER",
    "stability": "FLOAT",
    "agreement": "FLOAT",
    "mass": "FLOAT",
    "hub": "FLOAT",  # cosine with the everyday words that fit it best
    "vector": "FLOAT[]",  # mean embedding, of unit norm
    "shares": "STRUCT(thing INTEGER, gaussians INTEGER)[]",  # Gaussians shared with things of other levels
    "names": "STRUCT(name VARCHAR, vote FLOAT)[]",  # votes of a model with words
}
PLACE = {"position": 3, "box_centre": 3, "box_axes": 9, "box_extent": 3}
"""Columns of the place of a thing, and how many numbers each has."""
_OWN_TYPES = {str: "VARCHAR", int: "BIGINT", float: "DOUBLE"}


@dataclass(frozen=True, eq=False)
class ScanRecord:
    """What the metadata of a scan's file says."""

    name: str
    file: Path  # of the scan
    field_file: str  # relative to this one's folder
    embedding_model: str
    dim: int
    levels: tuple[str, ...]
    columns: OwnColumns
    n_things: int
    words: (
        str  # digest of the everyday words, and of the rule, of the two statistics ``hub`` and ``best_fits``
    )
    best_fits: Tensor  # [B] float32 of each everyday word with a thing of this scan
    names: Mapping[str, tuple[float, int]] = field(default_factory=dict)
    """Texts that a model with words looked for -> presence, and number of votes (``NameTable``)."""

    @cached_property
    def field_path(self) -> Path:
        """File of the field."""
        return place_of(self.file, self.field_file) or self.file


@dataclass(frozen=True, eq=False)
class Scan:
    """The things of a scan, without their Gaussians."""

    record: ScanRecord
    table: ThingTable  # its ``owners`` are empty
    counts: Tensor  # [T] float32, Gaussians
    shared: Tensor  # [T, T] sparse float32, Gaussians that two things share
    hubs: Tensor  # [T] float32
    places: Tensor  # [T, 18] float64, ``PLACE`` of each thing; NaN without a usable Gaussian
    compared: dict[str, tuple[ComparedTable, Tensor]] = field(default_factory=dict)
    """Digest of words -> the things compared with them, and the best fit of each: those asked last."""


def header_of(record: ScanRecord) -> dict[str, Any]:
    """Return a record as JSON values, for ``record_of``."""
    return {
        "format": FORMAT,
        "version": VERSION,
        "field": record.field_file,
        "embedding_model": record.embedding_model,
        "dim": record.dim,
        "levels": list(record.levels),
        "columns": dict(record.columns),
        "things": record.n_things,
        "words": record.words,
        "best_fits": base64.b64encode(record.best_fits.numpy().astype("<f4").tobytes()).decode(),
        "names": dict(record.names),
    }


def record_of(file: Path, header: Mapping[str, Any]) -> ScanRecord:
    """Return the record of a file from JSON values; a FileFormatError, LookupError, TypeError or ValueError if they
    are no scan's."""
    if header.get("format") != FORMAT:
        remedy = "add its field again, or remove the file"
        raise FileFormatError(file, "is a Parquet file, but not a scan of an archive", remedy)
    check_format_version(file, header["version"], VERSION)
    best_fits = np.frombuffer(base64.b64decode(header["best_fits"]), "<f4").astype(np.float32)
    return ScanRecord(
        file.stem,
        file,
        str(header["field"]),
        str(header["embedding_model"]),
        int(header["dim"]),
        tuple(map(str, header["levels"])),
        check_columns(header["columns"]),
        int(header["things"]),
        str(header["words"]),
        torch.from_numpy(best_fits),
        {str(text): (float(presence), int(count)) for text, (presence, count) in header["names"].items()},
    )


def write_scan(scan: Scan) -> None:
    """Write the file of a scan, in place of the one that is there; another writer of the file is waited for.

    Raises:
        InputError: a column of the user's has no usable name.
        WriteError: the system refuses.
    """
    record, table, file = scan.record, scan.table, scan.record.file
    shares: list[list[dict[str, int]]] = [[] for _ in range(len(table))]
    pairs = scan.shared.coalesce()
    for one, other, count in zip(*pairs.indices().tolist(), pairs.values().tolist(), strict=True):
        if one != other:
            shares[one].append({"thing": other, "gaussians": int(count)})
    names: list[list[dict[str, Any]]] = [[] for _ in range(len(table))]
    if (given := table.names) is not None:
        votes = (given.rows.tolist(), given.things.tolist(), given.votes.tolist())
        for row, thing, vote in zip(*votes, strict=True):
            names[thing].append({"name": given.texts[row], "vote": vote})
    ends = torch.tensor(list(PLACE.values())).cumsum(0)[:-1]
    places = {
        name: [None if row[0] != row[0] else row for row in part.tolist()]
        for name, part in zip(PLACE, scan.places.tensor_split(ends, 1), strict=True)
    }
    values: dict[str, Sequence[Any]] = {
        "scan": [record.name] * len(table),
        "thing": list(range(len(table))),
        "level": [record.levels[level] for level in table.levels.tolist()],
        "parent": [None if parent == NO_THING else parent for parent in table.parents.tolist()],
        **places,
        "gaussians": scan.counts.int().tolist(),
        "regions": table.n_regions.tolist(),
        **{name: getattr(table, name).tolist() for name in ("stability", "agreement", "mass")},
        "hub": scan.hubs.tolist(),
        "vector": table.embeddings.float().tolist(),
        "shares": shares,
        "names": names,
    }
    columns = ", ".join(f"unnest(${name}::{kind}[]) AS {name}" for name, kind in _COLUMNS.items())
    own = "".join(
        f", $own_{name}::{_OWN_TYPES[type(value)]} AS {name}" for name, value in record.columns.items()
    )
    given = {**values, **{f"own_{name}": value for name, value in record.columns.items()}}
    metadata = _quoted(json.dumps(header_of(record)))
    with atomic_path(file, overwrite=True, wait=WAIT) as temporary:
        connection = connect()
        connection.execute(f"CREATE TABLE things AS SELECT {columns}{own}", given)
        connection.execute(
            f"COPY things TO {_quoted(str(temporary))} (FORMAT parquet, KV_METADATA {{scoup: {metadata}}})"
        )


def connect(folder: Path | None = None) -> DuckDBPyConnection:
    """Open a database in memory; with a folder, conditions that users write read nothing else and write nothing.

    Raises:
        ScoupError: DuckDB is not installed.
    """
    try:
        import duckdb
    except ImportError as error:
        raise ScoupError("an archive needs the package duckdb: pip install 'scoup[archive]'") from error
    connection = duckdb.connect(":memory:")
    if folder is not None:
        connection.execute(f"SET allowed_directories = [{_quoted(str(folder.absolute()))}]")
        connection.execute("SET enable_external_access = false")
        connection.execute("SET lock_configuration = true")
    return connection


def check_columns(columns: Any) -> OwnColumns:
    """Refuse names and values that are no columns of a user's."""
    for name, value in dict(columns).items():
        if not re.fullmatch(r"[a-z][a-z0-9_]{0,62}", name) or name in _COLUMNS or name == "filename":
            raise InputError(
                f"column {str(name)[:80]!r}: expected lower-case letters, digits and _, but none of "
                f"{', '.join(_COLUMNS)}"
            )
        if type(value) not in _OWN_TYPES:
            raise InputError(f"column {name}: expected a text or a number, got {type(value).__name__}")
        if isinstance(value, int) and not -(2**63) <= value < 2**63:
            raise InputError(f"column {name}: expected an integer of at most 64 bits")
        if isinstance(value, str) and value.encode(errors="ignore").decode() != value:
            raise InputError(f"column {name}: expected a text of valid Unicode, got {value!r}")
    return columns


def _quoted(text: str) -> str:
    """Return a text as SQL."""
    return "'" + text.replace("'", "''") + "'"
