"""Outputs appear complete or not at all, replace nothing unasked, and are written by one process at a time."""

from __future__ import annotations

import io
import os
import shutil
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO, cast

from scoup.base.errors import (
    NO_SPACE,
    InputError,
    OutputExistsError,
    OutputInUseError,
    ScoupError,
    WriteError,
)
from scoup.base.texts import hidden_name, slug

_WAIT = 60.0
"""Seconds to wait, if at all, for another process that writes the same file of a shared folder."""
held: set[Path] = set()
"""Lock files of this process: of outputs that are being written."""


def check_output(*paths: str | Path, overwrite: bool = False, least: int = 0) -> None:
    """Check that these files may be written, and that their disks have as many bytes free, before long work starts.
    Creates nothing."""
    for path in paths:
        _check_output(Path(path), overwrite, least)


def _check_output(path: Path, overwrite: bool, least: int) -> None:
    if os.path.isdir(path):
        what = f"is a link to the folder {os.path.realpath(path)}" if os.path.islink(path) else "is a folder"
        raise InputError(f"{path}: {what}; use the name of a file to write")
    if os.path.lexists(path):
        if os.path.exists(path) and not os.path.isfile(path):
            raise InputError(f"{path}: is not a regular file; use another name")
        if not overwrite:
            raise OutputExistsError(path)
    for parent in path.absolute().parents:
        if os.path.lexists(parent):
            if not os.path.isdir(parent):
                raise InputError(f"{path}: cannot be written because {parent} is not a folder")
            if not os.access(parent, os.W_OK | os.X_OK):
                raise InputError(
                    f"{path}: cannot be written, {parent} is read-only for you; choose another folder"
                )
            free = shutil.disk_usage(parent).free if least else 0
            if free < least:
                reason = f"{free / 1e3:,.0f} kB are free, at least {least / 1e3:,.0f} kB are needed"
                raise WriteError(path, reason, "free space on the disk, or choose another folder")
            break


def make_folder(folder: Path, output: Path) -> list[Path]:
    """Make the folder of an output, with its parents; return those that were missing, the inner first."""
    missing = [path for path in (folder, *folder.parents) if not os.path.exists(path)]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise WriteError.of(output, error) from error
    for path in missing:
        _flush_names(path.parent)
    return missing


@contextmanager
def atomic_path(path: str | Path, overwrite: bool = False, wait: bool = False) -> Iterator[Path]:
    """Yield a path of the same name, in a hidden folder beside ``path``, that becomes ``path`` at the end.

    For libraries that write a file by its name. On any error, interruption included, the hidden folder is removed with
    all that is in it, and ``path`` is unchanged. Only a killed process leaves one, which the next block for ``path``
    removes.

    The folder of ``path`` is made if it is missing; ``wait`` is for another process that writes it, a minute at most.

    Raises:
        OutputExistsError: ``path`` exists, and ``overwrite`` is false.
        OutputInUseError: another process writes it.
        WriteError: the system refuses.
    """
    path = Path(path)
    check_output(path, overwrite=overwrite)
    with (
        temporary_output(path, overwrite, wait) as hidden,
        refusals_named(path, hidden),
        refusals_named(path, hidden / path.name),
    ):
        hidden.mkdir()
        yield hidden / path.name
        _appear(hidden / path.name, path, overwrite)


@contextmanager
def atomic_file(
    path: str | Path, overwrite: bool = False, flush: bool = True, wait: bool = False
) -> Iterator[BinaryIO]:
    """Yield a binary file, without a ``fileno``, that becomes ``path`` when the block ends without an error; see
    ``atomic_path``. Without ``flush`` it is not written to the disk before the rename: whoever writes many files calls
    ``flush_to_disk``."""
    path = Path(path)
    check_output(path, overwrite=overwrite)
    with temporary_output(path, overwrite, wait) as temporary, refusals_named(path, temporary):
        with _Output(temporary) as stream:
            yield cast(BinaryIO, stream)
        _appear(temporary, path, overwrite, flush)


@contextmanager
def reserved_output(path: str | Path, overwrite: bool = False) -> Iterator[Path]:
    """Keep other processes from beginning long work on an output, which the block writes at its end.

    Yields the path of a hidden folder beside the output for files of the work, which is removed before and after the
    block. Arguments and errors are those of ``atomic_path``.
    """
    path = Path(path)
    check_output(path, overwrite=overwrite)
    with temporary_output(path, overwrite, kind="work", lock="work.lock") as work:
        try:
            yield work
        except WriteError as error:
            if not error.path.is_relative_to(work):
                raise
            raise error.at(path) from error


@contextmanager
def temporary_output(
    path: Path, overwrite: bool = False, wait: bool = False, kind: str = "partial", lock: str = "lock"
) -> Iterator[Path]:
    """Keep other processes from writing an output, and yield the path of a temporary file or folder beside it.

    What is there is removed before and after the block. So is the folder, if it was made for it and is left empty.
    ``kind`` and ``lock`` are the endings of the two hidden names.
    """
    temporary = path.with_name(hidden_name(path.name, kind))
    made = make_folder(path.parent, path)
    try:
        with locked(path, wait, lock):
            check_output(path, overwrite=overwrite)  # another process may have written it meanwhile
            remove(temporary)
            try:
                yield temporary
            finally:
                remove(temporary)
    finally:
        for folder in made:
            with suppress(OSError):
                folder.rmdir()


def _appear(temporary: Path, path: Path, overwrite: bool, flush: bool = True) -> None:
    check_output(path, overwrite=overwrite)  # a program that knows no locks may have written it meanwhile
    if flush:
        _flush_content(temporary)
    os.replace(temporary, path)
    if flush:
        _flush_names(path.parent)


