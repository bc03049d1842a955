"""One process at a time writes an output that takes long to make."""

from __future__ import annotations

import json
import os
import re
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from scoup.base.atomic import LONGEST_STEM, check_output, folder_made
from scoup.base.errors import InputError, OutputInUseError, ScoupError, WriteError
from scoup.base.holding import remove_abandoned, try_hold

if TYPE_CHECKING:
    from scoup.base.processes import Processes

LOCK = ".lock"
FOLDER_LOCK = "scoup.lock"


@contextmanager
def locked_file(path: Path, overwrite: bool = False, processes: Processes | None = None) -> Iterator[None]:
    """Keep other processes from writing a file, and what goes beside it, meanwhile.

    ``PATH.lock`` says who writes. It is removed at the end, after an interruption too. One whose process has died
    counts no more. Temporary files that a dead process has left of this output are removed.

    Args:
        path: the file. It is checked once more, as another process may just have finished it.
        overwrite: replace what is there.
        processes: at one task; the first holds the lock for all, and all are refused together.

    Raises:
        OutputInUseError: another process is writing it.
        OutputExistsError, InputError: as ``base.atomic.check_output``; WriteError: the lock cannot be written.
    """
    own = re.escape(path.stem[:LONGEST_STEM]), re.escape(path.suffix), re.escape(path.name[:LONGEST_STEM])
    temporary = re.compile(rf"\.({own[0]}\.{_HEX}{own[1]}|{own[2]}\.{_HEX}\.\w+)")
    with ExitStack() as stack:
        refusal: ScoupError | None = None
        if processes is None or processes.first:
            try:
                stack.enter_context(_held(path, path.with_name(path.name + LOCK), temporary))
                check_output(path, overwrite)
            except ScoupError as error:
                refusal = error
        if processes is not None:
            (refusal,) = processes.from_rank((refusal,), 0)
        if refusal is not None:
            raise refusal
        yield


@contextmanager
def locked_folder(path: Path) -> Iterator[None]:
    """The same for a folder of results, by a file ``scoup.lock`` in it; the folder is made if it is missing.

    Raises:
        InputError: it is a file; or as ``locked_file``.
    """
    if path.is_file():
        raise InputError(f"{path}: is a file; give the name of a folder")
    with _held(path, path / FOLDER_LOCK, re.compile(rf"\..+\.{_HEX}(\.\w+)?")):
        yield


_HEX = "[0-9a-f]{12}"  # in the name of a temporary file


@contextmanager
def _held(output: Path, lock: Path, temporary: re.Pattern[str]) -> Iterator[None]:
    check_output(lock, overwrite=True)
    with folder_made(lock.parent, output):
        try:
            descriptor = _acquired(output, lock)
        except OSError as error:
            raise WriteError.of(output, error) from error
        try:
            _write_holder(output, descriptor)
            remove_abandoned(item for item in lock.parent.iterdir() if temporary.fullmatch(item.name))
            yield
        finally:
            with suppress(OSError):
                lock.unlink()  # before it is free: nobody else holds this very file
            os.close(descriptor)
            with suppress(OSError):
                if os.name == "nt":  # where an open file cannot be removed
                    lock.unlink()


def _acquired(output: Path, lock: Path) -> int:
    """The open lock file, which this process holds."""
    while True:
        descriptor = os.open(lock, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            if not _is_free(descriptor):
                raise OutputInUseError(output, _holder(descriptor))
            if _is_same(descriptor, lock):
                return descriptor
        except BaseException:
            os.close(descriptor)
            raise
        os.close(descriptor)  # the holder before has removed it meanwhile


def _is_free(descriptor: int) -> bool:
    try:
        return try_hold(descriptor)
    except OSError:  # a file system without locks: nobody is kept out
        return True


def _is_same(descriptor: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except FileNotFoundError:
        return False


def _write_holder(output: Path, descriptor: int) -> None:
    record = {
        "host": socket.gethostname(),
        "process": os.getpid(),
        "since": datetime.now().isoformat(timespec="seconds"),
    }
    try:
        os.ftruncate(descriptor, 0)
        os.lseek(descriptor, 0, os.SEEK_SET)
        os.write(descriptor, (json.dumps(record) + "\n").encode())
    except OSError as error:
        raise WriteError.of(output, error) from error


def _holder(descriptor: int) -> str:
    """Who holds a lock, in words."""
    try:
        os.lseek(descriptor, 0, os.SEEK_SET)
        record = json.loads(os.read(descriptor, 4096))
        since = datetime.fromisoformat(record["since"])
        when = f"{since:%H:%M}" if since.date() == datetime.now().date() else f"{since:%Y-%m-%d %H:%M}"
        return f"process {record['process']} on {record['host']} since {when}"
    except (OSError, ValueError, KeyError, TypeError):  # it has not written that yet
        return "another process"
