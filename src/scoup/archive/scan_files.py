"""One scan of an archive as a Parquet file with a row per thing, written and read by DuckDB."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import torch
from torch import Tensor

from scoup.base.atomic import atomic_path
from scoup.base.errors import FileFormatError, InputError, MissingFileError, ScoupError, check_format_version
from scoup.base.locks import WAIT
from scoup.field.container import place_of, relative_place
from scoup.query.boxes import OrientedBox
from scoup.query.matching import ComparedTable
from scoup.scene.things import NO_THING, ThingTable

if TYPE_CHECKING:
    from duckdb import DuckDBPyConnection

FORMAT, VERSION = "scoup scan", 1
"""What the metadata of a Parquet file says under the key ``scoup``."""
REMEDY = "add its field again, or remove the file"
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
}
_OWN_TYPES = {str: "VARCHAR", int: "BIGINT", float: "DOUBLE"}


@dataclass(frozen=True, eq=False)
class ScanRecord:
    """What the metadata of a scan's file says."""

    name: str
    file: Path  # of the scan
    field_path: Path
    embedding_model: str
    dim: int
    levels: tuple[str, ...]
    columns: OwnColumns
    n_things: int
    words: (
        str  # digest of the everyday words, and of the rule, of the two statistics ``hub`` and ``best_fits``
    )
    best_fits: Tensor  # [B] float32 of each everyday word with a thing of this scan


@dataclass(frozen=True, eq=False)
class Scan:
    """The things of a scan, without their Gaussians."""

    record: ScanRecord
    table: ThingTable  # its ``owners`` are empty
    counts: Tensor  # [T] float32, Gaussians
    shared: Tensor  # [T, T] sparse float32, Gaussians that two things share
    hubs: Tensor  # [T] float32
    places: list[tuple[list[float] | None, ...]]  # position, centre, axes and extent of the box
    compared: dict[str, tuple[ComparedTable, Tensor]] = field(default_factory=dict)
    """Digest of words -> the things compared with them, and the best fit of each: those asked last."""

    def place(self, number: int) -> tuple[Tensor, OrientedBox] | None:
        """Return position and box of a thing; None without a usable Gaussian."""
        if self.places[number][0] is None:
            return None
        with _damage_named(self.record.file):
            parts = [torch.tensor(part, dtype=torch.float64) for part in self.places[number]]
            if not bool(torch.isfinite(torch.cat(parts)).all()) or [len(part) for part in parts] != [
                3,
                3,
                9,
                3,
            ]:
                raise InputError(f"thing {number} has an invalid position or box")
            position, centre, axes, extent = parts
            return position, OrientedBox(centre, axes.reshape(3, 3), extent)


def write_scan(scan: Scan) -> None:
    """Write the file of a scan, in place of the one that is there; another writer of the file is waited for.

    Raises:
        InputError: a column of the user's has no usable name.
        WriteError: the system refuses.
    """
    record, table, file = scan.record, scan.table, scan.record.file
    header = {
        "format": FORMAT,
        "version": VERSION,
        "field": relative_place(file.resolve(), record.field_path),
        "embedding_model": record.embedding_model,
        "dim": record.dim,
        "levels": list(record.levels),
        "columns": dict(record.columns),
        "things": record.n_things,
        "words": record.words,
        "best_fits": record.best_fits.tolist(),
    }
    shares: list[list[dict[str, int]]] = [[] for _ in range(len(table))]
    pairs = scan.shared.coalesce()
    for one, other, count in zip(*pairs.indices().tolist(), pairs.values().tolist(), strict=True):
        if one != other:
            shares[one].append({"thing": other, "gaussians": int(count)})
    places = list(zip(*scan.places, strict=True)) or [[]] * 4
    values: dict[str, Sequence[Any]] = {
        "scan": [record.name] * len(table),
        "thing": list(range(len(table))),
        "level": [record.levels[level] for level in table.levels.tolist()],
        "parent": [None if parent == NO_THING else parent for parent in table.parents.tolist()],
        **dict(zip(("position", "box_centre", "box_axes", "box_extent"), places, strict=True)),
        "gaussians": scan.counts.int().tolist(),
        "regions": table.n_regions.tolist(),
        **{name: getattr(table, name).tolist() for name in ("stability", "agreement", "mass")},
        "hub": scan.hubs.tolist(),
        "vector": table.embeddings.float().tolist(),
        "shares": shares,
    }
    columns = ", ".join(f"unnest(${name}::{kind}[]) AS {name}" for name, kind in _COLUMNS.items())
    own = "".join(
        f", $own_{name}::{_OWN_TYPES[type(value)]} AS {name}" for name, value in record.columns.items()
    )
    given = {**values, **{f"own_{name}": value for name, value in record.columns.items()}}
    metadata = _quoted(json.dumps(header))
    with atomic_path(file, overwrite=True, wait=WAIT) as temporary:
        connection = connect()
        connection.execute(f"CREATE TABLE things AS SELECT {columns}{own}", given)
        connection.execute(
            f"COPY things TO {_quoted(str(temporary))} "
            f"(FORMAT parquet, COMPRESSION zstd, KV_METADATA {{scoup: {metadata}}})"
        )


