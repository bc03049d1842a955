"""One process at a time writes an output: advisory locks of ``filelock`` beside it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from scoup.base.errors import OutputInUseError, WriteError
from scoup.base.file_names import hidden_name

WAIT = 60.0
"""Seconds to wait for another process that writes the same file of a shared folder."""
held: set[Path] = set()
"""Lock files of this process: of outputs that are being written."""


@contextmanager
def locked(output: Path, wait: float = 0.0, kind: str = "lock") -> Iterator[None]:
    """Keep other processes from writing an output until the block ends. The folder of the output must exist.

    The lock file ``.NAME.KIND`` is removed at the end. That of a killed process locks nothing: the system releases it.

    Args:
        output: the file or folder.
        wait: seconds to wait for another process.
        kind: of the lock; locks of different kinds exclude nobody.

    Raises:
        OutputInUseError: another process writes the output.
        WriteError: the system refuses.
    """
    from filelock import FileLock, Timeout

    path = output.with_name(hidden_name(output.name, kind))
    lock = FileLock(path)
    try:
        lock.acquire(timeout=wait, poll_interval=0.01)
        while not path.exists():  # its holder removed it between the opening and the locking
            lock.release(force=True)
            lock.acquire(timeout=wait, poll_interval=0.01)
    except Timeout:
        raise OutputInUseError(output) from None
    except OSError as error:
        raise WriteError.of(output, error) from error
    held.add(path)
    try:
        yield
    finally:
        held.discard(path)
        with suppress(OSError):
            path.unlink()  # while it is still locked
        lock.release(force=True)
