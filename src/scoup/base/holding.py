"""Advisory locks held for the lifetime of a process, and temporary files and folders under such locks."""

from __future__ import annotations

import os
import re
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl

HEX = "[0-9a-f]{12}"  # in the name of a temporary file or folder
LONGEST_STEM = 64  # of the name of a temporary file
NO_LINK = getattr(os, "O_NOFOLLOW", 0)
_BYTE = 1 << 30  # the one that is locked on Windows: beyond whatever is written, so that the file can be read


def try_hold(descriptor: int, shared: bool = False) -> bool:
    """Lock an open file, or folder, until it is closed or this process ends, however it ends.

    Args:
        descriptor: of the file; its position becomes 0 on Windows.
        shared: others may hold it so, too (not on Windows).

    Returns:
        False if another holds it.
    """
    if sys.platform == "win32":
        os.lseek(descriptor, _BYTE, os.SEEK_SET)
        try:
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        except PermissionError:
            return False
        finally:
            os.lseek(descriptor, 0, os.SEEK_SET)
        return True
    try:
        fcntl.flock(descriptor, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def is_same(descriptor: int, path: Path) -> bool:
    """Return whether a path still leads to the open file."""
    try:
        return os.path.samestat(os.fstat(descriptor), path.lstat())
    except FileNotFoundError:
        return False


@contextmanager
def held_temporary(path: Path, folder: bool = False) -> Iterator[None]:
    """Make an empty temporary file, or folder, hold it, and remove what is there at the end of the block.

    On Windows, and where the file system knows no locks, it is not held; there ``remove_abandoned`` removes nothing.
    """
    descriptor = None
    try:
        descriptor = _made_and_held(path, folder)
        yield
    finally:
        if folder:
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)
        if descriptor is not None:
            os.close(descriptor)


def _made_and_held(path: Path, folder: bool) -> int | None:
    while True:
        if folder:
            path.mkdir()
        else:
            os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
        if sys.platform == "win32":
            return None
        try:
            descriptor = os.open(path, os.O_RDONLY | NO_LINK)
        except FileNotFoundError:
            continue
        with suppress(OSError):
            # Another process may just hold it, to remove it: nobody did before this one.
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        if is_same(descriptor, path):
            return descriptor
        os.close(descriptor)


def remove_abandoned(folder: Path, name: re.Pattern[str], only_folders: bool = False) -> None:
    """Remove the temporary files and folders of a pattern that no living process holds.

    What cannot be found out, or removed, stays. Links are never followed.

    Args:
        folder: where to look.
        name: what whole names must match.
        only_folders: leave files alone.
    """
    if sys.platform == "win32":
        return
    with suppress(OSError):
        for path in [item for item in folder.iterdir() if name.fullmatch(item.name)]:
            if path.is_dir() or not only_folders:
                with suppress(OSError):
                    _remove_if_abandoned(path)


def _remove_if_abandoned(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY | NO_LINK)
    try:
        if not try_hold(descriptor) or not is_same(descriptor, path):
            return
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink()
    finally:
        os.close(descriptor)
