"""Where extracted regions go: a folder with a manifest, a view at a time, so that work can stop and go on."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scoup.base.atomic import check_output, write_text
from scoup.base.errors import InputError, ScoupError
from scoup.io.reading import read_json
from scoup.io.regions.compact import ENDING, read_compact_view, write_compact_view
from scoup.io.regions.langsplat import write_langsplat_view
from scoup.io.regions.manifest import MANIFEST, RegionManifest, read_manifest, write_manifest
from scoup.io.regions.views import stem_of, view_files

_RECORD_ENDING = (
    "_made.json"  # LangSplat's layout: written after the two arrays, says what they were made from
)


@dataclass(frozen=True, eq=False)
class ViewRegions:
    """The regions of one view.

    Attributes:
        labels: level -> [H, W] int32 rows of that level's embeddings, -1 for none.
        embeddings: level -> [R, D] float32 unit rows.
    """

    labels: dict[str, NDArray[np.int32]]
    embeddings: dict[str, NDArray[np.float32]]

    def __len__(self) -> int:
        return sum(len(rows) for rows in self.embeddings.values())


class RegionStore:
    """A folder of region features made under one manifest. Views are complete or not there.

    Args:
        folder: made if it is missing.
        manifest: of this run.
        overwrite: make everything anew, whatever is there.
        bits: of a stored embedding number in the compact layout, 16 or 32.

    Raises:
        InputError: the folder holds something else, or was made with other settings; nothing has changed then.
    """

    def __init__(
        self, folder: Path, manifest: RegionManifest, overwrite: bool = False, bits: int = 16
    ) -> None:
        self.folder = folder
        self.manifest = manifest
        self.overwrite = overwrite
        self.bits = bits
        there = read_manifest(folder) if folder.is_dir() else None
        if there is None:
            _refuse_foreign(folder)
        elif there != manifest and not overwrite:
            listed = "; ".join(manifest.differences(there))
            raise InputError(
                f"{folder}: was made with other settings ({listed}); use the same, choose another folder with "
                "--out, or pass --overwrite to make everything anew"
            )
        check_output(folder / MANIFEST, overwrite=True)
        if there != manifest:
            write_manifest(folder, manifest, overwrite)

    def has(self, name: str, photograph: str) -> bool:
        """Whether the view was made under this manifest from this photograph (its SHA-256)."""
        try:
            if self.manifest.layout == "compact":
                view = read_compact_view(self._path(name, ENDING))
                return (view.manifest, view.photograph) == (self.manifest.fingerprint, photograph)
            record = read_json(self._path(name, _RECORD_ENDING), "a record of region features")
        except ScoupError:  # not there, or damaged: made anew
            return False
        arrays = all(self._path(name, end).is_file() for end in ("_s.npy", "_f.npy"))
        return arrays and record == self._record(name, photograph)

    def write(self, name: str, regions: ViewRegions, photograph: str) -> int:
        """Write a view, in place of an older one; returns its bytes."""
        if self.manifest.layout == "compact":
            kind = np.float16 if self.bits == 16 else np.float32
            rows = {level: item.astype(kind) for level, item in regions.embeddings.items()}
            return write_compact_view(
                self._path(name, ENDING),
                name,
                regions.labels,
                rows,
                self.manifest.fingerprint,
                photograph,
                overwrite=True,
            )
        record = self._path(name, _RECORD_ENDING)
        record.unlink(missing_ok=True)  # from here the pair does not count until it is complete
        stem = self.folder / stem_of(name)
        written = write_langsplat_view(stem, regions.labels, regions.embeddings, overwrite=True)
        write_text(record, json.dumps(self._record(name, photograph), indent=2, sort_keys=True) + "\n")
        return written

    def _record(self, name: str, photograph: str) -> dict[str, str]:
        return {"view": name, "manifest": self.manifest.fingerprint, "photograph": photograph}

    def _path(self, name: str, ending: str) -> Path:
        return self.folder / f"{stem_of(name)}{ending}"


def _refuse_foreign(folder: Path) -> None:
    """Refuse a folder with features that were made by something else: they would be mixed up."""
    if folder.is_file():
        raise InputError(f"{folder}: is a file; give the name of a folder with --out")
    if not folder.is_dir():
        return
    foreign = [path.name for end in ("_s.npy", ENDING) for path in view_files(folder, end)]
    if foreign:
        raise InputError(
            f"{folder}: holds region features that were not made by scoup extract ({foreign[0]} and "
            f"{len(foreign) - 1} more); choose another folder with --out, or move them away"
        )
