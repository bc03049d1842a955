"""Several files that appear together, once all are made."""

from __future__ import annotations

import functools
import os
import re
import secrets
import signal
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from scoup.base.atomic import check_output, flush_names, flush_to_disk, folder_made, refusals_named
from scoup.base.holding import HEX, held_temporary, remove_abandoned

_HIDDEN = ".scoup-"
_NAME = re.compile(re.escape(_HIDDEN) + HEX)
_STOPS = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def staged(folder: Path, files: Sequence[str] = (), overwrite: bool = False) -> Iterator[Path]:
    """Yield a hidden folder to write into; at the end everything in it moves into ``folder``.

    On any error in the block, interruption included, it is removed and ``folder`` stays as it was. Interruptions and
    terminations wait while files move (in the main thread). Only a kill, or a refusal of the system, at that moment
    leaves some files new and others old; each is whole.

    Hidden folders that killed processes have left beside it are removed, once in the life of this process.

    Args:
        folder: where the files belong; made if it is missing.
        files: paths within the folder that are checked before the block, and moved first, in this order.
    """
    check_outputs(folder, files, overwrite)
    # In the nearest existing folder: on the same file system, moving is only renaming.
    home = next(place for place in (folder.absolute(), *folder.absolute().parents) if place.is_dir())
    _remove_abandoned_once(home)
    hidden = home / f"{_HIDDEN}{secrets.token_hex(6)}"
    with refusals_named(folder, hidden), held_temporary(hidden, folder=True):
        yield hidden
        found = [str(path.relative_to(hidden)) for path in sorted(hidden.rglob("*")) if path.is_file()]
        first = [file for file in files if file in found]
        with defer_stops():
            _move(hidden, folder, [*first, *(file for file in found if file not in files)], overwrite)


def check_outputs(folder: Path, files: Sequence[str], overwrite: bool) -> None:
    """Check that all files may be written into a folder; see ``base.atomic.check_output``."""
    for file in files:
        check_output(folder / file, overwrite)


def _move(hidden: Path, folder: Path, files: Sequence[str], overwrite: bool) -> None:
    check_outputs(folder, files, overwrite)  # another process may have written meanwhile
    for file in files:
        flush_to_disk(hidden / file)
    for file in files:
        with folder_made((folder / file).parent, folder / file):
            os.replace(hidden / file, folder / file)
    for parent in {(folder / file).parent for file in files}:
        flush_names(parent)


@functools.cache
def _remove_abandoned_once(home: Path) -> None:
    """Remove them once per process: a folder of thousands of files is not listed for each view written into it."""
    remove_abandoned(home, _NAME, only_folders=True)


@contextmanager
def defer_stops() -> Iterator[None]:
    """Defer SIGINT and SIGTERM until the block ends, in the main thread."""
    if threading.current_thread() is not threading.main_thread():  # no signal interrupts the others
        yield
        return
    arrived: list[int] = []
    before = {number: signal.getsignal(number) for number in _STOPS}
    before = {number: handler for number, handler in before.items() if handler is not None}
    try:
        for number in before:
            signal.signal(number, lambda number, _: arrived.append(number))
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for number in arrived:
            signal.raise_signal(number)
