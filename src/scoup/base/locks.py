"""One process at a time writes an output that takes long to make."""

from __future__ import annotations

import errno
import json
import os
import re
import socket
import threading
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from types import MappingProxyType
from typing import Any

from scoup.base.atomic import check_output, folder_made
from scoup.base.errors import InputError, OutputInUseError, ScoupError, ScoupWarning, WriteError
from scoup.base.holding import HEX, LONGEST_STEM, NO_LINK, is_same, remove_abandoned, try_hold
from scoup.base.last_steps import LastSteps
from scoup.base.shares import Share
from scoup.base.staging import stops_held_back

LOCK = ".lock"
FOLDER_LOCK = "scoup.lock"
_MOST_BYTES = 65_536  # of the contents of a lock
_LAST_STEPS = "last_steps"  # of the contents of a lock: what its process was about to do


@dataclass(frozen=True)
class Lock:
    """The lock of an output, while this process holds it.

    Attributes:
        output: the file.
        descriptor: of the lock file.
        notes: entries of its record, beside who holds it and since when.
    """

    output: Path
    descriptor: int
    notes: dict[str, Any] = field(default_factory=dict)
    _writing: threading.Lock = field(default_factory=threading.Lock)

    def note(self, **notes: Any) -> None:
        """Write entries into the lock file; those of None are removed from it.

        Raises:
            WriteError: the system refuses.
        """
        with self._writing:
            self.notes.update(notes)
            known = {name: value for name, value in self.notes.items() if value is not None}
            _write_holder(self.output, self.descriptor, known)

    def finish(self, moves: Mapping[Path, Path], removed: Iterable[Path] = ()) -> None:
        """Give finished files their names and remove others: all of it or, where nothing was begun, nothing.

        The steps are written into the lock first. Killed, or refused by the system, in the midst of them, the process
        leaves the lock, and with it the rest to the next one that locks the output, or calls ``complete``.
        Interruptions and terminations wait.

        Args:
            moves: files beside the output, or in hidden folders there -> their names beside it.
            removed: files beside the output that are not needed then; they may be missing.

        Raises:
            WriteError: the system refuses.
        """
        steps = LastSteps.of(self.output, moves, removed)
        with stops_held_back():
            self.note(**{_LAST_STEPS: steps.record()})
            try:
                steps.take()
            except WriteError:
                if not steps.is_begun:
                    self.note(**{_LAST_STEPS: None})
                raise


@contextmanager
def locked_file(path: Path, overwrite: bool = False, is_folder: bool = False) -> Iterator[Lock]:
    """Keep other processes from writing a file, and what goes beside it, meanwhile.

    ``PATH.lock`` says who writes. It is removed at the end, after an interruption too. One whose process has died
    counts no more; what that process had begun to put in its place is put there (``Lock.finish``). Temporary files
    that a dead process has left of this output are removed.

    Args:
        path: the file. It is checked once more, as another process may just have finished it.
        overwrite: replace what is there.
        is_folder: it is a folder, which appears as a whole.

    Raises:
        OutputInUseError: another process is writing it.
        OutputExistsError, InputError: as ``base.atomic.check_output``; WriteError: the lock cannot be written.

    Warns:
        ScoupWarning: a killed process had not put all of its finished files in their place.
    """
    own = re.escape(path.stem[:LONGEST_STEM]), re.escape(path.suffix), re.escape(path.name[:LONGEST_STEM])
    temporary = re.compile(rf"\.({own[0]}\.{HEX}{own[1]}|{own[2]}\.{HEX}\.\w+)")
    with _held(path, lock_path(path), temporary) as descriptor:
        check_output(path, overwrite, is_folder)
        yield Lock(path, descriptor)


def complete(path: Path) -> None:
    """Put in its place what a killed process had finished of a file, and of what goes beside it, and remove its lock.

    Nothing happens where there is no lock, where its process lives, or where the system refuses.

    Warns:
        ScoupWarning: something was put in its place.
    """
    if lock_path(path).is_file():
        with suppress(ScoupError), locked_file(path, overwrite=True, is_folder=path.is_dir()):
            pass


@contextmanager
def locked_folder(path: Path, share: Share = Share()) -> Iterator[None]:  # noqa: B008 - frozen
    """The same for a folder of results, by a file ``scoup.lock`` in it; the folder is made if it is missing.

    Args:
        path: the folder.
        share: of the work that this process does. Each of several holds ``scoup.lock.I-of-N``: one that does
            everything is kept out while any of them works, and they are while it does.

    Raises:
        InputError: it is a file; or as ``locked_file``.
    """
    if path.is_file():
        raise InputError(f"{path}: is a file; give the name of a folder")
    temporary = re.compile(rf"\..+\.{HEX}(\.\w+)?")
    # Whoever has taken its own lock looks for others': of two that begin together, one at least is refused.
    if not share.is_everything:
        with _held(path, path / f"{FOLDER_LOCK}.{share}", temporary):
            _check_free(path, path / FOLDER_LOCK)
            yield
        return
    with _held(path, path / FOLDER_LOCK, temporary):
        for lock in sorted(path.glob(f"{FOLDER_LOCK}.*")):
            if is_folder_lock(lock.name):
                with _held(path, lock, temporary):
                    pass  # of a dead process; now it is removed
        yield


