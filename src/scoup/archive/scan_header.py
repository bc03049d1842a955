"""What the Parquet file of a scan says in its metadata, and the list of scans. None of it needs torch."""

from __future__ import annotations

import json
import math
import os
import re
import zlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias, TypeVar

from scoup.archive.database import call, connect, patterns
from scoup.base import FileFormatError, InputError, MissingFileError, check_format_version, refuse_pointer
from scoup.field import LEAST_GAUSSIANS, place_of

if TYPE_CHECKING:
    from duckdb import DuckDBPyConnection

FORMAT, VERSION = "scoup scan", 1
"""What the metadata of a Parquet file says under the key ``scoup``. Raise the version when the rules of
``scoup.query.thing_judge`` change: the arrays depend on them."""
ENDING = ".parquet"
OwnColumns: TypeAlias = "Mapping[str, str | int | float]"
"""What the user says of a scan: name of the column -> value in every row."""
Item = TypeVar("Item")
Found = TypeVar("Found")

COLUMNS = {
    "scan": "VARCHAR",
    "thing": "INTEGER",  # its number in the field
    "row": "BIGINT",  # of its vector in the matrix
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
    "names": "STRUCT(name VARCHAR, vote FLOAT)[]",  # votes of a model with words
}
OWN_TYPES = {str: "VARCHAR", int: "BIGINT", float: "DOUBLE"}


class ListedScan(NamedTuple):
    """A scan of an archive."""

    name: str
    things: int
    """As many as ``field.things()`` returns."""
    field_path: Path
    columns: OwnColumns


def list_scans(folder: Path) -> list[ListedScan]:
    """Return the scans of an archive, by name; errors as of ``read_each``."""
    check_folder(folder)
    connection = connect()

    def read(files: Sequence[Path]) -> list[ListedScan]:
        query = (
            "SELECT filename, count(*) FILTER (position IS NOT NULL AND gaussians >= $least)"
            " FROM read_parquet($files, filename := true) GROUP BY filename"
        )
        asked = {"files": patterns(files), "least": LEAST_GAUSSIANS}
        counts = dict(call(connection, query, asked))
        return [
            ListedScan(file.stem, counts[str(file)], place_of(file, str(header["field"])) or file, columns)
            for file, header in zip(files, headers(files, connection), strict=True)
            for columns in [check_columns(header["columns"])]
        ]

    return read_each(read, [file_of(folder, name) for name in scan_names(folder)], lambda file: file)


def check_folder(folder: Path) -> None:
    """Refuse a file as the folder of an archive, and a path that DuckDB cannot take."""
    if folder.is_file():
        raise FileFormatError(folder, "is a file, expected the folder of an archive", "check the path")
    if any("\ud800" <= letter <= "\udfff" for letter in str(folder.absolute())):
        raise FileFormatError(folder, "its path is not in UTF-8", "rename the folder, or the one around it")


def scan_names(folder: Path) -> list[str]:
    """Return the names of the scans in a folder, in order."""
    names = os.listdir(folder) if folder.is_dir() else []
    return sorted(name[: -len(ENDING)] for name in names if name.endswith(ENDING) and name[0] != ".")


def file_of(folder: Path, name: str) -> Path:
    """Return the file of a scan."""
    return folder / f"{name}{ENDING}"


def headers(files: Sequence[Path], connection: DuckDBPyConnection) -> list[Mapping[str, Any]]:
    """Return the metadata of scans, from files that have them."""
    query = "SELECT file_name, value FROM parquet_kv_metadata($files) WHERE key = 'scoup'"
    asked = {"files": patterns(files)}
    texts = dict(call(connection, query, asked))
    return [_checked(file, json.loads(texts.get(str(file), b"{}"))) for file in files]


def _checked(file: Path, header: Mapping[str, Any]) -> Mapping[str, Any]:
    if header.get("format") != FORMAT:
        remedy = "add its field again, or remove the file"
        raise FileFormatError(file, "is a Parquet file, but not a scan of an archive", remedy)
    check_format_version(file, header["version"], VERSION)
    if checksum(header) != header["checksum"]:
        raise ValueError("checksum")
    return header


def read_each(
    read: Callable[[Sequence[Item]], list[Found]], items: Sequence[Item], file_of: Callable[[Item], Path]
) -> list[Found]:
    """Read all items together; if that fails, one by one, and name the file that is damaged.

    Raises:
        FileFormatError: a file is damaged, or not a scan.
        MissingFileError: it is not there.
    """
    try:
        return read(items) if items else []
    except FileFormatError:
        raise
    except (ArithmeticError, AttributeError, LookupError, OSError, RuntimeError, TypeError,
            ValueError) as error:  # fmt: skip
        if len(items) > 1:
            for item in items:
                read_each(read, [item], file_of)
            return read(items)
        file = file_of(items[0])
        if not file.is_file():
            raise MissingFileError.of(file, "a scan of an archive") from error
        refuse_pointer(file)
        if isinstance(error, OSError) and error.errno:
            raise FileFormatError.unreadable(file, error) from error
        reason = (str(error) or type(error).__name__).splitlines()[0][:200]
        remedy = "add its field again, or remove the file"
        raise FileFormatError(file, f"is damaged, or not a scan of an archive ({reason})", remedy) from error


def checksum(header: Mapping[str, Any]) -> int:
    """Return the CRC-32 of a header without its checksum."""
    rest = {name: value for name, value in header.items() if name not in ("arrays", "checksum")}
    return zlib.crc32(header["arrays"].encode(), zlib.crc32(json.dumps(rest, sort_keys=True).encode()))


def check_columns(columns: Any) -> OwnColumns:
    """Refuse names and values that are no columns of a user's."""
    for name, value in dict(columns).items():
        if not re.fullmatch(r"[a-z][a-z0-9_]{0,62}", name) or name in COLUMNS or name == "filename":
            raise InputError(
                f"column {str(name)[:80]!r}: expected lower-case letters, digits and _, but none of "
                f"{', '.join(COLUMNS)}"
            )
        if type(value) not in OWN_TYPES:
            raise InputError(f"column {name}: expected a text or a number, got {type(value).__name__}")
        if isinstance(value, float) and not math.isfinite(value):
            raise InputError(f"column {name}: expected a finite number, got {value}")
        if isinstance(value, int) and not -(2**63) <= value < 2**63:
            raise InputError(f"column {name}: expected an integer of at most 64 bits")
        if isinstance(value, str) and value.encode(errors="ignore").decode() != value:
            raise InputError(f"column {name}: expected a text of valid Unicode, got {value!r}")
    return columns
