"""Several files that appear together, or not at all."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from scoup.base.errors import InputError


@contextmanager
def staged(folder: Path, files: Sequence[str], overwrite: bool) -> Iterator[Path]:
    """A hidden folder to write ``files`` into; at the end they move into ``folder``.

    On any error, interruption included, they are removed and ``folder`` stays as it was.

    Args:
        folder: where the files belong; made if it is missing.
        files: their paths within the folder.
        overwrite: replace what is there.

    Raises:
        OutputExistsError, InputError: as ``io.check_output``, before and after the block.
    """
    check_outputs(folder, files, overwrite)
    # In the nearest existing folder: on the same file system, moving is only renaming.
    home = next(place for place in (folder.absolute(), *folder.absolute().parents) if place.is_dir())
    hidden = home / f".scoup-{secrets.token_hex(6)}"
    try:
        hidden.mkdir()
        yield hidden
        check_outputs(folder, files, overwrite)  # another process may have written meanwhile
        for file in files:
            (folder / file).parent.mkdir(parents=True, exist_ok=True)
            os.replace(hidden / file, folder / file)
    except OSError as error:
        if isinstance(error, InputError) or error.filename is None or hidden.name not in str(error.filename):
            raise
        raise InputError(f"{folder}: cannot be written ({error.strerror or error})") from error
    finally:
        shutil.rmtree(hidden, ignore_errors=True)


def check_outputs(folder: Path, files: Sequence[str], overwrite: bool) -> None:
    """Check that all files may be written into a folder; see ``io.check_output``."""
    from scoup.io import check_output  # loads torch: not before a verb runs

    for file in files:
        check_output(folder / file, overwrite)


def check_folder(folder: Path) -> None:
    """Refuse a name that is meant for a file where a folder is written.

    Raises:
        InputError: it is.
    """
    if folder.is_file():
        raise InputError(f"{folder}: is a file; give the name of a folder to write the results into")
    if folder.suffix.lower() in (".png", ".jpg", ".jpeg", ".json", ".mp4") and not folder.is_dir():
        raise InputError(f"{folder}: the results are several files; give the name of a folder with --out")