def read_record(file: Path, connection: DuckDBPyConnection) -> ScanRecord:
    """Read the metadata of a scan.

    Raises:
        FileFormatError: the file is damaged, or not a scan.
        MissingFileError: it is not there.
    """
    with _damage_named(file):
        entries = connection.execute(
            "SELECT value FROM parquet_kv_metadata($file) WHERE key = 'scoup'",
            {"file": str(file)},
        ).fetchall()
        header = json.loads(entries[0][0]) if entries else {}
        if header.get("format") != FORMAT:
            raise FileFormatError(file, "is a Parquet file, but not a scan of an archive", REMEDY)
        check_format_version(file, header["version"], VERSION)
        field_path = place_of(file.resolve(), header["field"])
        assert field_path is not None
        return ScanRecord(
            file.stem,
            file,
            field_path,
            str(header["embedding_model"]),
            int(header["dim"]),
            tuple(map(str, header["levels"])),
            check_columns(header["columns"]),
            int(header["things"]),
            str(header["words"]),
            torch.tensor(header["best_fits"], dtype=torch.float32).reshape(-1),
        )


def read_scan(record: ScanRecord, connection: DuckDBPyConnection) -> Scan:
    """Read the things of a scan; errors as of ``read_record``."""
    rows = {"file": str(record.file)}
    count, levels = record.n_things, {name: place for place, name in enumerate(record.levels)}
    with _damage_named(record.file):
        every = connection.execute(
            "SELECT thing, level, parent, regions, stability, agreement, mass, gaussians, hub, position, box_centre, "
            "box_axes, box_extent FROM read_parquet($file)",
            rows,
        ).fetchall()
        numbers, names, parents, regions, stability, agreement, mass, counts, hubs, *_ = (
            zip(*every, strict=True) if every else [()] * 13
        )
        if list(numbers) != list(range(count)):
            raise InputError(f"expected things 0 to {count - 1}")
        vectors = connection.execute("SELECT unnest(vector) AS v FROM read_parquet($file)", rows).fetchnumpy()
        embeddings = torch.from_numpy(np.ma.filled(vectors["v"], np.nan).reshape(count, record.dim))
        pairs = connection.execute(
            "SELECT thing AS one, o.thing AS other, o.gaussians AS shared "
            "FROM (SELECT thing, unnest(shares) AS o FROM read_parquet($file))",
            rows,
        ).fetchnumpy()
        one, other, shared = (
            np.ma.filled(pairs[name], -1).astype(np.int64) for name in ("one", "other", "shared")
        )
        sizes = torch.tensor(counts, dtype=torch.float32)
        diagonal = torch.arange(count)
        table = ThingTable(
            owners=torch.empty((0, len(levels)), dtype=torch.int32),
            levels=torch.tensor([levels[name] for name in names], dtype=torch.uint8),
            parents=torch.tensor(
                [NO_THING if parent is None else parent for parent in parents], dtype=torch.int32
            ),
            embeddings=embeddings.half(),
            agreement=torch.tensor(agreement, dtype=torch.float32),
            n_regions=torch.tensor(regions, dtype=torch.int32),
            mass=torch.tensor(mass, dtype=torch.float32),
            stability=torch.tensor(stability, dtype=torch.float32),
        )
        overlaps = torch.sparse_coo_tensor(
            torch.cat([torch.stack([diagonal, diagonal]), torch.from_numpy(np.stack([one, other]))], 1),
            torch.cat([sizes, torch.from_numpy(shared).float()]),
            (count, count),
            check_invariants=True,
        ).coalesce()
        known = torch.tensor(hubs, dtype=torch.float32)
        if not bool(torch.isfinite(known).all() & (sizes >= 0).all()):
            raise InputError("a number is out of range")
    return Scan(record, table, sizes, overlaps, known, [row[9:] for row in every])


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
    return columns


def _quoted(text: str) -> str:
    """Return a text as SQL."""
    return "'" + text.replace("'", "''") + "'"


@contextmanager
def _damage_named(file: Path) -> Iterator[None]:
    """Turn whatever a damaged file does into one error that names it."""
    import duckdb

    try:
        yield
    except FileFormatError:
        raise
    except (duckdb.Error, ArithmeticError, AssertionError, AttributeError, LookupError, RuntimeError, TypeError,
            ValueError) as error:  # fmt: skip
        if not file.is_file():
            raise MissingFileError.of(file, "a scan of an archive") from error
        reason = str(error).splitlines()[0][:200]
        raise FileFormatError(file, f"is damaged, or not a scan of an archive ({reason})", REMEDY) from error
