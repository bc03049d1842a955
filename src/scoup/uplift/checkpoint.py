"""Region sums in files: of a build that may be interrupted, and of a field that is updated."""

from __future__ import annotations

import os
import shutil
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from scoup.base.atomic import Move, atomic_path
from scoup.base.errors import FileFormatError, InputError, ScoupWarning, refused_read
from scoup.base.locks import Lock
from scoup.scene.cameras import Camera
from scoup.scene.gaussians import Gaussians
from scoup.scene.regions import Regions
from scoup.uplift.rasterise import changed_views, resumed
from scoup.uplift.region_sums import VIEW, RegionSums, sums_path
from scoup.uplift.storage.entries import ViewRecord
from scoup.uplift.storage.record_file import RecordFile

_AT_A_TIME = 1 << 24  # bytes compared


@contextmanager
def checkpoint(
    field: Path,
    gaussians: Gaussians,
    regions: Regions,
    raster_preset: str = "inria",
    **how: Any,
) -> Iterator[RegionSums]:
    """The region sums of a build, in the file FIELD.partial; what an interrupted build has left there is continued.

    At the end of the block the file is removed, unless ``moved_with_sums`` has made it the field's ``sums_path``. After
    an error it stays for the next build, but for an ``InputError`` before there was anything in it.

    Args:
        field: the file that is built; the caller has locked it (``base.locks``).
        gaussians, regions, raster_preset: of the build.
        how: further arguments of ``RegionSums``.
    """
    path = partial_path(field)
    sums = resumed(path, gaussians, regions, raster_preset, **how)
    try:
        with closing(sums):  # before its file is removed
            yield sums
    except InputError:
        if sums.is_empty:
            path.unlink(missing_ok=True)
        raise
    path.unlink(missing_ok=True)


def moved_with_sums(lock: Lock, sums: RegionSums, keep: bool) -> Move:
    """What gives a finished field its name (``LanguageField.save(move=)``) while its region sums get theirs, or go.

    Args:
        lock: of the field.
        sums: of ``checkpoint`` or ``changed_copy``; closed when the field is moved. Others are left as they are.
        keep: as ``sums_path`` of the field.
    """

    def move(temporary: Path, field: Path) -> None:
        moves, removed = {temporary: field}, []
        if sums.writable and sums.path is not None:
            sums.close()  # before its file is moved
            if keep:
                moves[sums.path] = sums_path(field)
            else:
                removed.append(sums.path)
        lock.finish(moves, removed)

    return move


def moved_alone(lock: Lock, sums: RegionSums) -> None:
    """Give region sums of ``checkpoint`` that are an output of their own, a shard, their name.

    Args:
        lock: of the output.
        sums: closed here.
    """
    assert sums.path is not None
    sums.close()
    lock.finish({sums.path: lock.output})


def continued(sums: RegionSums, views: int) -> str | None:
    """What an interrupted build of so many views has left in the sums, in words; None where they are new."""
    if not sums.writable or not (len(sums) or sums.codes is not None):
        return None
    codes = "the codes are kept" if sums.codes is not None else "codes are learned anew"
    return f"{sums.path}: continues an interrupted build: {len(sums)} of {views} views are there, {codes}"


def take_up(output: Path) -> None:
    """Continue a finished shard, if it is there, as one in progress; the caller has locked it."""
    if output.exists():
        os.replace(output, partial_path(output))


def partial_path(field: Path) -> Path:
    """Where a build keeps what it has done, until the field is there."""
    return field.with_name(f"{field.name}.partial")


@dataclass(frozen=True, eq=False)
class ChangedCopy:
    """A copy of kept region sums that an update changes.

    Attributes:
        sums: the copy.
        before: the views of the sums that were copied.
        add: the cameras of the views to add, in this order.
    """

    sums: RegionSums
    before: Mapping[str, ViewRecord]
    add: Sequence[Camera]

    @property
    def n_added(self) -> int:
        """How many views of those to add are in it."""
        there = ((self.before.get(camera.name), self.sums.views.get(camera.name)) for camera in self.add)
        return sum(new is not None and _digests(new) != _digests(old) for old, new in there)


