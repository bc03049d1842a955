"""Region sums in folders beside a field: of a build that may be interrupted, and of a field that is updated."""

from __future__ import annotations

import os
import shutil
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from scoup.base.atomic import remove, replace
from scoup.base.errors import FileFormatError, InputError, ScoupWarning, WriteError, refused_read
from scoup.base.locks import Output
from scoup.field.language_field import LanguageField
from scoup.scene.cameras import Camera
from scoup.scene.gaussians import Gaussians
from scoup.scene.regions import Regions
from scoup.uplift.rasterise import changed_views, resumed
from scoup.uplift.region_sums import ENDING, RegionSums, sums_path
from scoup.uplift.storage.entries import ViewRecord


@contextmanager
def checkpoint(
    field: Path,
    gaussians: Gaussians,
    regions: Regions,
    raster_preset: str = "inria",
    **how: Any,
) -> Iterator[RegionSums]:
    """The region sums of a build, in the folder FIELD.partial; what an interrupted build has left there is continued.

    At the end of the block the folder is removed, unless ``save_field`` has made it the field's ``sums_path``.
    After an error it stays for the next build, but for an ``InputError`` before there was a Gaussian in it.

    Args:
        field: the file that is built; the caller has locked it (``base.locks``).
        gaussians, regions, raster_preset: of the build.
        how: further arguments of ``RegionSums``.
    """
    path = partial_path(field)
    sums = resumed(path, gaussians, regions, raster_preset, **how)
    try:
        yield sums
    except InputError:
        if sums.is_empty:
            remove(path)
        raise
    remove(path)


def save_field(
    output: Output,
    field: LanguageField,
    sums: RegionSums | None,
    keep: bool,
    embed_geometry: bool | None = None,
    weight_bits: int = 16,
) -> None:
    """Save a field as an output; its region sums get their name with it, or go.

    Args:
        output: the field's.
        field: see ``LanguageField.save`` for the rest.
        sums: of ``checkpoint``, ``changed_copy`` or ``new_sums``. Others are left as they are.
        keep: as ``sums_path`` of the field.
    """
    mine = sums.path if sums is not None and sums.writable else None
    with output.appearing(mine, sums_path(output.path) if keep else None) as temporary:
        field.save(temporary, False, embed_geometry, weight_bits)
    field.path = output.path


def continued(sums: RegionSums, views: int) -> str | None:
    """What an interrupted build of so many views has left in the sums, in words; None where they are new."""
    if not sums.writable or not (len(sums) or sums.codes is not None):
        return None
    codes = "the codes are kept" if sums.codes is not None else "codes are learned anew"
    return f"{sums.path}: continues an interrupted build: {len(sums)} of {views} views are there, {codes}"


def take_up(output: Path) -> None:
    """Continue a finished shard, if it is there, as one in progress; the caller has locked it."""
    if output.exists():
        replace(output, partial_path(output))


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
    """A writable copy of kept region sums, in the folder FIELD.update.partial; views that an interrupted update has
    added there are not made again.

    At the end of the block the folder is removed, unless ``save_field`` has made it the field's ``sums_path``.
    After an error it stays for the next update if views were added.

    Args:
        source: the folder of kept sums; not changed.
        field: the file that is written; the caller has locked it (``base.locks``).
        add: cameras of views that the sums lack, or hold otherwise; they will be added in this order.
        regions: of these views.

    Raises:
        InputError: the kept sums are damaged, or gone.
        WriteError: the system refuses the copy.
    """
    path = field.with_name(f"{field.name}.update.partial")
    kept = RegionSums.open(source)
    if path.exists() and not _cut_back(path, kept, add, regions):
        warnings.warn(f"{path}: is not of this update; starting over", ScoupWarning, stacklevel=3)
        remove(path)
    try:
        _copy_files(source, path)
        copied = ChangedCopy(RegionSums.open(path, writable=True), kept.views, add)
    except BaseException:
        remove(path)
        raise
    try:
        yield copied
    except BaseException:
        if not copied.n_added:
            remove(path)
        raise
    remove(path)


def _copy_files(source: Path, target: Path) -> None:
    """Copy the files that are not there already. They are never changed, so that a link to each is enough."""
    try:
        target.mkdir(parents=True, exist_ok=True)
        for file in source.glob(f"[!.]*{ENDING}"):
            if not (target / file.name).exists():
                with suppress(OSError):  # not every file system knows links
                    os.link(file, target / file.name)
                    continue
                shutil.copyfile(file, target / file.name)
    except FileNotFoundError as error:
        raise refused_read(source, error) from error
    except OSError as error:
        raise WriteError.of(target, error) from error


def _digests(view: ViewRecord | None) -> tuple[str, str] | None:
    return None if view is None else (view.camera_digest, view.labels_digest)


def _cut_back(path: Path, kept: RegionSums, add: Sequence[Camera], regions: Regions | None) -> bool:
    """Leave only views to add in the copy of an interrupted update, as far as they have not changed since.

    Returns:
        False if it is not of the same scene, or damaged.
    """
    try:
        sums = RegionSums.open(path, writable=True)
    except FileFormatError:
        return False
    if not sums.is_like(kept):
        return False
    changed = [] if regions is None else changed_views(sums, add, regions, torch.device("cpu"))
    mine = {camera.name for camera in add} - {camera.name for camera in changed}
    for name in [name for name in sums.views if name not in mine]:
        sums.remove(name)
    sums.remove_codes()
    return True


@contextmanager
def new_sums(field: Path, verb: str) -> Iterator[Path]:
    """The path of a new folder of region sums, FIELD.VERB.partial; what a killed process has left there is removed.

    At the end of the block the folder is removed, unless ``save_field`` has made it the field's ``sums_path``.

    Args:
        field: the file that is written; the caller has locked it (``base.locks``).
        verb: what makes the sums.
    """
    path = field.with_name(f"{field.name}.{verb}.partial")
    remove(path)
    try:
        yield path
    finally:
        remove(path)
