"""Folders of region sums beside a field, so that interrupted builds and updates can continue."""

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
from scoup.uplift.rasterise import changed_views, resume_sums
from scoup.uplift.region_sums import RegionSums
from scoup.uplift.storage.entries import ViewRecord
from scoup.uplift.storage.paths import ENDING, partial_path, sums_path


@contextmanager
def checkpoint(
    field: Path,
    gaussians: Gaussians,
    regions: Regions,
    raster_preset: str = "inria",
    **how: Any,
) -> Iterator[RegionSums]:
    """Keep the region sums of a build in the folder FIELD.partial, and continue those of an interrupted build.

    At the end of the block the folder is removed, unless ``save_field`` has made it the field's ``sums_path``. After
    an error it stays for the next build, except for an ``InputError`` while it is empty. The caller has locked the
    field (``base.locks``); ``how`` are further arguments of ``RegionSums``.
    """
    path = partial_path(field)
    sums = resume_sums(path, gaussians, regions, raster_preset, **how)
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
    """Save a field as an output, and in the same commit rename its region sums to ``sums_path`` if ``keep`` is set.

    ``sums`` are of ``checkpoint``, ``copy_for_update`` or ``new_sums``; read-only ones are not renamed.
    """
    mine = sums.path if sums is not None and sums.writable else None
    with output.appearing(mine, sums_path(output.path) if keep else None) as temporary:
        field.save(temporary, False, embed_geometry, weight_bits)
    field.path = output.path


def resume_message(sums: RegionSums, views: int) -> str | None:
    """Return a message about the interrupted build that the sums continue; None if they are new."""
    if not sums.writable or not (len(sums) or sums.codes is not None):
        return None
    codes = "the codes are kept" if sums.codes is not None else "codes are learned again"
    return f"{sums.path}: resumes an interrupted build: {len(sums)} of {views} views are done, {codes}"


def resume_shard(output: Path) -> None:
    """Turn a finished shard back into one in progress; the caller has locked it."""
    if output.exists():
        replace(output, partial_path(output))


@dataclass(frozen=True, eq=False)
class UpdateCopy:
    """A copy of kept region sums that an update changes."""

    sums: RegionSums
    before: Mapping[str, ViewRecord]  # views of the original
    add: Sequence[Camera]  # of the views to add, in this order

    @property
    def n_added(self) -> int:
        """Number of views to add that the copy contains already."""
        there = ((self.before.get(camera.name), self.sums.views.get(camera.name)) for camera in self.add)
        return sum(new is not None and (old is None or new.digests != old.digests) for old, new in there)


@contextmanager
def copy_for_update(
    source: Path, field: Path, add: Sequence[Camera] = (), regions: Regions | None = None
) -> Iterator[UpdateCopy]:
    """Copy kept region sums to the folder FIELD.update.partial, and keep views that an interrupted update has added.

    At the end of the block the folder is removed, unless ``save_field`` has made it the field's ``sums_path``. After
    an error it stays for the next update if views were added. ``add`` are cameras of views that the sums lack or
    contain otherwise, ``regions`` those of these views. The caller has locked the field (``base.locks``).
    """
    path = field.with_name(f"{field.name}.update.partial")
    kept = RegionSums.open(source)
    if path.exists() and not _cut_back(path, kept, add, regions):
        warnings.warn(f"{path}: belongs to another update; starting over", ScoupWarning, stacklevel=3)
        remove(path)
    try:
        _copy_files(source, path)
        copied = UpdateCopy(RegionSums.open(path, writable=True), kept.views, add)
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
    """Link or copy the files that are missing; links are enough, because files are never changed in place."""
    try:
        target.mkdir(parents=True, exist_ok=True)
        for file in source.glob(f"[!.]*{ENDING}"):
            if not (target / file.name).exists():
                with suppress(OSError):  # some file systems have no links
                    os.link(file, target / file.name)
                    continue
                shutil.copyfile(file, target / file.name)
    except FileNotFoundError as error:
        raise refused_read(source, error) from error
    except OSError as error:
        raise WriteError.of(target, error) from error


def _cut_back(path: Path, kept: RegionSums, add: Sequence[Camera], regions: Regions | None) -> bool:
    """Reduce the copy of an interrupted update to views to add that have not changed since; False if it is unusable."""
    try:
        sums = RegionSums.open(path, writable=True)
    except FileFormatError:
        return False
    if not sums.is_compatible(kept):
        return False
    changed = [] if regions is None else changed_views(sums, add, regions, torch.device("cpu"))
    mine = {camera.name for camera in add} - {camera.name for camera in changed}
    for name in [name for name in sums.views if name not in mine]:
        sums.remove(name)
    sums.remove_codes()
    return True


@contextmanager
def new_sums(field: Path) -> Iterator[Path]:
    """Yield the path of a new folder of region sums, FIELD.merge.partial, after removing what a killed process left.

    At the end of the block the folder is removed, unless ``save_field`` has made it the field's ``sums_path``. The
    caller has locked the field (``base.locks``).
    """
    path = field.with_name(f"{field.name}.merge.partial")
    remove(path)
    try:
        yield path
    finally:
        remove(path)
