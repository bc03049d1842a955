"""Barriers between processes that each make a part of one output, by their lock files.

Nothing but a file system that all of them see is needed. A record in a lock file that does not change for ``SILENCE``
seconds is that of a lost process. What killed processes have left is never mistaken for a heartbeat: a process that is
ready names the record that it is ready for.
"""

from __future__ import annotations

import secrets
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from scoup.base.errors import SAID_ELSEWHERE, ProcessLostError, WriteError
from scoup.base.lock_files import read_record
from scoup.base.locks import Output
from scoup.base.shares import Share

SILENCE = 60.0
"""Seconds without a heartbeat after which a process counts as lost."""
_BEAT = 1.0  # seconds between heartbeats
_POLL = 0.1
_ID, _READY_FOR = "id", "ready_for"  # entries of a record


@contextmanager
def reported_once(share: Share) -> Iterator[None]:
    """Leave it to the first of all processes to report an interruption; where it is lost, to the second to report
    that."""
    try:
        yield
    except (KeyboardInterrupt, ProcessLostError) as error:
        if share.number > isinstance(error, ProcessLostError):
            setattr(error, SAID_ELSEWHERE, True)
        raise


@contextmanager
def heartbeats(lock: Output) -> Iterator[None]:
    """Write a heartbeat into a lock file once per second while the block runs, from a thread."""
    lock.note(**{_ID: secrets.token_hex(8)})
    ended = threading.Event()

    def beat() -> None:
        count = 0
        while not ended.wait(_BEAT):
            count += 1
            with suppress(WriteError):  # the next one may find space
                lock.note(beat=count)

    thread = threading.Thread(target=beat, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def wait_for_parts(lock: Output, locks: Sequence[Path]) -> None:
    """Return when the holders of other lock files have called ``wait_until_taken`` for this one.

    Args:
        lock: of the output, with ``heartbeats``.
        locks: of its parts.
    """
    watched = {path: _Watch(path) for path in locks}
    while watched:
        for path, watch in list(watched.items()):
            record = watch.look()
            if record is not None and record.get(_READY_FOR) == lock.notes[_ID]:
                del watched[path]
            elif watch.has_ended:
                raise ProcessLostError(f"{path} was abandoned")
        time.sleep(_POLL)


def wait_until_taken(lock: Output, part: Path, whole: Path) -> None:
    """Return when the holder of another lock file has removed a finished part.

    Args:
        lock: of the part, with ``heartbeats``.
        part: the file or folder.
        whole: the lock file of the output that it is a part of.
    """
    watch = _Watch(whole)
    while part.exists():
        record = watch.look()
        if record is not None and record.get(_ID) != lock.notes.get(_READY_FOR):
            lock.note(**{_READY_FOR: record.get(_ID)})
        if watch.has_ended and part.exists():
            error = ProcessLostError(f"{whole} was abandoned")
            setattr(error, SAID_ELSEWHERE, True)
            raise error
        time.sleep(_POLL)


class _Watch:
    """The heartbeats that another process writes into its lock file.

    Attributes:
        has_ended: there was a record, and the file is gone.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._last: dict[str, object] | None = None
        self._since = time.monotonic()
        self.has_ended = False

    def look(self) -> dict[str, object] | None:
        """Return the record; None where there is none."""
        try:
            record = read_record(self._path)
        except ValueError:  # being written
            record = self._last
        self.has_ended = record is None and self._last is not None
        if record != self._last and not self.has_ended:
            self._last, self._since = record, time.monotonic()
        elif time.monotonic() - self._since > SILENCE:
            raise ProcessLostError(f"{self._path}: no heartbeat for {SILENCE:.0f} s")
        return record