def flush_to_disk(*files: Path) -> None:
    """Write files to the disk, and where the file system can, the names of their folders' files."""
    for file in files:
        _flush_content(file)
    for folder in {file.parent for file in files}:
        _flush_names(folder)


def _flush_content(path: Path) -> None:
    """Write a file to the disk: otherwise a rename may get there first."""
    try:
        _flush(path)
    except OSError as error:
        raise WriteError.of(path, error) from error


def _flush_names(folder: Path) -> None:
    with suppress(OSError):
        _flush(folder)


def _flush(path: Path) -> None:
    descriptor = os.open(path, os.O_RDWR if os.name == "nt" else os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def remove(path: Path) -> None:
    """Remove a file or a folder; what is not there, or cannot be removed, is left."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(OSError):
            path.unlink()


def write_text(path: str | Path, text: str, overwrite: bool = False, wait: bool = False) -> None:
    """Write UTF-8 text, with escapes for what UTF-8 has no bytes for, such as parts of other file names; arguments and
    errors as of ``atomic_file``."""
    with atomic_file(path, overwrite, wait=wait) as stream:
        stream.write(text.encode("utf-8", "backslashreplace"))


class _Output(io.BufferedIOBase):
    """An empty file to fill. A write that the system refuses is a WriteError.

    It has no ``fileno`` on purpose: libraries would write past it, and say of a full disk whatever they like. It is not
    an ``io.BufferedWriter``, because numpy before 1.25 takes it that these have one.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._stream = path.open("wb")

    def writable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def write(self, data: Any, /) -> int:
        with self._refusals_named():
            return self._stream.write(data)

    def seek(self, offset: int, whence: int = 0, /) -> int:
        with self._refusals_named():
            return self._stream.seek(offset, whence)

    def tell(self) -> int:
        return self._stream.tell()

    def flush(self) -> None:
        if not self._stream.closed:
            with self._refusals_named():
                self._stream.flush()

    def close(self) -> None:
        try:
            super().close()  # flushes
        finally:
            with self._refusals_named():
                self._stream.close()

    @contextmanager
    def _refusals_named(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise WriteError.of(self._path, error) from error


@contextmanager
def refusals_named(output: Path, temporary: Path) -> Iterator[None]:
    """Let refusals to write a temporary file or folder name the final output, but not those to read a file."""
    try:
        yield
    except WriteError as error:
        final = _final(error.path, output, temporary)
        if final is None:
            raise
        raise error.at(final) from error
    except OSError as error:
        if isinstance(error, ScoupError):
            raise
        final = _final(error.filename, output, temporary)
        # Only a write finds a disk full, even if the error names the file that was copied.
        if final is None and error.errno in NO_SPACE:
            final = output
        if final is None:
            raise
        raise WriteError.of(final, error) from error


def _final(path: Any, output: Path, temporary: Path) -> Path | None:
    """Return the final path of one at, or below, ``temporary``; None for other paths."""
    if not isinstance(path, (str, Path)) or not Path(path).is_relative_to(temporary):
        return None
    return output / Path(path).relative_to(temporary)


@contextmanager
def locked(output: Path, wait: bool = False, kind: str = "lock") -> Iterator[None]:
    """Keep other processes from writing an output until the block ends. The folder of the output must exist.

    The lock file ``.NAME.KIND`` is removed at the end. That of a killed process locks nothing: the system releases it.

    Locks of different kinds do not exclude each other. ``wait`` and errors are as of ``atomic_path``.
    """
    from filelock import FileLock, Timeout

    path = output.with_name(hidden_name(output.name, kind))
    lock = FileLock(path)
    try:
        lock.acquire(timeout=_WAIT if wait else 0, poll_interval=0.01)
        while not path.exists():  # its holder removed it between the opening and the locking
            lock.release(force=True)
            lock.acquire(timeout=_WAIT if wait else 0, poll_interval=0.01)
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


@contextmanager
def staged(
    folder: Path, files: Sequence[str] = (), overwrite: bool = False, stale: Iterable[Path] = ()
) -> Iterator[Path]:
    """Yield a hidden folder to write into; at the end everything in it moves into ``folder``.

    On any error in the block, interruption included, the hidden folder is removed and ``folder`` is unchanged. Only an
    end of the process while files move leaves some of them new and others old; each is whole.

    Args:
        folder: the files' folder; made if it is missing.
        files: paths within the folder that are checked before the block, and moved first, in this order. Two processes
            write into one folder at the same time if their first files differ.
        overwrite: replace existing files.
        stale: files of an earlier output that are removed at the end.

    Raises:
        OutputExistsError, OutputInUseError, WriteError: as ``atomic_path``.
    """
    check_output(*(folder / file for file in files), overwrite=overwrite)
    # Within the folder: on the same file system, moving is only renaming.
    work = folder / slug(" ".join([folder.name, *files[:1]]))
    with ExitStack() as opened:
        try:
            hidden = opened.enter_context(temporary_output(work, overwrite=True))
        except OutputInUseError:
            raise OutputInUseError(folder.joinpath(*files[:1])) from None
        opened.enter_context(refusals_named(folder, hidden))
        hidden.mkdir()
        yield hidden
        written = [str(path.relative_to(hidden)) for path in sorted(hidden.rglob("*")) if path.is_file()]
        first = [file for file in files if file in written]
        ordered = [*first, *(file for file in written if file not in files)]
        # Another program may have written meanwhile.
        check_output(*(folder / file for file in ordered), overwrite=overwrite)
        for file in ordered:
            _flush_content(hidden / file)
        for file in ordered:
            make_folder((folder / file).parent, folder / file)
            os.replace(hidden / file, folder / file)
        for parent in {(folder / file).parent for file in ordered}:
            _flush_names(parent)
        for path in stale:
            remove(path)
