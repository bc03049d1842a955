"""Open files that a process holds while it lives: another process can tell whether somebody is at work on them."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl

_BYTE = 1 << 30  # the one that is locked on Windows: beyond whatever is written, so that the file can be read


def try_hold(descriptor: int) -> bool:
    """Hold an open file, or folder, until it is closed or this process ends, however it ends.

    Returns:
        False if another holds it.

    Raises:
        OSError: the file system knows no such locks.
    """
    if sys.platform == "win32":
        os.lseek(descriptor, _BYTE, os.SEEK_SET)
        try:
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        except PermissionError:
            return False
        return True
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def remove_abandoned(paths: Iterable[Path]) -> None:
    """Remove temporary files and folders that no living process holds. What cannot be told, or removed, stays."""
    for path in paths:
        with suppress(OSError):
            descriptor = os.open(path, os.O_RDONLY)
            try:
                if not try_hold(descriptor):
                    continue
                if path.is_dir():
                    shutil.rmtree(path, ignore_errors=True)
                else:
                    path.unlink()
            finally:
                os.close(descriptor)
