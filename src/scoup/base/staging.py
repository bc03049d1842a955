"""Several files that appear together, or not at all."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from scoup.base.atomic import check_output, folder_made, refusals_named
from scoup.base.holding import remove_abandoned, try_hold

_HIDDEN = ".scoup-"


@contextmanager
def staged(folder: Path, files: Sequence[str] = (), overwrite: bool = False) -> Iterator[Path]:
    """A hidden folder to write into; at the end everything in it moves into ``folder``.

    On any error, interruption included, it is removed and ``folder`` stays as it was. What a killed process has left
    behind in this way is removed.

    Args:
        folder: where the files belong; made if it is missing.
        files: paths within the folder that are checked before the block, and moved first, in this order.
        overwrite: replace what is there.

    Raises:
        OutputExistsError, InputError: as ``base.atomic.check_output``, before and after the block.
        WriteError: the system refuses to write a file; names it as it would be in ``folder``.
    """
    check_outputs(folder, files, overwrite)
    # In the nearest existing folder: on the same file system, moving is only renaming.
    home = next(place for place in (folder.absolute(), *folder.absolute().parents) if place.is_dir())
    remove_abandoned(home.glob(f"{_HIDDEN}*"))
    hidden = home / f"{_HIDDEN}{secrets.token_hex(6)}"
    try:
        with refusals_named(folder, hidden), _made_and_held(hidden):
            yield hidden
            found = [str(path.relative_to(hidden)) for path in sorted(hidden.rglob("*")) if path.is_file()]
            first = [file for file in files if file in found]
            _move(hidden, folder, [*first, *(file for file in found if file not in files)], overwrite)
    finally:
        shutil.rmtree(hidden, ignore_errors=True)


def check_outputs(folder: Path, files: Sequence[str], overwrite: bool) -> None:
    """Check that all files may be written into a folder; see ``base.atomic.check_output``."""
    for file in files:
        check_output(folder / file, overwrite)


def _move(hidden: Path, folder: Path, files: Sequence[str], overwrite: bool) -> None:
    check_outputs(folder, files, overwrite)  # another process may have written meanwhile
    for file in files:
        with folder_made((folder / file).parent, folder / file):
            os.replace(hidden / file, folder / file)


@contextmanager
def _made_and_held(hidden: Path) -> Iterator[None]:
    """Make a hidden folder, and hold it where the system can, so that no other process takes it for abandoned."""
    fresh = hidden.with_name(f".new{hidden.name}")  # a name that nobody looks for, until it is held
    descriptor = None
    try:
        fresh.mkdir()
        with suppress(OSError):
            descriptor = os.open(fresh, os.O_RDONLY)
            try_hold(descriptor)
        fresh.rename(hidden)
        yield
    except OSError as error:
        if error.filename == str(fresh):
            error.filename = str(hidden)
        raise
    finally:
        if descriptor is not None:
            os.close(descriptor)
        with suppress(OSError):
            fresh.rmdir()
