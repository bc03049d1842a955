"""Region sums in files: of a build that may be interrupted, and of a field that is updated."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from scoup.base.atomic import atomic_path
from scoup.base.errors import InputError
from scoup.base.processes import ALONE, Processes
from scoup.scene.gaussians import Gaussians
from scoup.scene.regions import Regions
from scoup.uplift.rasterise import resumed
from scoup.uplift.region_sums import RegionSums, sums_path


@contextmanager
def checkpoint(
    field: Path,
    gaussians: Gaussians,
    regions: Regions,
    raster_preset: str = "inria",
    keep: bool = False,
    processes: Processes = ALONE,
    **how: Any,
) -> Iterator[RegionSums]:
    """The region sums of a build, in the file FIELD.partial; what an interrupted build has left there is continued.

    At the end of the block the file becomes ``sums_path(field)`` or is removed. After an error it stays for the next
    build, but for an ``InputError`` before there was anything in it.

    Args:
        field: the file that is built.
        gaussians, regions, raster_preset: of the build.
        keep: the sums after the build.
        processes: each has a file of its own.
        how: further arguments of ``RegionSums``.

    Raises:
        InputError: several processes cannot keep sums.
    """
    if keep and processes.world > 1:
        raise InputError("--keep-sums works in one process; run without torchrun")
    rank = f".{processes.rank}" if processes.world > 1 else ""
    path = field.with_name(f"{field.name}.partial{rank}")
    sums = resumed(path, gaussians, regions, raster_preset, **how)
    try:
        yield sums
    except InputError:
        if sums.is_empty:
            path.unlink(missing_ok=True)
        raise
    sums.close()
    if keep:
        path.replace(sums_path(field))
    else:
        path.unlink(missing_ok=True)


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
        sums = RegionSums.open(copy, writable=True)
        try:
            yield sums
        finally:
            sums.close()
