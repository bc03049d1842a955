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
        with refusals_named(folder, hidden):
            hidden.mkdir()
            with _held(hidden):
                yield hidden
                found = [
                    str(path.relative_to(hidden)) for path in sorted(hidden.rglob("*")) if path.is_file()
                ]
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
def _held(folder: Path) -> Iterator[None]:
    """Hold a folder, where the system can, so that no other process takes it for abandoned."""
    descriptor = None
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try_hold(descriptor)
    try:
        yield
    finally:
        if descriptor is not None:
            os.close(descriptor)
