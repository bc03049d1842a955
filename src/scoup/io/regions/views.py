"""What readers of region features share: which view belongs to which camera, sizes, unit rows."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from scoup.base.errors import FileFormatError, InputError, MissingFileError, ScoupWarning
from scoup.io.cameras.undistort import photograph_pixels, sample_nearest
from scoup.scene.cameras import Camera
from scoup.scene.regions import resize_labels

FOLDER_NAME = "language_features"
ASPECT_TOLERANCE = 0.02  # LangSplat truncates sizes; more is another image
REMEDY = "extract the features again"


def stem_of(name: str) -> str:
    """An image name without folders, cut at its first dot: the stem of region files."""
    return Path(name).name.split(".", 1)[0]


def view_files(folder: Path, ending: str) -> list[Path]:
    """The files of a folder with that ending, in order; not the hidden ones that a killed process left behind."""
    return sorted(path for path in folder.glob(f"*{ending}") if not path.name.startswith("."))


def check_stems(folder: Path, names: Iterable[str]) -> None:
    """Refuse two images whose region files would have one name.

    Raises:
        InputError: there are such images.
    """
    by_stem: dict[str, str] = {}
    for name in names:
        other = by_stem.setdefault(stem_of(name), name)
        if other != name:
            raise InputError(
                f"{folder}: images {other!r} and {name!r} share the feature name {stem_of(name)!r}"
                " (names are cut at the first dot); rename one of them"
            )


def warn_of_missing(folder: Path, found: int, wanted: int) -> None:
    """Tell how many cameras are left out because they have no features."""
    if found < wanted:
        warnings.warn(
            f"{folder}: skipped {wanted - found} of {wanted} cameras that have no features",
            ScoupWarning,
            stacklevel=4,
        )


def refuse_without_features(
    folder: Path, cameras: Sequence[Camera], endings: tuple[str, ...], there: list[str]
) -> None:
    """Raise a MissingFileError that tells which files were expected and which are there."""
    names = ", ".join(
        f"{camera.stem}{endings[0]}" + "".join(f" and {end}" for end in endings[1:]) for camera in cameras[:3]
    )
    expected = names + (", ..." if len(cameras) > 3 else "")
    listed = f"it has {', '.join(there[:3])}" if there else f"it has no *{endings[0]} files"
    raise MissingFileError(
        folder,
        f"has features of none of the {len(cameras)} cameras: expected {expected}; {listed}",
        "give the features of these images",
    )


def check_aspect(path: Path, width: int, height: int, camera: Camera) -> None:
    """Refuse labels of another shape than their image.

    Raises:
        FileFormatError: they are.
    """
    ratio = (width / height) / (camera.width / camera.height)
    if abs(ratio - 1.0) > ASPECT_TOLERANCE:
        raise FileFormatError(
            path,
            f"is {width} x {height}, of another shape than its image",
            "these are features of other images; give those of this scene",
        )


def at_camera(labels: Tensor, camera: Camera) -> Tensor:
    """Labels [..., H, W] of the photograph at the camera's size: nearest neighbour, undistorted where it says so."""
    if camera.distortion:
        pixels = photograph_pixels(camera, labels.shape[-1], labels.shape[-2])
        maps = labels.reshape(-1, *labels.shape[-2:])
        found = torch.stack([sample_nearest(item, pixels, outside=-1) for item in maps])
        return found.reshape(*labels.shape[:-2], *found.shape[-2:])
    return resize_labels(labels, camera.width, camera.height)


def unit_rows(path: Path, rows: np.ndarray) -> Tensor:
    """[R, D] float32 rows of unit norm.

    Raises:
        FileFormatError: a row is not finite.
    """
    with np.errstate(invalid="ignore"):  # a signalling NaN; refused below
        wide = np.asarray(rows, dtype=np.float64)
    if not np.isfinite(wide).all():
        raise FileFormatError(path, "has embeddings that are not finite (NaN or infinite)", REMEDY)
    norms = np.linalg.norm(wide, axis=1, keepdims=True)
    # Rows that are unit to float32 rounding stay bit for bit; a zero row means "unknown" and stays zero.
    unit = np.where(np.abs(norms - 1.0) < 1e-6, wide, wide / np.where(norms > 0, norms, 1.0))
    return torch.from_numpy(unit.astype(np.float32))
