"""Scans of an archive in memory: what ranks the things of all scans, and all that is known of some scans.

Scans are read together, in one question to DuckDB, into arrays: a question per scan takes longer than its answer.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import accumulate, groupby, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray

from scoup.archive.scan_files import FORMAT, PLACE, VERSION, Scan, ScanRecord, check_columns
from scoup.base.errors import FileFormatError, InputError, MissingFileError, check_format_version
from scoup.field.container import place_of
from scoup.query.matching import HUB_SHARE, doubts
from scoup.scene.names import NameTable
from scoup.scene.things import ThingTable, cosine_spread

if TYPE_CHECKING:
    from duckdb import DuckDBPyConnection

THINGS_AT_A_TIME = 8192  # whose vectors DuckDB returns together
_PLACES = [f"({name}::DOUBLE[{size}])[{n}]" for name, size in PLACE.items() for n in range(1, size + 1)]
_COUNTS = ("gaussians", "regions")
_STATISTICS = ("stability", "agreement", "mass", "hub")
_NUMBERS = (*_COUNTS, *_STATISTICS)
Arrays: TypeAlias = "dict[str, NDArray[Any]]"
Found = TypeVar("Found")


@dataclass(frozen=True, eq=False)
class ScanBlock:
    """S scans that were read together, with T things in all; those of a scan follow each other."""

    records: tuple[ScanRecord, ...]
    starts: list[int]  # [S + 1] first thing of each scan, and T
    vectors: NDArray[np.float32]  # [T, D]
    # [T]: the fit of a thing to a text is scale * cosine - lowered (``ComparedTable.fits``), with the words of the
    # records; infinite for things that cannot answer
    scales: NDArray[np.float32]
    lowered: NDArray[np.float32]

    def embeddings(self, number: int) -> torch.Tensor:
        """Return the embeddings of the things of a scan, [n, D] float16."""
        return torch.from_numpy(self.vectors[self.starts[number] : self.starts[number + 1]]).half()


def read_records(files: Sequence[Path], connection: DuckDBPyConnection) -> list[ScanRecord]:
    """Read the metadata of scans.

    Raises:
        FileFormatError: a file is damaged, or not a scan.
        MissingFileError: it is not there.
    """

    def read(files: Sequence[Path]) -> list[ScanRecord]:
        texts = connection.execute(
            "SELECT file_name, value FROM parquet_kv_metadata($files) WHERE key = 'scoup'",
            {"files": [str(file) for file in files]},
        ).fetchall()
        headers = dict(texts)
        return [_record(file, headers.get(str(file), b"{}")) for file in files]

    return _read(read, files, lambda file: file)


def read_blocks(records: Sequence[ScanRecord], connection: DuckDBPyConnection) -> list[ScanBlock]:
    """Read what ranks the things of scans; errors as of ``read_records``."""

    def read(records: Sequence[ScanRecord]) -> list[ScanBlock]:
        return [_block(tuple(mine), connection) for _, mine in groupby(records, lambda record: record.dim)]

    return _read(read, records, lambda record: record.file)


def read_scans(scans: Sequence[tuple[ScanBlock, int]], connection: DuckDBPyConnection) -> list[Scan]:
    """Read all that is known of some scans, each by block and number; errors as of ``read_records``."""

    def read(scans: Sequence[tuple[ScanBlock, int]]) -> list[Scan]:
        records = [block.records[number] for block, number in scans]
        columns = (*_NUMBERS, "level", "parent", *_PLACES, "len(shares)", "len(names)")
        rows = _rows(records, columns, connection)
        shares = _unnested(records, "shares", connection)
        names = _unnested(records, "names", connection) if rows["len(names)"].any() else {}
        ends = [*accumulate((record.n_things for record in records), initial=0)]
        of_shares, of_names = (
            [0, *np.cumsum(rows[f"len({name})"].astype(np.int64)).tolist()] for name in ("shares", "names")
        )
        return [
            _scan(
                record,
                block.embeddings(number),
                {name: column[start:end] for name, column in rows.items()},
                {name: column[of_shares[start] : of_shares[end]] for name, column in shares.items()},
                {name: column[of_names[start] : of_names[end]] for name, column in names.items()},
            )
            for record, (block, number), start, end in zip(records, scans, ends, ends[1:], strict=False)
        ]

    return _read(read, scans, lambda scan: scan[0].records[scan[1]].file)


def _record(file: Path, text: bytes) -> ScanRecord:
    header = json.loads(text)
    if header.get("format") != FORMAT:
        remedy = "add its field again, or remove the file"
        raise FileFormatError(file, "is a Parquet file, but not a scan of an archive", remedy)
    check_format_version(file, header["version"], VERSION)
    field_path = place_of(file.resolve(), header["field"])
    assert field_path is not None
    best_fits = np.frombuffer(base64.b64decode(header["best_fits"]), "<f4").astype(np.float32)
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
        torch.from_numpy(best_fits),
        {str(text): (float(presence), int(count)) for text, (presence, count) in header["names"].items()},
    )


def _rows(records: Sequence[ScanRecord], columns: Sequence[str], connection: DuckDBPyConnection) -> Arrays:
    """Return columns of all things of scans; NULL is NaN in statistics and places, and else -1."""
    selected = ", ".join(f"{column} AS c{number}" for number, column in enumerate(columns))
    found = connection.execute(
        f"SELECT thing, {selected} FROM read_parquet($files)",
        {"files": [str(record.file) for record in records]},
    ).fetchnumpy()
    sizes = [record.n_things for record in records]
    if min(sizes) < 1 or sum(sizes) != len(found["thing"]):
        raise InputError(f"has {len(found['thing'])} things, expected {sum(sizes)}")
    numbers = np.concatenate([np.arange(size) for size in sizes])
    if not np.array_equal(np.ma.filled(found["thing"], -1), numbers):
        raise InputError("its things are not numbered from 0 on")
    rows = {column: found[f"c{number}"] for number, column in enumerate(columns)}
    for column, values in rows.items():
        if column in _STATISTICS or column in _PLACES:
            rows[column] = np.ma.filled(values.astype(np.float64), np.nan)
        elif column != "level":
            rows[column] = np.ma.filled(values.astype(np.int64), -1)
    if any(not np.isfinite(rows[name]).all() for name in _STATISTICS if name in rows) or any(
        (rows[name] < 0).any() for name in _COUNTS
    ):
        raise InputError("a number is out of range")
    return rows


def _block(records: tuple[ScanRecord, ...], connection: DuckDBPyConnection) -> ScanBlock:
    rows = _rows(records, _NUMBERS, connection)
    starts, dim = [*accumulate((record.n_things for record in records), initial=0)], records[0].dim
    vectors = np.empty((starts[-1], dim), np.float32)
    first = 0
    while first < len(records):  # DuckDB's copy of many vectors would double the memory
        last = first + 1
        while last < len(records) and starts[last + 1] - starts[first] <= THINGS_AT_A_TIME:
            last += 1
        part = connection.execute(
            "SELECT unnest(vector) AS v FROM read_parquet($files)",
            {"files": [str(record.file) for record in records[first:last]]},
        ).fetchnumpy()["v"]
        vectors[starts[first] : starts[last]] = np.ma.filled(part, np.nan).reshape(-1, dim)
        first = last
    regions, stability, agreement = (
        torch.from_numpy(rows[name]) for name in ("regions", "stability", "agreement")
    )
    spreads = [
        cosine_spread(agreement[start:end].float(), regions[start:end], dim)
        for start, end in pairwise(starts)
    ]
    scales = 1 / np.repeat(spreads, np.diff(starts))
    lowered = HUB_SHARE * rows["hub"] * scales + doubts(regions, stability).numpy()
    squares = np.einsum("td,td->t", vectors, vectors)
    if not np.isfinite(squares).all():
        raise InputError("a vector is not finite")
    is_usable = (rows["gaussians"] > 0) & (rows["mass"] > 0) & (squares > 0)
    lowered = np.where(is_usable, lowered, np.inf)
    return ScanBlock(records, starts, vectors, scales.astype(np.float32), lowered.astype(np.float32))


def _unnested(records: Sequence[ScanRecord], column: str, connection: DuckDBPyConnection) -> Arrays:
    """Return the fields of all structures in the lists of a column, one after another."""
    return connection.execute(
        f"SELECT unnest({column}, recursive := true) FROM read_parquet($files)",
        {"files": [str(record.file) for record in records]},
    ).fetchnumpy()


def _scan(record: ScanRecord, embeddings: torch.Tensor, rows: Arrays, shares: Arrays, names: Arrays) -> Scan:
    count, levels = record.n_things, {name: place for place, name in enumerate(record.levels)}
    places = np.stack([rows[name] for name in _PLACES], 1)
    if not ((np.isfinite(places).sum(1) % places.shape[1]) == 0).all():
        raise InputError("a thing has an invalid position or box")
    given = None
    if record.names:
        of_text = {text: row for row, text in enumerate(record.names)}
        of_votes = np.repeat(np.arange(count), rows["len(names)"])
        given = NameTable(
            tuple(record.names),
            torch.tensor([presence for presence, _ in record.names.values()], dtype=torch.float32),
            torch.tensor([of_text[text] for text in names.get("name", ())], dtype=torch.int32),
            torch.from_numpy(of_votes.astype(np.int32)),
            torch.from_numpy(np.ma.filled(names.get("vote", np.zeros(0)), np.nan).astype(np.float32)),
        )
    tensors = {name: torch.from_numpy(rows[name]) for name in _NUMBERS}
    table = ThingTable(
        owners=torch.empty((0, len(levels)), dtype=torch.int32),
        levels=torch.tensor([levels[name] for name in rows["level"]], dtype=torch.uint8),
        parents=torch.from_numpy(rows["parent"]).int(),
        embeddings=embeddings,
        n_regions=tensors["regions"].int(),
        names=given,
        **{name: tensors[name].float() for name in ("stability", "agreement", "mass")},
    )
    diagonal = np.arange(count)
    of_shares = np.repeat(diagonal, rows["len(shares)"])
    others, shared = (np.ma.filled(shares[name], -1).astype(np.int64) for name in ("thing", "gaussians"))
    overlaps = torch.sparse_coo_tensor(
        torch.from_numpy(np.stack([np.append(diagonal, of_shares), np.append(diagonal, others)])),
        torch.from_numpy(np.append(rows["gaussians"], shared)).float(),
        (count, count),
        check_invariants=True,
    ).coalesce()
    sizes = tensors["gaussians"].float()
    return Scan(record, table, sizes, overlaps, tensors["hub"].float(), torch.from_numpy(places))


Item = TypeVar("Item")


def _read(
    read: Callable[[Sequence[Item]], list[Found]], items: Sequence[Item], file_of: Callable[[Item], Path]
) -> list[Found]:
    """Read all items together; if that fails, one by one, and name the file that is damaged."""
    import duckdb

    try:
        return read(items) if items else []
    except FileFormatError:
        raise
    except (duckdb.Error, ArithmeticError, AssertionError, AttributeError, LookupError, RuntimeError, TypeError,
            ValueError) as error:  # fmt: skip
        if len(items) > 1:
            return [found for item in items for found in _read(read, [item], file_of)]
        file = file_of(items[0])
        if not file.is_file():
            raise MissingFileError.of(file, "a scan of an archive") from error
        reason = (str(error) or type(error).__name__).splitlines()[0][:200]
        remedy = "add its field again, or remove the file"
        raise FileFormatError(file, f"is damaged, or not a scan of an archive ({reason})", remedy) from error
