"""Scans of an archive in memory: all that is known of their things, in arrays that many scans share.

Scans are read together, many in one question to DuckDB: a question per scan takes longer than its answer.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, groupby, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from scoup.archive.scan_files import PLACE, Scan, ScanRecord, record_of
from scoup.base.errors import FileFormatError, InputError, MissingFileError
from scoup.base.existing import refuse_pointer
from scoup.query.matching import HUB_SHARE, doubts
from scoup.scene.names import NameTable
from scoup.scene.things import ThingTable, cosine_spread

if TYPE_CHECKING:
    from duckdb import DuckDBPyConnection

THINGS_AT_A_TIME = 8192  # or so, whose vectors DuckDB returns together
VECTORS_AT_A_TIME = 1024
_INTEGERS = {
    "thing": "thing",
    "parent": "parent",
    "gaussians": "gaussians",
    "regions": "regions",
    "shares": "len(shares)",
    "names": "len(names)",
}
_REALS = {name: name for name in ("stability", "agreement", "mass", "hub")}
_PLACES = {
    f"{name}_{n}": f"({name}::DOUBLE[{size}])[{n}]"
    for name, size in PLACE.items()
    for n in range(1, size + 1)
}
_LISTS = {"share": "shares", "name": "names"}
"""First word of the columns with what is in a list of each thing -> the column of how many that are."""
Arrays: TypeAlias = "dict[str, NDArray[Any]]"
Item = TypeVar("Item")
Found = TypeVar("Found")


@dataclass(frozen=True, eq=False)
class ScanBlock:
    """S scans with T things in all, which share P Gaussians in pairs and have N votes for names.

    Those of a scan, and of a thing, follow each other.
    """

    records: tuple[ScanRecord, ...]
    columns: Arrays
    """[T]: vector [T, D] float16, place [T, 18] float64, level uint8, parent, gaussians, regions, and numbers of shares
    and names, int32, stability, agreement, mass, hub float32. [P] int32: share_thing, share_gaussians. [N]: name_row
    int32, name_vote float32."""

    @classmethod
    def joined(cls, scans: Sequence[tuple[ScanBlock, int]]) -> ScanBlock:
        """Return scans, each by block and number, as one block."""
        first = scans[0][0]
        if [*scans] == [(first, number) for number in range(len(first.records))]:
            return first
        parts = [block.part(number) for block, number in scans]
        columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        return cls(tuple(block.records[number] for block, number in scans), columns)

    @cached_property
    def starts(self) -> list[int]:
        """[S + 1] first thing of each scan, and T."""
        return [*accumulate((record.n_things for record in self.records), initial=0)]

    @cached_property
    def _ends(self) -> dict[str, list[int]]:
        """[S + 1] of each kind of column, where each scan begins."""
        sums = {name: np.append(0, self.columns[count].cumsum()) for name, count in _LISTS.items()}
        return {name: each[self.starts].tolist() for name, each in sums.items()}

    def part(self, number: int) -> Arrays:
        """Return the columns of one scan."""
        part = {}
        for name, column in self.columns.items():
            starts = self._ends.get(name.partition("_")[0], self.starts)
            part[name] = column[starts[number] : starts[number + 1]]
        return part

    @cached_property
    def words(self) -> list[tuple[str, int]]:
        """[S] digest and number of the words of each scan."""
        return [(record.words, len(record.best_fits)) for record in self.records]

    @cached_property
    def best_fits(self) -> Tensor:
        """[S, B] of the words of each scan; 0 behind the last."""
        return torch.nn.utils.rnn.pad_sequence([record.best_fits for record in self.records], True)

    @cached_property
    def scales(self) -> Tensor:
        """[T] float32: the fit of a thing to a text is scale * cosine - lowered (``ComparedTable.fits``)."""
        spreads = [
            cosine_spread(torch.from_numpy(agreement), torch.from_numpy(regions), dim)
            for dim in [self.columns["vector"].shape[1]]
            for start, end in pairwise(self.starts)
            for agreement, regions in [[self.columns[name][start:end] for name in ("agreement", "regions")]]
        ]
        return torch.tensor(spreads).reciprocal().repeat_interleave(torch.tensor(self.starts).diff())

    @cached_property
    def lowered(self) -> Tensor:
        """[T] float32, with the words of the records; infinite for things that cannot answer."""
        of = {name: torch.from_numpy(self.columns[name]) for name in (*_REALS, "gaussians", "regions")}
        lowered = HUB_SHARE * of["hub"] * self.scales + doubts(of["regions"], of["stability"])
        return lowered.masked_fill((of["gaussians"] <= 0) | (of["mass"] <= 0), torch.inf)

    @cached_property
    def rest_of_hubs(self) -> Tensor:
        """[T] float32: a thing's lead is its fit less this: what ``lowered`` leaves of its cosines with words."""
        return (1 - HUB_SHARE) * torch.from_numpy(self.columns["hub"]) * self.scales

    def cosines(self, queries: Tensor) -> Tensor:
        """Return the cosines [T, Q] of all things with unit vectors [Q, D]."""
        vectors = torch.from_numpy(self.columns["vector"])
        cosines = torch.empty(len(vectors), len(queries))
        for part, found in zip(*(each.split(VECTORS_AT_A_TIME) for each in (vectors, cosines)), strict=True):
            torch.mm(part.float(), queries.T, out=found)
        return cosines

    def most(self, values: Tensor) -> Tensor:
        """Return the largest value of each scan, [S, Q], of those [T, Q] of things."""
        return torch.from_numpy(np.maximum.reduceat(values.numpy(), self.starts[:-1]))

    def scan(self, number: int) -> Scan:
        """Return one scan."""
        record, part = self.records[number], self.part(number)
        of = {name: torch.from_numpy(column) for name, column in part.items()}
        things = np.arange(record.n_things)
        names = None
        if record.names:
            presence = torch.tensor([presence for presence, _ in record.names.values()], dtype=torch.float32)
            voted = torch.from_numpy(things.repeat(part["names"]).astype(np.int32))
            names = NameTable(tuple(record.names), presence, of["name_row"], voted, of["name_vote"])
        table = ThingTable(
            owners=torch.empty((0, len(record.levels)), dtype=torch.int32),
            levels=of["level"],
            parents=of["parent"],
            embeddings=of["vector"],
            n_regions=of["regions"],
            names=names,
            **{name: of[name] for name in ("stability", "agreement", "mass")},
        )
        pairs = [np.append(things, things.repeat(part["shares"])), np.append(things, part["share_thing"])]
        shared = torch.sparse_coo_tensor(
            torch.from_numpy(np.stack(pairs)),
            torch.cat([of["gaussians"], of["share_gaussians"]]).float(),
            (len(things), len(things)),
            check_invariants=True,
        ).coalesce()
        return Scan(record, table, of["gaussians"].float(), shared, of["hub"], of["place"])


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
        return [record_of(file, json.loads(headers.get(str(file), b"{}"))) for file in files]

    return _read(read, files, lambda file: file)


