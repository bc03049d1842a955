"""The views of a folder of region features: their regions in memory, and the names of their files."""

from __future__ import annotations

import unicodedata
from collections import Counter, defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

FEATURES_FOLDER = "language_features"
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


def view_stems(folder: Path, ending: str, below: bool = False) -> list[str]:
    """Return the stems of the files with that ending, in order, without the hidden ones that a killed process leaves;
    with ``below`` also those in sub-folders, with their paths."""
    paths = (path.relative_to(folder) for path in folder.glob(f"{'**/' * below}*{ending}"))
    return sorted(
        path.as_posix().removesuffix(ending)
        for path in paths
        if not any(name.startswith(".") for name in path.parts)
    )


def match_stems(wanted: Iterable[str], there: Iterable[str]) -> dict[str, str]:
    """Return stems of files by the stems of images that have no file of their own, and which can only mean these:
    in another Unicode form, or one of both has no folders (as LangSplat's) or is cut at its first dot."""
    exact: dict[str, list[str]] = defaultdict(list)
    cut: dict[str, list[str]] = defaultdict(list)
    for stem in there:
        exact[unicodedata.normalize("NFC", stem)].append(stem)
        cut[_parts(stem)[2]].append(stem)
    matches = {}
    for image in wanted:
        same = exact.get(unicodedata.normalize("NFC", image))
        stems = same or [stem for stem in cut.get(_parts(image)[2], []) if _may_mean(image, stem)]
        if len(stems) == 1:
            matches[image] = stems[0]
    claims = Counter(matches.values())
    return {image: stem for image, stem in matches.items() if claims[stem] == 1}


def _parts(stem: str) -> tuple[str, str, str]:
    """Return the folder, the name in it, and this cut at its first dot."""
    folder, _, last = unicodedata.normalize("NFC", stem).rpartition("/")
    return folder, last, last.partition(".")[0]


def _may_mean(one: str, other: str) -> bool:
    (folder, last, cut), (other_folder, other_last, _) = _parts(one), _parts(other)
    return not (folder and other_folder) and (last == other_last or cut in (last, other_last))
