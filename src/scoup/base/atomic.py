"""Outputs appear complete or not at all, and never replace a file unasked."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from scoup.base.errors import InputError, OutputExistsError


def check_output(path: str | Path, overwrite: bool = False) -> Path:
    """Check that ``path`` may be written, before long work starts. Creates nothing.

    Returns:
        The path.

    Raises:
        OutputExistsError: there is a file already and ``overwrite`` is false.
        InputError: the path is a folder or a special file, or its folder is a file or cannot be written to.
    """
    path = Path(path)
    if os.path.isdir(path):
        raise InputError(f"{path}: is a folder; give the name of a file to write")
    if os.path.lexists(path):
        if os.path.exists(path) and not os.path.isfile(path):
            raise InputError(f"{path}: is not a regular file; give another name")
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
def atomic_path(path: str | Path, overwrite: bool = False) -> Iterator[Path]:
    """A temporary path in the same folder (and with the same extension) that becomes ``path`` at the end.

    The parent folder is made if it is missing. On any error, interruption included, the temporary file is
    removed and ``path`` keeps what it held.

    Raises:
        OutputExistsError, InputError: as ``check_output``; InputError also where the system refuses.
    """
    path = check_output(path, overwrite)
    temporary = path.with_name(f".{path.stem[:64]}.{secrets.token_hex(6)}{path.suffix}")
    with _refusals_named(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    try:
        yield temporary
        # Somebody else may have written the file meanwhile.
        check_output(path, overwrite)
        with _refusals_named(path):
            os.replace(temporary, path)
    except BaseException:
        with suppress(OSError):
            temporary.unlink()
        raise


@contextmanager
def atomic_file(path: str | Path, overwrite: bool = False) -> Iterator[BinaryIO]:
    """A binary file that becomes ``path`` when the block ends without an error. See ``atomic_path``."""
    with atomic_path(path, overwrite) as temporary:
        with _refusals_named(Path(path)):
            stream = temporary.open("xb")
        with stream:
            yield stream


def write_text(path: str | Path, text: str, overwrite: bool = False) -> None:
    """Write UTF-8 text atomically."""
    with atomic_file(path, overwrite) as stream:
        stream.write(text.encode("utf-8"))


@contextmanager
def _refusals_named(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror or error})") from error
