"""Views in a folder of region features: their names, and what every layout of the files gives and takes."""

from __future__ import annotations

import unicodedata
from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

FOLDER_NAME = "language_features"
REMEDY = "extract the features again"


@dataclass(frozen=True, eq=False)
class ViewRegions:
    """The regions of one view in memory, in the orientation of the stored photograph."""

    name: str  # of the image; "" where a layout does not keep it
    # level -> [H, W] int32 rows of that level's embeddings, -1 for none; one size for all levels
    labels: dict[str, NDArray[np.int32]]
    embeddings: dict[str, NDArray[np.floating]]  # level -> [R, D] floating point
    photograph: str = ""  # SHA-256 of the photograph's file; "" if it is not known

    def __len__(self) -> int:
        return sum(len(rows) for rows in self.embeddings.values())


class StoredView(Protocol):
    """A view in a folder. Its headers are checked, its arrays are read when they are needed.

    Attributes:
        name: of the image; the stem of the files where the layout does not keep the name.
        levels: stored, in order.
        width, height: of the label maps.
        dim: D of the embeddings.
        counts: level -> number of regions; one entry "all" where the headers do not tell the levels apart.
        manifest: fingerprint of the manifest it was made under; None where the view does not tell.
        photograph: SHA-256 of the photograph's file; "" where the view does not tell.
        labels_path, embeddings_path: of the files, for messages.
    """

    @property
    def name(self) -> str: ...
    @property
    def levels(self) -> tuple[str, ...]: ...
    @property
    def width(self) -> int: ...
    @property
    def height(self) -> int: ...
    @property
    def dim(self) -> int: ...
    @property
    def counts(self) -> dict[str, int]: ...
    @property
    def manifest(self) -> str | None: ...
    @property
    def photograph(self) -> str: ...
    @property
    def labels_path(self) -> Path: ...
    @property
    def embeddings_path(self) -> Path: ...

    def labels(self, levels: Sequence[str]) -> NDArray[np.int32]:
        """Return [levels, H, W] labels as stored: rows of each level's own embeddings, or -1."""
        ...

    def embeddings(self, level: str) -> NDArray[np.floating]:
        """Return [R, D] embeddings of a level, as stored."""
        ...

    def read(self) -> ViewRegions:
        """Return everything the view holds."""
        ...


class RegionLayout(Protocol):
    """A layout of views in files; the modules ``compact`` and ``langsplat`` are two."""

    @property
    def ENDINGS(self) -> tuple[str, ...]:
        """Endings of the files of a view, labels first; all of them must be there."""
        ...

    def stem_of(self, name: str) -> str:
        """Return the stem of an image's files, with folders where the layout has them."""
        ...

    def open_view(self, folder: Path, stem: str) -> StoredView:
        """Return a view whose files are there."""
        ...

    def write_view(
        self, folder: Path, stem: str, regions: ViewRegions, manifest: str, overwrite: bool = False
    ) -> None:
        """Write a view atomically.

        Args:
            manifest: fingerprint of the folder's manifest, "" if there is none.
        """
        ...


def region_folder(path: Path) -> Path:
    """Return the folder of region features of a scene folder; ``path`` itself where it is none."""
    return path / FOLDER_NAME if (path / FOLDER_NAME).is_dir() else path


def view_stems(folder: Path, ending: str, below: bool = False) -> list[str]:
    """Return the stems of the files with that ending, in order, without the hidden ones that a killed process leaves.

    Args:
        below: also those in sub-folders, with their paths.
    """
    paths = (path.relative_to(folder) for path in folder.glob(f"{'**/' * below}*{ending}"))
    return sorted(
        path.as_posix().removesuffix(ending)
        for path in paths
        if not any(part.startswith(".") for part in path.parts)
    )


def match_stems(wanted: Iterable[str], there: Iterable[str]) -> dict[str, str]:
    """Return stems of files by the stems of images that have no file of their own, and which can only mean these.

    They are in another Unicode form, or one of both has no folders (as LangSplat's) or is cut at its first dot.
    """
    exact: dict[str, list[str]] = defaultdict(list)
    cut: dict[str, list[str]] = defaultdict(list)
    for stem in there:
        exact[unicodedata.normalize("NFC", stem)].append(stem)
        cut[_parts(stem)[2]].append(stem)
    found = {}
    for each in wanted:
        same = exact.get(unicodedata.normalize("NFC", each))
        stems = same or [stem for stem in cut.get(_parts(each)[2], []) if _may_mean(each, stem)]
        if len(stems) == 1:
            found[each] = stems[0]
    claims = Counter(found.values())
    return {each: stem for each, stem in found.items() if claims[stem] == 1}


def _parts(stem: str) -> tuple[str, str, str]:
    """Return the folder, the name in it, and this cut at its first dot."""
    folder, _, last = unicodedata.normalize("NFC", stem).rpartition("/")
    return folder, last, last.partition(".")[0]


def _may_mean(one: str, other: str) -> bool:
    (folder, last, cut), (other_folder, other_last, _) = _parts(one), _parts(other)
    return not (folder and other_folder) and (last == other_last or cut in (last, other_last))