def read_block(records: Sequence[ScanRecord], connection: DuckDBPyConnection) -> ScanBlock:
    """Read scans, one at least, of embeddings of one size; errors as of ``read_records``."""

    def read(records: Sequence[ScanRecord]) -> list[Arrays]:
        ends = [*accumulate(record.n_things for record in records)]
        vectors = rest = np.empty((ends[-1], records[0].dim), np.float16)  # twice all would be much
        portions = groupby(zip(records, ends, strict=True), lambda each: each[1] // THINGS_AT_A_TIME)
        parts = []
        for _, some in portions:
            part = _columns([record for record, _ in some], connection)
            of_part = part.pop("vector")
            rest[: len(of_part)], rest = of_part, rest[len(of_part) :]
            parts.append(part)
        columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        return [{"vector": vectors, **columns}]

    (columns,) = _read(read, records, lambda record: record.file)
    return ScanBlock(tuple(records), columns)


def _columns(records: Sequence[ScanRecord], connection: DuckDBPyConnection) -> Arrays:
    """Return the columns of scans that a block has."""

    def fetched(selected: str) -> Any:
        files = [str(record.file) for record in records]
        return connection.execute(
            f"SELECT {selected} FROM read_parquet($files)", {"files": files}
        ).fetchnumpy()

    expressions = {"level": "level", **_INTEGERS, **_REALS, **_PLACES}
    rows = fetched(", ".join(f"{expression} AS c_{name}" for name, expression in expressions.items()))
    sizes = np.array([record.n_things for record in records])
    if sizes.min() < 1 or sizes.sum() != len(rows["c_thing"]):
        raise InputError(f"has {len(rows['c_thing'])} things, expected {sizes.sum()}")
    columns = {name: _filled(rows[f"c_{name}"], "int32", -1) for name in _INTEGERS}
    if not np.array_equal(columns.pop("thing"), np.concatenate([*map(np.arange, sizes)])):
        raise InputError("its things are not numbered from 0 on")
    columns |= {name: _filled(rows[f"c_{name}"], "float32", np.nan) for name in _REALS}
    columns["place"] = np.stack([_filled(rows[f"c_{name}"], "float64", np.nan) for name in _PLACES], 1)
    vectors = np.ma.filled(fetched("unnest(vector) AS v")["v"], np.nan).reshape(-1, records[0].dim)
    columns["vector"] = torch.from_numpy(vectors).half().numpy()
    shares = fetched("unnest(shares, recursive := true)")
    columns |= {f"share_{name}": _filled(shares[name], "int32", -1) for name in ("thing", "gaussians")}
    named = (
        fetched("unnest(names, recursive := true)") if columns["names"].any() else {"name": [], "vote": []}
    )
    columns["name_vote"] = _filled(np.ma.asarray(named["vote"]), "float32", np.nan)
    owners = np.arange(len(records)).repeat(sizes)  # the scan of each thing
    voted, shared = (owners.repeat(columns[name].clip(0)) for name in ("names", "shares"))
    for name, kind, texts, scans, known in (
        ("level", "uint8", rows["c_level"], owners, [record.levels for record in records]),
        ("name_row", "int32", named["name"], voted, [[*record.names] for record in records]),
    ):
        places = [{text: place for place, text in enumerate(each)} for each in known]
        columns[name] = np.array([places[scan][text] for scan, text in zip(scans, texts, strict=True)], kind)
    is_valid = (
        all((columns[name] >= 0).all() for name in ("gaussians", "regions", "shares", "names"))
        and all(np.isfinite(columns[name]).all() for name in (*_REALS, "vector", "name_vote"))
        and len(columns["vector"]) == len(owners)
        and (np.isfinite(columns["place"]).sum(1) % len(_PLACES) == 0).all()
        and (columns["parent"] >= -1).all()
        and (columns["parent"] < sizes[owners]).all()
        and (columns["share_thing"] >= 0).all()
        and (columns["share_thing"] < sizes[shared]).all()
    )
    if not is_valid:
        raise InputError("a number is out of range")
    return columns


def _filled(values: NDArray[Any], kind: str, empty: float) -> NDArray[Any]:
    """Return numbers of DuckDB as a type, with a value for NULL."""
    return np.ma.filled(values.astype(kind), empty)


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
            for item in items:
                _read(read, [item], file_of)
            return read(items)
        file = file_of(items[0])
        if not file.is_file():
            raise MissingFileError.of(file, "a scan of an archive") from error
        refuse_pointer(file)
        reason = (str(error) or type(error).__name__).splitlines()[0][:200]
        remedy = "add its field again, or remove the file"
        raise FileFormatError(file, f"is damaged, or not a scan of an archive ({reason})", remedy) from error
