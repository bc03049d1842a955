"""A folder of region features: views in SCOUP's compact layout, with a manifest, or in LangSplat's, which is read only.
Everything that reads or writes such a folder goes through it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from scoup.base import InputError, ScoupError, check_output, listed, staged
from scoup.io.reading import existing_folder
from scoup.io.regions import compact, langsplat
from scoup.io.regions.compact import CompactView
from scoup.io.regions.langsplat import LangSplatView
from scoup.io.regions.manifest import MANIFEST, RegionManifest, write_manifest
from scoup.io.regions.views import FEATURES_FOLDER, ViewRegions, match_stems, view_stems

Layout = Literal["compact", "langsplat"]
StoredView = CompactView | LangSplatView  # with the same names for the same things, as their modules
_LAYOUTS = {"compact": compact, "langsplat": langsplat}


@dataclass(frozen=True)
class RegionStore:
    """A folder of region features. Views are complete or not there."""

    folder: Path  # of the features themselves
    manifest: RegionManifest | None = None  # how they were made; None for features of other programs
    layout: Layout = "compact"  # of the files

    @classmethod
    def open(cls, folder: str | Path) -> RegionStore:
        """Return the store in a folder of region features, or in a scene folder with ``language_features`` in it."""
        path = existing_folder(folder, "a folder of region features", "make them first, or check the path")
        path = path / FEATURES_FOLDER if (path / FEATURES_FOLDER).is_dir() else path
        manifest = RegionManifest.read(path)
        if manifest is not None:
            return cls(path, manifest)
        others = view_stems(path, langsplat.ENDINGS[0])
        return cls(
            path, None, "compact" if not others and view_stems(path, compact.ENDINGS[0]) else "langsplat"
        )

    @classmethod
    def create(cls, folder: Path, manifest: RegionManifest, overwrite: bool = False) -> RegionStore:
        """Return the store of a manifest, to ``begin``, which makes the folder, and write to; a folder with the same
        manifest is continued. With ``overwrite`` another manifest may be there, which ``begin`` replaces."""
        if folder.is_file():
            raise InputError(f"{folder}: is a file; use the name of a folder")
        there = RegionManifest.read(folder) if folder.is_dir() else None
        if there is None:
            endings = [layout.ENDINGS[0] for layout in _LAYOUTS.values()]
            foreign = [stem + ending for ending in endings for stem in view_stems(folder, ending)]
            if foreign:
                raise InputError(
                    f"{folder}: contains region features that were not made by scoup ({listed(foreign, 1)}); choose "
                    "another folder, or move them away"
                )
        elif there != manifest and not overwrite:
            differences = "; ".join(manifest.differences(there))
            raise InputError(
                f"{folder}: contains region features made with other settings ({differences}); use the same settings, "
                "choose another folder, or pass `overwrite=True` to make everything again"
            )
        check_output(folder / MANIFEST, overwrite=True)
        return cls(folder, manifest)

    def begin(self, overwrite: bool = False) -> None:
        """Put the manifest into the folder, before the first view is written; with ``overwrite`` in place of another
        one, whose views no longer count."""
        there, manifest = RegionManifest.read(self.folder), self.manifest
        if manifest is not None and (there is None or there != manifest or there.views != manifest.views):
            write_manifest(self.folder, manifest, overwrite or there == manifest)

    @property
    def endings(self) -> tuple[str, ...]:
        return _LAYOUTS[self.layout].ENDINGS

    @property
    def fingerprint(self) -> str:
        return "" if self.manifest is None else self.manifest.fingerprint

    def files(self, stem: str) -> list[Path]:
        """Return the files of a view, whether they are there or not; labels first."""
        return [self.folder / f"{stem}{ending}" for ending in self.endings]

    def stem_of(self, name: str) -> str:
        return _LAYOUTS[self.layout].stem_of(name)

    def check_names(self, names: Iterable[str]) -> None:
        """Refuse two images whose files would have one name."""
        by_stem: dict[str, str] = {}
        for name in names:
            other = by_stem.setdefault(self.stem_of(name), name)
            if other != name:
                remedy = "rename one of them"
                if self.layout == "langsplat":
                    remedy = (
                        "LangSplat's files have no folders, and names cut at the first dot; make the features with "
                        "scoup extract"
                    )
                raise InputError(
                    f"{self.folder}: images {other!r} and {name!r} share the feature name {self.stem_of(name)!r}; "
                    f"{remedy}"
                )

    def all_stems(self) -> list[str]:
        """Return the stems of all views, whatever manifest they were made under."""
        return view_stems(self.folder, self.endings[0], below=self.manifest is not None)

    def stems(self) -> list[str]:
        """Return the stems of the views that count: not those made under an abandoned manifest."""
        stems = self.all_stems()
        if self.manifest is None:
            return stems
        return [stem for stem in stems if self._counts(self.open_view(stem))]

    def open_view(self, stem: str) -> StoredView:
        """Return a view, whatever manifest it was made under."""
        return _LAYOUTS[self.layout].open_view(self.folder, stem)

    def view(self, stem: str) -> StoredView | None:
        """Return a view that counts; None if there is none."""
        if not all(path.is_file() for path in self.files(stem)):
            return None
        view = self.open_view(stem)
        return view if self._counts(view) else None

    def views(self, names: Iterable[str]) -> dict[str, StoredView]:
        """Return the views that count, by the names of their images; images without a view are left out."""
        stems = {name: self.stem_of(name) for name in names}
        self.check_names(stems)
        views = {name: self.view(stem) for name, stem in stems.items()}
        if None in views.values():
            there = {stem for name, stem in stems.items() if views[name] is not None}
            others = match_stems(set(stems.values()) - there, set(self.all_stems()) - there)
            views |= {name: self.view(others[stem]) for name, stem in stems.items() if stem in others}
        return {name: view for name, view in views.items() if view is not None}

    def _counts(self, view: StoredView) -> bool:
        return self.manifest is None or view.manifest == self.fingerprint

    def has(self, name: str, photograph: str) -> bool:
        """Return whether the view was made under this manifest from this photograph (its SHA-256)."""
        try:
            view = self.open_view(self.stem_of(name))
        except ScoupError:  # not there, or damaged: made again
            return False
        return (view.manifest, view.photograph) == (self.fingerprint, photograph)

    def write(self, regions: ViewRegions, stem: str | None = None, overwrite: bool = False) -> int:
        """Write a view, and return the bytes of its files; ``stem`` is by default that of the view's name."""
        stem = self.stem_of(regions.name) if stem is None else stem
        kind = np.float16 if self.manifest is None or self.manifest.bits == 16 else np.float32
        rows = {level: item.astype(kind) for level, item in regions.embeddings.items()}
        regions = replace(regions, embeddings=rows)
        compact.write_view(self.folder, stem, regions, self.fingerprint, overwrite)
        return self.size_of(stem)

    def size_of(self, stem: str) -> int:
        return sum(path.stat().st_size for path in self.files(stem))


@contextmanager
def staged_store(
    folder: Path, manifest: RegionManifest, stems: Iterable[str], overwrite: bool
) -> Iterator[RegionStore]:
    """Yield a store whose views, with these stems, appear in ``folder`` together once all are written."""
    store = RegionStore.create(folder, manifest, overwrite)
    manifest_file = [MANIFEST]
    if RegionManifest.read(folder) == manifest:
        check_output(*(path for stem in stems for path in store.files(stem)), overwrite=overwrite)
        manifest_file = []
    with staged(folder, manifest_file, overwrite) as hidden:
        if manifest_file:
            write_manifest(hidden, manifest)
        yield RegionStore(hidden, manifest)


def read_view(view: StoredView) -> ViewRegions:
    """Return everything the files of a view hold; a level "default" without regions is left out."""
    rows = {level: np.array(view.embeddings(level)) for level in view.levels}
    levels = [level for level in view.levels if level != "default" or len(rows[level])]
    labels = dict(zip(levels, view.labels(levels), strict=True))
    return ViewRegions(view.name, labels, {level: rows[level] for level in levels}, view.photograph)