@contextmanager
def changed_copy(
    source: Path, field: Path, add: Sequence[Camera] = (), regions: Regions | None = None
) -> Iterator[ChangedCopy]:
    """A writable copy of kept region sums, in the file FIELD.update.partial; what an interrupted update of the same
    sums has left there is continued, as far as it is what this one would do.

    At the end of the block the file is removed, unless ``moved_with_sums`` has made it the field's ``sums_path``. After
    an error it stays for the next update if views were added.

    Args:
        source: the file of kept sums; not changed.
        field: the file that is written; the caller has locked it (``base.locks``).
        add: cameras of views that the sums lack, or hold otherwise; they will be added in this order.
        regions: of these views.

    Raises:
        InputError: the kept sums are damaged, or gone.
        WriteError: the system refuses the copy.
    """
    path = field.with_name(f"{field.name}.update.partial")
    with closing(RegionSums.open(source)) as kept:
        before = kept.views
    if path.exists() and not _cut_back(path, source, add, regions):
        warnings.warn(f"{path}: is not of this update; starting over", ScoupWarning, stacklevel=3)
        path.unlink()
    if not path.exists():
        with atomic_path(path) as temporary:
            _copy(source, temporary)
    copied = ChangedCopy(RegionSums.open(path, writable=True), before, add)
    try:
        with closing(copied.sums):
            yield copied
    except BaseException:
        if not copied.n_added:
            path.unlink(missing_ok=True)
        raise
    path.unlink(missing_ok=True)


def _copy(source: Path, target: Path) -> None:
    try:
        shutil.copyfile(source, target)
    except FileNotFoundError as error:
        raise refused_read(source, error) from error


def _digests(view: ViewRecord | None) -> tuple[str, str] | None:
    return None if view is None else (view.camera_digest, view.labels_digest)


def _cut_back(path: Path, source: Path, add: Sequence[Camera], regions: Regions | None) -> bool:
    """Leave in a copy of region sums only what ``source`` holds, and the first of the views to add.

    Returns:
        False if it is no copy of them.
    """
    try:
        with closing(RegionSums.open(path)) as sums:
            changed = [] if regions is None else changed_views(sums, add, regions, torch.device("cpu"))
        there = {camera.name for camera in add} - {camera.name for camera in changed}
        with (
            closing(RecordFile.open(source)) as kept,
            closing(RecordFile.open(path, writable=True)) as copied,
        ):
            if not _begins_like(path, source, kept.size):
                return False
            more = [
                (record.kind, record.header.get("name")) for record in copied.records[len(kept.records) :]
            ]
            wanted = [(VIEW, camera.name) for camera in add]
            count = 0
            while (
                count < min(len(more), len(wanted))
                and more[count] == wanted[count]
                and more[count][1] in there
            ):
                count += 1
            copied.cut(len(kept.records) + count)
    except FileFormatError:
        return False
    return True


def _begins_like(path: Path, other: Path, size: int) -> bool:
    """Whether the first bytes of two files are the same."""
    with path.open("rb") as first, other.open("rb") as second:
        for start in range(0, size, _AT_A_TIME):
            length = min(_AT_A_TIME, size - start)
            if first.read(length) != second.read(length):
                return False
    return True


@contextmanager
def new_sums(field: Path, verb: str) -> Iterator[Path]:
    """The path of a new file of region sums, FIELD.VERB.partial; what a killed process has left there is removed.

    At the end of the block the file is removed, unless ``moved_with_sums`` has made it the field's ``sums_path``.

    Args:
        field: the file that is written; the caller has locked it (``base.locks``).
        verb: what makes the sums.
    """
    path = field.with_name(f"{field.name}.{verb}.partial")
    path.unlink(missing_ok=True)
    try:
        yield path
    finally:
        path.unlink(missing_ok=True)