def lock_path(output: Path) -> Path:
    """Return the place of the lock file of an output."""
    return output.with_name(output.name + LOCK)


def is_folder_lock(name: str) -> bool:
    """Whether a file of this name in a folder is a lock of ``locked_folder``."""
    return re.fullmatch(re.escape(FOLDER_LOCK) + r"(\.\d+-of-\d+)?", name) is not None


@contextmanager
def _held(output: Path, lock: Path, temporary: re.Pattern[str]) -> Iterator[int]:
    check_output(lock, overwrite=True)
    if lock.is_symlink():
        raise _foreign(lock)
    with folder_made(lock.parent, output):
        try:
            descriptor = _acquired(output, lock)
        except OSError as error:
            raise WriteError.of(output, error) from error
        try:
            _complete(output, descriptor, lock)
        except BaseException:
            os.close(descriptor)
            raise
        try:
            _write_holder(output, descriptor)
            remove_abandoned(lock.parent, temporary)
            yield descriptor
        finally:
            _release(output, descriptor, lock)


def _release(output: Path, descriptor: int, lock: Path) -> None:
    """Close a lock and remove it, unless it says what is still to be done."""
    steps = _last_steps(output, descriptor)
    done = steps is None or not steps.is_left
    with suppress(OSError):
        if done:
            lock.unlink()  # before it is free: nobody else holds this very file
    os.close(descriptor)
    with suppress(OSError):
        if done and os.name == "nt":  # where an open file cannot be removed
            lock.unlink()


def _acquired(output: Path, lock: Path) -> int:
    """The open lock file, which this process holds."""
    while True:
        descriptor = os.open(lock, os.O_RDWR | os.O_CREAT | NO_LINK, 0o666)
        try:
            if not _is_free(descriptor):
                raise OutputInUseError(output, _holder(descriptor))
            if is_same(descriptor, lock):
                if os.fstat(descriptor).st_size and _record(descriptor) is None:
                    raise _foreign(lock)
                return descriptor
        except BaseException:
            os.close(descriptor)
            raise
        os.close(descriptor)  # the holder before has removed it meanwhile


def _check_free(output: Path, lock: Path) -> None:
    """Refuse an output whose lock another process holds."""
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
    return InputError(f"{lock}: is no lock that scoup has written; move it away, or give another --out")


def _complete(output: Path, descriptor: int, lock: Path) -> None:
    """Take the last steps that the holder before was about to take when it died."""
    try:
        steps = _last_steps(output, descriptor)
    except (ValueError, KeyError, TypeError) as error:
        raise _foreign(lock) from error
    moved = [] if steps is None else steps.take()
    if moved:
        warnings.warn(
            f"{output}: put in place what a killed process had finished ({', '.join(moved)})",
            ScoupWarning,
            stacklevel=2,
        )


def _last_steps(output: Path, descriptor: int) -> LastSteps | None:
    """Those in a lock.

    Raises:
        ValueError, KeyError, TypeError: they make no sense.
    """
    contents = _contents(descriptor)
    if not isinstance(contents, dict) or _LAST_STEPS not in contents:
        return None
    return LastSteps.of_record(output, contents[_LAST_STEPS])


def _write_holder(output: Path, descriptor: int, notes: Mapping[str, Any] = MappingProxyType({})) -> None:
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
    """Return the record in a lock file; None where there is no such file.

    Raises:
        ValueError: it is being written at this moment, or something else.
    """
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
    """Who wrote a lock, and when; None where its contents are something else."""
    record = _contents(descriptor)
    try:
        return f"process {record['process']} on {record['host']}", datetime.fromisoformat(record["since"])
    except (ValueError, KeyError, TypeError):
        return None


def _contents(descriptor: int) -> Any:
    """The JSON values in a lock; None where there are none."""
    try:
        os.lseek(descriptor, 0, os.SEEK_SET)
        return json.loads(os.read(descriptor, _MOST_BYTES))
    except (ValueError, RecursionError):
        return None


def _holder(descriptor: int) -> str:
    """Who holds a lock, in words."""
    record = _record(descriptor)
    if record is None:  # it has not written that yet
        return "another process"
    who, since = record
    when = f"{since:%H:%M}" if since.date() == datetime.now().date() else f"{since:%Y-%m-%d %H:%M}"
    return f"{who} since {when}"
