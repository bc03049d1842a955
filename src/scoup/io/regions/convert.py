"""Region features from one layout to the other: LangSplat's and the compact one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scoup.base.errors import InputError, MissingFileError
from scoup.base.progress import Progress, no_progress
from scoup.io.reading import existing_folder
from scoup.io.regions.compact import (
    ENDING,
    CompactView,
    read_compact_embeddings,
    read_compact_labels,
    read_compact_view,
    write_compact_view,
)
from scoup.io.regions.langsplat import write_langsplat_view
from scoup.io.regions.langsplat_files import FILE_LEVELS, level_blocks, open_langsplat_view
from scoup.io.regions.manifest import MANIFEST, Layout, RegionManifest, read_manifest, write_manifest
from scoup.io.regions.views import FOLDER_NAME, view_files


@dataclass(frozen=True)
class ConvertReport:
    """What a conversion did.

    Attributes:
        source, target: the folders.
        layout: of the target.
        views: converted.
        bytes_before, bytes_after: of the views' files.
    """

    source: Path
    target: Path
    layout: Layout
    views: int
    bytes_before: int
    bytes_after: int


def convert_regions(
    source: str | Path,
    target: str | Path,
    layout: Layout | None = None,
    bits: int = 16,
    embedding_model: str | None = None,
    overwrite: bool = False,
    progress: Progress = no_progress,
) -> ConvertReport:
    """Write the region features of a folder in the other layout, into another folder.

    Labels are kept exactly, the level "default" included. From LangSplat's layout with ``bits`` = 32 and back gives
    the same numbers; with 16 embeddings are rounded to float16. Back from the compact layout float16 numbers become
    float32 without loss.

    Args:
        source: the features, or a scene folder with ``language_features`` in it.
        target: another folder; views there that are not in the source stay.
        layout: of the target; the other one if None.
        bits: of a stored embedding number in the compact layout, 16 or 32.
        embedding_model: id of the model that made the embeddings, where the source does not tell.
        overwrite: replace views that are there already.

    Raises:
        MissingFileError: there is no such folder, or it has no region features.
        FileFormatError: a file is damaged.
        InputError: the target is the source, or holds features of another layout.
        OutputExistsError: a view is there already and ``overwrite`` is false; nothing is written then.
    """
    source = existing_folder(source, "a folder of region features", "check the path")
    if (source / FOLDER_NAME).is_dir():
        source = source / FOLDER_NAME
    target = Path(target)
    if target.exists() and target.resolve() == source.resolve():
        raise InputError(f"{target}: source and target are one folder; give another target")
    if bits not in (16, 32):
        raise InputError(f"embeddings are stored with 16 or 32 bits, not {bits}")
    before = read_manifest(source)
    from_layout: Layout = before.layout if before is not None else "langsplat"
    to_layout: Layout = layout or ("langsplat" if from_layout == "compact" else "compact")
    stems = _stems(source, from_layout, before)
    model = embedding_model or (before.embedding_model if before else "")
    settings = {} if before is None else dict(before.settings)
    settings |= {"converted_from": from_layout}
    if to_layout == "compact":
        settings["bits"] = bits
    manifest = RegionManifest(to_layout, model, settings)
    _check_target(target, manifest, stems, overwrite)
    sizes = [0, 0]
    progress("convert", 0, len(stems))
    for done, stem in enumerate(stems):
        view = _read(source, stem, from_layout)
        sizes[0] += sum(path.stat().st_size for path in _files(source, stem, from_layout))
        name = view.name or stem
        if to_layout == "langsplat":
            write_langsplat_view(target / stem, view.labels, view.embeddings, overwrite)
        else:
            kind = np.float16 if bits == 16 else np.float32
            rows = {level: item.astype(kind) for level, item in view.embeddings.items()}
            fingerprint = manifest.fingerprint
            path = target / f"{stem}{ENDING}"
            write_compact_view(path, name, view.labels, rows, fingerprint, view.photograph, overwrite)
        sizes[1] += sum(path.stat().st_size for path in _files(target, stem, to_layout))
        progress("convert", done + 1, len(stems))
    return ConvertReport(source, target, to_layout, len(stems), sizes[0], sizes[1])


@dataclass(frozen=True, eq=False)
class _View:
    name: str
    photograph: str
    labels: dict[str, NDArray[np.int32]]
    embeddings: dict[str, NDArray[np.floating]]


def _stems(source: Path, layout: Layout, manifest: RegionManifest | None) -> list[str]:
    """The stems of the views that count."""
    if layout == "langsplat":
        stems = [path.name.removesuffix("_s.npy") for path in view_files(source, "_s.npy")]
    else:
        fingerprint = manifest.fingerprint if manifest else ""
        views: list[CompactView] = [read_compact_view(path) for path in view_files(source, ENDING)]
        stems = [v.path.name.removesuffix(ENDING) for v in views if v.manifest == fingerprint]
    if not stems:
        raise MissingFileError(
            source, "holds no region features", "give a folder with *_s.npy or *.regions files"
        )
    return stems


def _files(folder: Path, stem: str, layout: Layout) -> list[Path]:
    endings = ("_s.npy", "_f.npy") if layout == "langsplat" else (ENDING,)
    return [folder / f"{stem}{ending}" for ending in endings]


def _check_target(target: Path, manifest: RegionManifest, stems: list[str], overwrite: bool) -> None:
    """Refuse what would be mixed up or replaced, and write the manifest, before any view is."""
    from scoup.base.atomic import check_output

    there = read_manifest(target) if target.is_dir() else None
    if there is not None and there != manifest and not overwrite:
        listed = "; ".join(manifest.differences(there))
        raise InputError(
            f"{target}: holds other region features ({listed}); choose another folder, or pass --overwrite"
        )
    other: Layout = "compact" if manifest.layout == "langsplat" else "langsplat"
    foreign = view_files(target, ENDING if other == "compact" else "_s.npy")
    if foreign:
        raise InputError(
            f"{target}: holds features of the layout {other} ({foreign[0].name}); choose another folder"
        )
    for stem in stems:
        for path in _files(target, stem, manifest.layout):
            check_output(path, overwrite)
    check_output(target / MANIFEST, overwrite=True)
    if there != manifest:
        write_manifest(target, manifest, overwrite)


def _read(source: Path, stem: str, layout: Layout) -> _View:
    if layout == "compact":
        view = read_compact_view(source / f"{stem}{ENDING}")
        labels = {level: read_compact_labels(view, level) for level in view.levels}
        rows = {level: read_compact_embeddings(view, level) for level in view.levels}
        return _View(view.name, view.photograph, labels, rows)
    path, planes, table = open_langsplat_view(source / stem)
    blocks = level_blocks(path, planes, len(table))
    labels, rows = {}, {}
    for number, level in enumerate(FILE_LEVELS):
        block = blocks[level]
        if level == "default" and block.start == block.stop:
            continue
        plane = np.array(planes[number], dtype=np.int32)
        labels[level] = np.where(plane >= 0, plane - block.start, -1).astype(np.int32)
        rows[level] = np.array(table[block])
    return _View("", "", labels, rows)
