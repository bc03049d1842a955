"""Outputs appear complete or not at all, and never replace a file unasked."""

from __future__ import annotations

import io
import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO, cast

from scoup.base.errors import NO_SPACE, InputError, OutputExistsError, ScoupError, WriteError
from scoup.base.holding import LONGEST_STEM, held_temporary


def check_output(path: str | Path, overwrite: bool = False, is_folder: bool = False) -> Path:
    """Check that ``path`` may be written, before long work starts. Creates nothing.

    Args:
        path: the output.
        overwrite: replace what is there.
        is_folder: the output is a folder that is replaced as a whole, not a file.

    Returns:
        The path.
    """
    path = Path(path)
    if os.path.isdir(path) and not is_folder:
        raise InputError(f"{path}: is a folder; use the name of a file to write")
    if os.path.isfile(path) and is_folder:
        raise InputError(f"{path}: is a file; move it, as a folder of this name is written")
    if os.path.lexists(path):
        if os.path.exists(path) and not os.path.isfile(path) and not os.path.isdir(path):
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
            break
    return path


@contextmanager
def folder_made(folder: Path, output: Path) -> Iterator[None]:
    """Make the folder of an output, with its parents; after an error those that were missing are removed again."""
    missing = [place for place in (folder, *folder.parents) if not os.path.exists(place)]
    try:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise WriteError.of(output, error) from error
        for place in missing:
            flush_names(place.parent)
        yield
    except BaseException:
        for place in missing:
            with suppress(OSError):  # others may have written there
                place.rmdir()
        raise


@contextmanager
def atomic_path(path: str | Path, overwrite: bool = False) -> Iterator[Path]:
    """Yield a path of the same name, in a hidden folder beside ``path``, that becomes ``path`` at the end.

    The parent folder is made if it is missing. On any error, interruption included, the hidden folder is removed with
    all that is in it, and ``path`` keeps what it held.

    Args:
        path: the output.
        overwrite: replace what is there.
    """
    # A folder, as libraries may write files of other names first, which no process holds.
    with _appearing(path, overwrite, in_folder=True) as temporary:
        yield temporary


@contextmanager
def atomic_file(path: str | Path, overwrite: bool = False, flush: bool = True) -> Iterator[BinaryIO]:
    """Yield a binary file that becomes ``path`` when the block ends without an error. See ``atomic_path``.

    It has no ``fileno``.

    Args:
        path: the output.
        overwrite: replace what is there.
        flush: have it on the disk before it gets its name; else whoever writes many files calls ``flush_to_disk``.
    """
    with _appearing(path, overwrite, in_folder=False, flush=flush) as temporary, _Output(temporary) as stream:
        yield cast(BinaryIO, stream)


def flush_to_disk(path: Path) -> None:
    """Write a file, or a folder with its files, to the disk: otherwise a rename may get there first."""
    if path.is_dir():
        for file in path.iterdir():
            flush_to_disk(file)
        with suppress(OSError):
            _flush(path)
        return
    try:
        _flush(path)
    except OSError as error:
        raise WriteError.of(path, error) from error


def flush_names(folder: Path) -> None:
    """Write the names of a folder's files to the disk, where the file system can."""
    with suppress(OSError):
        _flush(folder)


def _flush(path: Path) -> None:
    descriptor = os.open(path, os.O_RDWR if os.name == "nt" else os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def replace(source: Path, target: Path) -> None:
    """Rename a file or a folder, in place of what is there. A folder is moved aside first, and then removed."""
    if not target.is_dir():
        os.replace(source, target)
        return
    aside = hidden_path(target)
    os.replace(target, aside)
    try:
        os.replace(source, target)
    except OSError:
        os.replace(aside, target)
        raise
    remove(aside)


def remove(path: Path) -> None:
    """Remove a file or a folder; what is not there, or cannot be removed, is left."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(OSError):
            path.unlink()


def hidden_path(path: Path) -> Path:
    """Return a new name for a temporary file or folder beside an output."""
    return path.with_name(f".{path.stem[:LONGEST_STEM]}.{secrets.token_hex(6)}{path.suffix}")


def write_text(path: str | Path, text: str, overwrite: bool = False) -> None:
    """Write UTF-8 text atomically."""
    with atomic_file(path, overwrite) as stream:
        stream.write(text.encode("utf-8"))


@contextmanager
def _appearing(path: str | Path, overwrite: bool, in_folder: bool, flush: bool = True) -> Iterator[Path]:
    """Yield the path of a temporary file that is held (``base.holding``), or is in a folder that is."""
    path = check_output(path, overwrite)
    hidden = hidden_path(path)
    temporary = hidden / path.name if in_folder else hidden
    with (
        folder_made(path.parent, path),
        refusals_named(path, hidden),
        refusals_named(path, temporary),
        held_temporary(hidden, in_folder),
    ):
        yield temporary
        check_output(path, overwrite)  # somebody else may have written the file meanwhile
        if flush:
            flush_to_disk(temporary)
        os.replace(temporary, path)
        if flush:
            flush_names(path.parent)


class _Output(io.BufferedIOBase):
    """An empty file to fill. A write that the system refuses is a WriteError.

    It has no ``fileno`` on purpose: libraries would write past it, and say of a full disk whatever they like.
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
    """Let refusals to write a temporary file or folder name the final output.

    A file that cannot be read in the block is not mistaken for one that cannot be written.
    """
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
        # A disk is full for those that write only, even where the file named is the one that was copied.
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
