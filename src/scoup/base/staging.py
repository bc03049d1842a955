"""Several files that appear together, once all are made."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from scoup.base.atomic import (
    check_output,
    flush_names,
    flush_to_disk,
    make_folder,
    refusals_named,
    temporary_output,
)
from scoup.base.file_names import slug


@contextmanager
def staged(folder: Path, files: Sequence[str] = (), overwrite: bool = False) -> Iterator[Path]:
    """Yield a hidden folder to write into; at the end everything in it moves into ``folder``.

    On any error in the block, interruption included, the hidden folder is removed and ``folder`` is unchanged. Only an
    end of the process while files move leaves some of them new and others old; each is whole.

    Args:
        folder: the files' folder; made if it is missing.
        files: paths within the folder that are checked before the block, and moved first, in this order. Two processes
            write into one folder at the same time if their first files differ.
        overwrite: replace existing files.

    Raises:
        OutputExistsError, OutputInUseError, WriteError: as ``base.atomic.atomic_path``.
    """
    check_outputs(folder, files, overwrite)
    # In the nearest existing folder: on the same file system, moving is only renaming.
    home = next(place for place in (folder.absolute(), *folder.absolute().parents) if place.is_dir())
    work = home / slug(" ".join([folder.name, *files[:1]]))
    with temporary_output(work, overwrite=True) as hidden, refusals_named(folder, hidden):
        hidden.mkdir()
        yield hidden
        found = [str(path.relative_to(hidden)) for path in sorted(hidden.rglob("*")) if path.is_file()]
        first = [file for file in files if file in found]
        _move(hidden, folder, [*first, *(file for file in found if file not in files)], overwrite)


def check_outputs(folder: Path, files: Sequence[str], overwrite: bool) -> None:
    """Check that all files may be written into a folder; see ``base.atomic.check_output``."""
    for file in files:
        check_output(folder / file, overwrite)


def _move(hidden: Path, folder: Path, files: Sequence[str], overwrite: bool) -> None:
    check_outputs(folder, files, overwrite)  # another program may have written meanwhile
    for file in files:
        flush_to_disk(hidden / file)
    for file in files:
        make_folder((folder / file).parent, folder / file)
        os.replace(hidden / file, folder / file)
    for parent in {(folder / file).parent for file in files}:
        flush_names(parent)
