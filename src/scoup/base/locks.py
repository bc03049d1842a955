"""One process at a time writes an output that takes long to make."""

from __future__ import annotations

import errno
import json
import os
import re
import socket
import threading
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from types import MappingProxyType
from typing import Any

from scoup.base.atomic import (
    check_output,
    flush_names,
    flush_to_disk,
    folder_made,
    refusals_named,
    remove,
    replace,
)
from scoup.base.errors import InputError, OutputInUseError, ScoupError, ScoupWarning, WriteError
from scoup.base.holding import HEX, LONGEST_STEM, NO_LINK, is_same, remove_abandoned, try_hold
from scoup.base.shares import Share
from scoup.base.staging import defer_stops

LOCK = ".lock"
FOLDER_LOCK = "scoup.lock"
_MOST_BYTES = 65_536  # of the contents of a lock
READY, UNWANTED = "ready", "unwanted"  # marks of what gets its name, or goes, with an output


@dataclass(frozen=True)
class Output:
    """An output that takes long to make, while this process holds its lock.

    It is made under another name first, and may have something beside it, such as region sums, that appears with it.
    Then the latter is marked by its name, the output gets its name, and what is marked gets its own, or goes. Killed
    amid that, the process leaves the rest to the next one that locks the output, or calls ``complete``: something is
    marked only where all is complete.

    Attributes:
        path: the file or folder.
        descriptor: of the lock file.
        notes: entries of the lock file, beside who holds it and since when.
    """

    path: Path
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
            _write_holder(self.path, self.descriptor, known)

    @contextmanager
    def appearing(self, beside: Path | None = None, name: Path | None = None) -> Iterator[Path]:
        """A path to write the file to. At the end of the block it appears: with what belongs to it, or not at all.

        Args:
            beside: a finished file or folder beside the output. Its name begins with the output's, as does the next.
            name: the name that it gets then; None if it is not needed then.

        Raises:
            WriteError: the system refuses; names the output.
        """
        temporary = _temporary(self.path)
        try:
            with refusals_named(self.path, temporary):
                yield temporary
            self._commit(temporary, beside, name)
        except BaseException:
            remove(temporary)
            raise

    def take(self, finished: Path) -> None:
        """Give a finished file or folder the name of the output.

        Raises:
            WriteError: the system refuses.
        """
        self._commit(finished, None, None)

    def _commit(self, finished: Path, beside: Path | None, name: Path | None) -> None:
        marked = (
            None
            if beside is None
            else _marked(self.path, name or beside, UNWANTED if name is None else READY)
        )
        with defer_stops():
            for path in (finished, beside if name is not None else None):
                if path is not None:
                    flush_to_disk(path)
            try:
                if beside is not None and marked is not None:
                    replace(beside, marked)  # from here on the rest follows, whoever does it
                    flush_names(self.path.parent)
                replace(finished, self.path)
                flush_names(self.path.parent)
            except OSError as error:
                if beside is not None and marked is not None:
                    with suppress(OSError):
                        os.replace(marked, beside)
                raise WriteError.of(self.path, error) from error
            _finish(self.path)


@contextmanager
def locked_output(path: Path, overwrite: bool = False, is_folder: bool = False) -> Iterator[Output]:
    """Keep other processes from writing a file, and what goes beside it, meanwhile.

    ``PATH.lock`` says who writes. It is removed at the end, after an interruption too. One whose process has died
    counts no more; what that process had begun to put in its place is put there (``Output``). Temporary files
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
    unnamed = re.escape(_temporary(path).name[: -len(".temporary")][:LONGEST_STEM])
    temporary = re.compile(rf"\.({own[0]}\.{HEX}{own[1]}|{own[2]}\.{HEX}\.\w+|{unnamed}\.{HEX}\.temporary)")
    with _held(path, lock_path(path), temporary) as descriptor:
        if moved := _finish(path):
            warnings.warn(
                f"{path}: put in place what a killed process had finished ({', '.join(moved)})",
                ScoupWarning,
                stacklevel=3,
            )
        remove(_temporary(path))
        check_output(path, overwrite, is_folder)
        yield Output(path, descriptor)


def complete(path: Path) -> None:
    """Put in its place what a killed process had finished of a file, and of what goes beside it, and remove its lock.

    Nothing happens where a process has left nothing, where it lives, or where the system refuses.

    Warns:
        ScoupWarning: something was put in its place.
    """
    if lock_path(path).is_file() or _unfinished(path):
        with suppress(ScoupError), locked_output(path, overwrite=True, is_folder=path.is_dir()):
            pass


def _temporary(path: Path) -> Path:
    """Where an output is made: its holder alone writes there."""
    return path.with_name(f".{path.name}.temporary")


def _marked(path: Path, name: Path, mark: str) -> Path:
    """The name that a file has until the output has appeared."""
    if name.parent != path.parent or not re.fullmatch(_own(path), name.name):
        raise ValueError(f"{name} does not belong to the output {path}")
    return name.with_name(f".{name.name}.{mark}")


def _own(path: Path) -> str:
    return rf"{re.escape(path.name)}(\.\w+)+"


def _unfinished(path: Path) -> list[Path]:
    """What has got its mark and not its name."""
    marked = re.compile(rf"\.{_own(path)}\.({READY}|{UNWANTED})")
    with suppress(OSError):
        return sorted(item for item in path.parent.iterdir() if marked.fullmatch(item.name))
    return []


def _finish(path: Path) -> list[str]:
    """Take the steps that are left of a commit that has begun; returns the names that were given.

    Raises:
        WriteError: the system refuses.
    """
    names = []
    left = _unfinished(path)
    steps = [(_temporary(path), path)] if left and _temporary(path).exists() else []
    steps += [
        (item, item.with_name(item.name[1:].removesuffix(f".{READY}")))
        for item in left
        if item.suffix == f".{READY}"
    ]
    for source, final in steps:
        try:
            replace(source, final)
        except OSError as error:
            raise WriteError.of(final, error) from error
        names.append(final.name)
    for item in left:
        if item.suffix == f".{UNWANTED}":
            remove(item)
    if left:
        flush_names(path.parent)
    return names


@contextmanager
def locked_folder(path: Path, share: Share = Share()) -> Iterator[None]:  # noqa: B008 - frozen
    """The same for a folder of results, by a file ``scoup.lock`` in it; the folder is made if it is missing.

    Args:
        path: the folder.
        share: of the work that this process does. Each of several holds ``scoup.lock.I-of-N``: one that does
            everything is kept out while any of them works, and they are while it does.

    Raises:
        InputError: it is a file; or as ``locked_output``.
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
            _write_holder(output, descriptor)
            remove_abandoned(lock.parent, temporary)
            yield descriptor
        finally:
            _release(descriptor, lock)


def _release(descriptor: int, lock: Path) -> None:
    """Remove a lock, and close it."""
    with suppress(OSError):
        lock.unlink()  # before it is free: nobody else holds this very file
    os.close(descriptor)
    with suppress(OSError):
        if os.name == "nt":  # where an open file cannot be removed
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
