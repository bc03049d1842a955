"""Region sums in files: of a build that may be interrupted, and of a field that is updated."""

from __future__ import annotations

import re
import shutil
import warnings
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from scoup.base.atomic import atomic_path
from scoup.base.errors import InputError, ScoupWarning, WriteError
from scoup.base.processes import ALONE, Processes
from scoup.scene.gaussians import Gaussians
from scoup.scene.regions import Regions
from scoup.uplift.rasterise import resumed
from scoup.uplift.region_sums import RegionSums


@contextmanager
def checkpoint(
    field: Path,
    gaussians: Gaussians,
    regions: Regions,
    raster_preset: str = "inria",
    keep: Path | None = None,
    processes: Processes = ALONE,
    **how: Any,
) -> Iterator[RegionSums]:
    """The region sums of a build, in the file FIELD.partial; what an interrupted build has left there is continued.

    At the end of the block the file becomes ``keep`` or is removed. After an error it stays for the next
    build, but for an ``InputError`` before there was anything in it.

    Files of sums that builds by another number of processes have left are removed.

    Args:
        field: the file that is built; the caller has locked it (``base.locks``).
        gaussians, regions, raster_preset: of the build.
        keep: where the sums stay after the build; None for nowhere.
        processes: each has a file of its own. None may end the block before the field is written.
        how: further arguments of ``RegionSums``.

    Raises:
        InputError: several processes cannot keep sums.
        WriteError: files of other builds cannot be removed.
    """
    if keep is not None and processes.world > 1:
        raise InputError("--keep-sums works in one process; run without torchrun")
    path = field.with_name(_partial_name(field, processes.rank, processes.world))
    processes.of_first(lambda: _remove_others(field, processes.world))
    sums = resumed(path, gaussians, regions, raster_preset, **how)
    try:
        with closing(sums):  # before its file is removed
            yield sums
    except InputError:
        if sums.is_empty:
            path.unlink(missing_ok=True)
        raise
    if keep is not None:
        path.replace(keep)
    else:
        path.unlink(missing_ok=True)


def continued(sums: RegionSums, views: int) -> str | None:
    """What an interrupted build of so many views has left in the sums, in words; None where they are new."""
    if not sums.writable or not (len(sums) or sums.codes is not None):
        return None
    codes = "the codes are kept" if sums.codes is not None else "codes are learned anew"
    return f"{sums.path}: continues an interrupted build: {len(sums)} of {views} views are there, {codes}"


def _partial_name(field: Path, rank: int, world: int) -> str:
    return f"{field.name}.partial" + (f".{rank}" if world > 1 else "")


def _remove_others(field: Path, world: int) -> None:
    """Remove the checkpoints of another number of processes, which nobody would continue."""
    own = {_partial_name(field, rank, world) for rank in range(world)}
    pattern = re.compile(re.escape(f"{field.name}.partial") + r"(\.\d+)?")
    try:
        names = (path.name for path in field.parent.iterdir() if pattern.fullmatch(path.name))
        others = sorted(set(names) - own)
        for name in others:
            field.with_name(name).unlink(missing_ok=True)
    except OSError as error:
        raise WriteError.of(error.filename or field, error) from error
    if others:
        warnings.warn(
            f"{field}: removed what a build by another number of processes has left ({', '.join(others)})",
            ScoupWarning,
            stacklevel=6,
        )


@contextmanager
def changed_copy(source: Path, target: Path, overwrite: bool = False) -> Iterator[RegionSums]:
    """A writable copy of kept region sums, which appears at ``target`` at the end of the block, or not at all.

    Args:
        source: the file of kept sums; not changed, unless it is the target.
        target: see ``base.atomic.atomic_path``.
        overwrite: replace what is there.
    """
    with atomic_path(target, overwrite) as copy:
        shutil.copyfile(source, copy)
        with closing(RegionSums.open(copy, writable=True)) as sums:
            yield sums


@contextmanager
def followed_copy(source: Path, target: Path, overwrite: bool = False) -> Iterator[tuple[RegionSums, Path]]:
    """Kept region sums, to be read, and the path of a new file to be made from them, which appears at ``target`` at the
    end of the block, or not at all.

    Args:
        source, target, overwrite: see ``changed_copy``.
    """
    with atomic_path(target, overwrite) as new, closing(RegionSums.open(source)) as sums:
        yield sums, new
