"""The only calls into DuckDB: errors are ours, Ctrl-C interrupts them, conditions have limits of time and memory."""

from __future__ import annotations

import errno
import glob
import json
import os
import re
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scoup.base import InputError, ScoupError

if TYPE_CHECKING:
    from duckdb import DuckDBPyConnection

WHERE_SECONDS = 30.0
"""For a condition."""
_MEMORY = 4 << 30  # bytes for a condition; each thread of DuckDB reserves some
_PROGRAM = """
import json, sys
request = json.load(sys.stdin)
try:
    import resource, signal
    signal.alarm(int(request["seconds"]) + 5)  # in case the parent was killed
    resource.setrlimit(resource.RLIMIT_AS, (request["memory"],) * 2)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
except (ImportError, AttributeError, ValueError, OSError):
    pass
import duckdb
things, columns = {}, []
try:
    connection = duckdb.connect(":memory:", config={"threads": 2, "memory_limit": "2GB", "temp_directory": ""})
    connection.execute(f"SET allowed_directories = [{request['folders']}]")
    connection.execute("SET enable_external_access = false")
    connection.execute("SET lock_configuration = true")
    # An expression, not a statement: it reads, and only this folder.
    every = connection.read_parquet(request["files"], union_by_name=True, filename=True)
    columns = every.columns
    for file, thing in every.filter(request["where"]).project("filename, thing").fetchall():
        things.setdefault(file, []).append(thing)
    print(json.dumps({"things": things}))
except (duckdb.OutOfMemoryException, MemoryError):
    sys.exit(3)
except Exception as error:
    known = isinstance(error, duckdb.ParserException), isinstance(
        error, (duckdb.BinderException, duckdb.CatalogException, duckdb.ConversionException))
    print(json.dumps({"error": str(error), "known": known, "columns": columns}))
"""


def connect() -> DuckDBPyConnection:
    """Open a database in memory.

    Raises:
        ScoupError: DuckDB is not installed.
    """
    try:
        import duckdb
    except ImportError as error:
        raise ScoupError("an archive needs the package duckdb: pip install 'scoup[archive]'") from error
    return duckdb.connect(":memory:")


def quoted(text: str) -> str:
    """Return a text as SQL."""
    return "'" + text.replace("'", "''") + "'"


def patterns(paths: Iterable[Path]) -> list[str]:
    """Return paths as DuckDB takes them, which would look elsewhere for a name with brackets or asterisks."""
    return [glob.escape(str(path)) for path in paths]


def call(connection: DuckDBPyConnection, query: str, values: object = None) -> list[Any]:
    """Return the rows of a query with values for its parameters.

    It runs in a thread: DuckDB looks for signals rarely, and turns KeyboardInterrupt into errors of its own.

    Raises:
        OSError: the system refuses to read or write a file.
        InputError: DuckDB refuses anything else, such as a damaged file.
        ScoupError: not enough memory.
    """
    import duckdb

    with ThreadPoolExecutor(1) as pool:
        future = pool.submit(lambda: connection.execute(query, values).fetchall())
        try:
            return future.result()
        except KeyboardInterrupt:
            connection.interrupt()
            raise
        except (duckdb.OutOfMemoryException, MemoryError) as error:
            raise ScoupError(
                "not enough memory for DuckDB; end other programs, or use a larger machine"
            ) from error
        except duckdb.IOException as error:
            reasons = {number: os.strerror(number) for number in errno.errorcode}
            number = next((each for each, reason in reasons.items() if reason in str(error)), 0)
            raise OSError(number, reasons.get(number, _sentence(str(error)))) from error
        except duckdb.Error as error:
            raise InputError(_sentence(str(error))) from error


def matching_things(
    where: str, files: Sequence[Path], folder: Path, seconds: float
) -> Mapping[str, Sequence[int]]:
    """Return by absolute path of a file the things for which a condition holds; files without any are left out.

    It runs in a process of its own: DuckDB cannot interrupt a single call of a function such as ``repeat``, nor limit
    its memory.

    Raises:
        InputError: the condition cannot be used, or takes too long or too much memory.
    """
    absolute = folder.absolute()
    folders = ", ".join(map(quoted, (str(absolute), *patterns([absolute]))))
    request = {"where": where, "files": patterns(file.absolute() for file in files), "folders": folders,
               "seconds": seconds, "memory": _MEMORY}  # fmt: skip
    try:
        done = subprocess.run(
            [sys.executable, "-c", f"import sys; sys.path[:] = {sys.path!r}\n{_PROGRAM}"],
            input=json.dumps(request).encode(),
            capture_output=True,
            timeout=seconds,
        )
        if done.returncode:
            reason = f"it takes more than {_MEMORY >> 30} GB of memory, or ends DuckDB; simplify it"
        else:
            reply = json.loads(done.stdout)
            if "things" in reply:
                return reply["things"]
            reason = _reason(**reply)
    except subprocess.TimeoutExpired:
        reason = f"it takes more than {seconds:g} seconds; simplify it, or pass a larger `where_seconds`"
    raise InputError(f"the condition {where!r} cannot be used: {reason}")


def _reason(error: str, known: Sequence[bool], columns: Sequence[str]) -> str:
    """Return why a condition was refused, from DuckDB's error, and whether that is of its syntax or its names."""
    have = f"columns are {', '.join(name for name in columns if name != 'filename')}"
    missing = re.search(r'Referenced column "(.*?)" not found', error)
    if missing:
        return f"there is no column {missing[1]}; {have}"
    if any(known):
        what = "it is not SQL" if known[0] else "its functions or types do not fit the columns"
        return f"{what}; {have}, and texts stand in single quotes"
    return _sentence(error)


def _sentence(text: str) -> str:
    """Return the first paragraph of an error in one line."""
    return " ".join(text.split("\n\n")[0].split())
