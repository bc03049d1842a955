"""The file that says who writes an output: locked while its process lives, with a JSON record inside."""

from __future__ import annotations

import errno
import json
import os
import re
import socket
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path
from types import MappingProxyType
from typing import Any

from scoup.base.atomic import check_output, folder_made
from scoup.base.errors import InputError, OutputInUseError, WriteError
from scoup.base.holding import NO_LINK, is_same, remove_abandoned, try_hold

_MOST_BYTES = 65_536  # of the record


@contextmanager
def hold_lock(output: Path, lock: Path, temporary: re.Pattern[str]) -> Iterator[int]:
    """Hold the lock file of an output, whose abandoned temporary files are removed first; yields its descriptor."""
    check_output(lock, overwrite=True)
    if lock.is_symlink():
        raise _foreign(lock)
    with folder_made(lock.parent, output):
        try:
            descriptor = _acquire(output, lock)
        except OSError as error:
            raise WriteError.of(output, error) from error
        try:
            write_record(output, descriptor)
            remove_abandoned(lock.parent, temporary)
            yield descriptor
        finally:
            _release(descriptor, lock)


def _release(descriptor: int, lock: Path) -> None:
    with suppress(OSError):
        lock.unlink()  # before it is free: nobody else holds this very file
    os.close(descriptor)
    with suppress(OSError):
        if os.name == "nt":  # where an open file cannot be removed
            lock.unlink()


def _acquire(output: Path, lock: Path) -> int:
    """Return the descriptor of the lock file, which this process holds from now on."""
    while True:
        descriptor = os.open(lock, os.O_RDWR | os.O_CREAT | NO_LINK, 0o666)
        try:
            if not _is_free(descriptor):
                raise OutputInUseError(output, _holder(descriptor))
            if is_same(descriptor, lock):
                if _record(descriptor) is None and not _is_blank(descriptor):
                    raise _foreign(lock)
                return descriptor
        except BaseException:
            os.close(descriptor)
            raise
        os.close(descriptor)  # the holder before has removed it meanwhile


def check_free(output: Path, lock: Path) -> None:
    """Refuse an output whose lock another process holds (OutputInUseError)."""
    try:
        descriptor = os.open(lock, os.O_RDONLY | NO_LINK)
    except FileNotFoundError:
        return
    except OSError as error:
        raise WriteError.of(output, error) from error
    try:
        if not _is_free(descriptor, shared=True):  # as others may look at this moment
            raise OutputInUseError(output, _holder(descriptor))
    finally:
        os.close(descriptor)


def _is_free(descriptor: int, shared: bool = False) -> bool:
    try:
        return try_hold(descriptor, shared)
    except OSError:  # a file system without locks: nobody is kept out
        return True


def _foreign(lock: Path) -> InputError:
    return InputError(f"{lock}: is not a SCOUP lock file; move it away, or choose another output")


def write_record(output: Path, descriptor: int, notes: Mapping[str, Any] = MappingProxyType({})) -> None:
    """Write who holds the lock, since when, and notes. A refusal of the system is a WriteError of the output."""
    record: dict[str, Any] = {
        "host": socket.gethostname(),
        "process": os.getpid(),
        "since": datetime.now().isoformat(timespec="seconds"),
        **notes,
    }
    # In one write and never shorter than before: others may read it at any moment.
    text = json.dumps(record).encode().ljust(os.fstat(descriptor).st_size - 1) + b"\n"
    try:
        os.lseek(descriptor, 0, os.SEEK_SET)
        if os.write(descriptor, text) < len(text):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    except OSError as error:
        raise WriteError.of(output, error) from error


def read_record(lock: Path) -> dict[str, Any] | None:
    """Return the record in a lock file; None where the file is missing. ValueError while it is being written."""
    try:
        record = json.loads(lock.read_bytes()[:_MOST_BYTES])
    except FileNotFoundError:
        return None
    except (OSError, RecursionError) as error:
        raise ValueError from error
    if not isinstance(record, dict):
        raise ValueError("not a record")
    return record


def _record(descriptor: int) -> tuple[str, datetime] | None:
    """Return who wrote a lock, and when; None where its contents are something else."""
    try:
        os.lseek(descriptor, 0, os.SEEK_SET)
        record = json.loads(os.read(descriptor, _MOST_BYTES))
        return f"process {record['process']} on {record['host']}", datetime.fromisoformat(record["since"])
    except (ValueError, KeyError, TypeError, RecursionError):
        return None


def _is_blank(descriptor: int) -> bool:
    """Return whether a lock file is empty, or zeros: power was lost before the record was on the disk."""
    os.lseek(descriptor, 0, os.SEEK_SET)
    return not os.read(descriptor, _MOST_BYTES).strip(b"\0")


def _holder(descriptor: int) -> str:
    """Return who holds a lock, in words."""
    record = _record(descriptor)
    if record is None:  # it has not written that yet
        return "another process"
    who, since = record
    when = f"{since:%H:%M}" if since.date() == datetime.now().date() else f"{since:%Y-%m-%d %H:%M}"
    return f"{who} since {when}"
