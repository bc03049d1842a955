"""From a path of any kind to Gaussians and cameras."""

from __future__ import annotations

import os
import warnings
from pathlib import Path
from typing import Literal

import numpy as np

from scoup.base.arguments import PATH, check_arguments
from scoup.base.counts import counted, listed
from scoup.base.errors import FileFormatError, InputError, MissingFileError, ScoupWarning
from scoup.io.camera_images import MissingImages, attach_images, image_files
from scoup.io.camera_sources import CameraSource, find_cameras
from scoup.io.cameras.colmap import read_colmap
from scoup.io.cameras.gsplat_frame import in_gsplat_frame
from scoup.io.cameras.inria import latest_point_cloud, read_inria_cameras
from scoup.io.cameras.nerfstudio import read_transforms
from scoup.io.cameras.trained_frame import in_trained_frame
from scoup.io.cameras.training_run import GSPLAT_CONFIG, is_gsplat_results, is_nerfstudio_run
from scoup.io.reading import Distorted
from scoup.io.splats.axes import AXES, turned
from scoup.io.splats.formats import READERS, WRITERS, check_splat_name, written_suffix
from scoup.io.splats.gsplat_checkpoint import exported_splat, read_gsplat_checkpoint
from scoup.io.splats.nerfstudio_checkpoint import is_splatfacto_name, read_splatfacto, splat_of_run
from scoup.io.splats.other_formats import READ, other_format
from scoup.scene.cameras import Cameras
from scoup.scene.gaussians import Gaussians

_CHECKPOINTS = (".pt", ".pth", ".ckpt")
_IN_FOLDERS = tuple(name for name in READERS if name not in (".glb", ".gltf"))  # which may hold meshes


def load_gaussians(path: str | Path, keep_axes: bool = False) -> Gaussians:
    """Load a trained splat, on the CPU.

    Args:
        path: a PLY of 3D Gaussian Splatting (also PlayCanvas's compressed one), a .splat, .spz, .glb, .gltf, .ksplat
            or .sog file; a gsplat checkpoint (.pt) or its ``ckpts`` folder; the output folder of a training by
            nerfstudio (splatfacto), by gsplat or by Inria's code (the last step is taken); or a folder with one such
            file.
        keep_axes: do not turn .spz and glTF, which name their axes, to those of 3DGS (docs/formats.md).

    Raises:
        MissingFileError: there is nothing of the kind.
        FileFormatError: the file is damaged or of a kind not supported.

    Warns:
        ScoupWarning: rows were dropped because they are not finite, or the file is longer than it says.

    Example:
        >>> gaussians = scoup.load_gaussians("scene/point_cloud.ply")
        >>> gaussians.means.shape[1], gaussians.quats.shape[1]
        (3, 4)
    """
    check_arguments("load_gaussians", path=(path, PATH))
    path = find_gaussians(path)
    if is_splatfacto_name(path):
        gaussians = read_splatfacto(path)
    elif path.is_dir() or path.suffix.lower() in _CHECKPOINTS:
        gaussians = read_gsplat_checkpoint(path)
    else:
        gaussians = READERS[path.suffix.lower()](path)
    if not len(gaussians):
        raise FileFormatError(path, "contains no Gaussians with finite values", "export the splat again")
    return _in_axes(gaussians, path, keep_axes)


def _in_axes(gaussians: Gaussians, path: str | Path, keep_axes: bool) -> Gaussians:
    """Undo the half-turn that the reader of a format has made, or that its writer will make."""
    axis = AXES.get(Path(path).suffix.lower())
    return turned(gaussians, axis) if keep_axes and axis is not None else gaussians


def save_gaussians(
    gaussians: Gaussians, path: str | Path, overwrite: bool = False, keep_axes: bool = False
) -> None:
    """Write a splat in the format of the suffix: .ply (Inria's layout), .compressed.ply (PlayCanvas), .splat, .spz,
    .glb, .gltf, .ksplat, .sog, or OpenUSD's .usd, .usda, .usdc, .usdz. All but .ply round values (docs/formats.md).

    Args:
        keep_axes: as ``load_gaussians``.

    Raises:
        InputError: another suffix, or values that the format has no place for.
        OutputExistsError: the file exists and ``overwrite`` is false.
        ScoupError: the format needs a package that is not there.

    Example:
        >>> gaussians = scoup.load_gaussians("scene/point_cloud.ply")
        >>> scoup.save_gaussians(gaussians.select(gaussians.opacities > 0.5), "opaque.ply")
    """
    check_arguments("save_gaussians", gaussians=(gaussians, Gaussians), path=(path, PATH))
    check_splat_name(path)
    WRITERS[written_suffix(path)](_in_axes(gaussians, path, keep_axes), path, overwrite)


def default_preset(path: str | Path) -> Literal["inria", "gsplat"]:
    """Return the rasteriser preset of a splat: "gsplat" for checkpoints of its trainer, otherwise "inria"."""
    folder = Path(path)
    if is_nerfstudio_run(folder) or is_gsplat_results(folder):
        return "gsplat"
    path = find_gaussians(path)
    return "gsplat" if path.is_dir() or path.suffix.lower() in _CHECKPOINTS else "inria"


def is_splat_name(path: Path) -> bool:
    """Return whether the name of a file is that of a splat."""
    return path.suffix.lower() in (*READERS, *_CHECKPOINTS)


def find_gaussians(path: str | Path) -> Path:
    """Return the file (or folder of checkpoints) that ``load_gaussians`` reads for ``path``."""
    path = Path(path)
    if os.path.isfile(path):
        if not is_splat_name(path):
            raise FileFormatError(
                path, *(other_format(path) or ("is not a kind of splat known here", f"use {READ}"))
            )
        return path
    if not os.path.isdir(path):
        raise MissingFileError.of(path, "a trained splat", kind="file or folder")
    if path.name == "point_cloud" or (path / "point_cloud").is_dir():
        return latest_point_cloud(path)
    if is_nerfstudio_run(path):
        return splat_of_run(path)
    if is_gsplat_results(path) and not any((path / "ckpts").glob("*.pt")):
        return exported_splat(path)
    if (path / "ckpts").is_dir() or any(path.glob("ckpt_*_rank*.pt")):
        return path
    # Inria's code copies the sparse points beside its cameras as input.ply.
    found = [
        item
        for item in sorted(path.iterdir())
        if item.suffix.lower() in _IN_FOLDERS and item.is_file() and item.name != "input.ply"
    ]
    if len(found) != 1:
        names = listed([item.name for item in found], 5)
        problem = f"contains {len(found)} splats ({names})" if found else "contains no trained splat"
        raise MissingFileError(path, problem, "name the file of the splat itself")
    return found[0]


def load_cameras(
    path: str | Path,
    images: str | Path | None = None,
    downscale: Literal[1, 2, 4, 8] | None = None,
    distorted: Distorted = "refuse",
    missing_images: MissingImages = "skip",
    dataparser_transforms: str | Path | None = None,
) -> Cameras:
    """Load the cameras of a scene, sorted by name, at the size of the images found for them.

    Args:
        path: a scene folder as COLMAP, nerfstudio or Inria's code leave it, or a transforms.json,
            cameras.json or COLMAP model folder itself; or the output folder of a training by nerfstudio or gsplat,
            whose data are then found, and the cameras brought to the frame of the splat.
        images: the folder with the photographs; by default ``images``, else ``images_2``, ``_4``, ``_8``.
        downscale: take the images (and cameras) at 1/downscale of full size, from ``images_<downscale>``
            if there is one. Intrinsics always follow the image size.
        distorted: "refuse" cameras with lens distortion, or "undistort": they carry their coefficients, and
            images and region maps are undistorted when they are read.
        missing_images: "skip" cameras whose image is missing where others have one, or "keep" them without.
        dataparser_transforms: bring the cameras to the frame of a splat that nerfstudio trained, by the file of that
            name in its output.

    Raises:
        MissingFileError: there are no cameras, or ``images`` is not there or has none of their images.
        FileFormatError: a file of cameras is damaged, an image has another shape than its camera, or see
            ``distorted``.

    Warns:
        ScoupWarning: cameras were skipped because their image is missing or cannot be read, no image was found at all
            and the cameras stand alone, or there are other models of COLMAP.

    Example:
        >>> len(scoup.load_cameras("scene"))
        4
    """
    check_arguments("load_cameras", path=(path, PATH))
    if downscale not in (None, 1, 2, 4, 8):
        raise InputError(f"downscale is {downscale}, expected 1, 2, 4 or 8")
    if distorted not in ("refuse", "undistort"):
        raise InputError(f"distorted is {distorted!r}, expected 'refuse' or 'undistort'")
    if missing_images not in ("skip", "keep"):
        raise InputError(f"missing_images is {missing_images!r}, expected 'skip' or 'keep'")
    source = find_cameras(path)
    if source.others:
        others = ", ".join(str(other) for other in source.others)
        warnings.warn(
            f"{source.path}: used, and {counted(len(source.others), 'other COLMAP model')} not; to use another, pass "
            f"its folder ({others})",
            ScoupWarning,
            stacklevel=2,
        )
    cameras = _read(source, distorted)
    frame = source.frame if dataparser_transforms is None else Path(dataparser_transforms)
    if frame is not None and frame.name == GSPLAT_CONFIG:
        cameras = in_gsplat_frame(cameras, source.path, _means_of(frame.parent))
    elif frame is not None:
        transforms = source.path if source.format == "nerfstudio" else None
        cameras = in_trained_frame(cameras, frame, transforms)
    return attach_images(cameras, source.path, source.roots, images, downscale, missing_images)


def _means_of(results: Path) -> np.ndarray | None:
    """Return [N, 3] finite means of the splat in a folder of results; None where there is none."""
    try:
        return load_gaussians(results).means.double().numpy()
    except InputError:  # the cameras may be all that is needed
        return None


def camera_photographs(path: str | Path, images: str | Path | None = None) -> list[tuple[str, Path]]:
    """Return names of a scene's cameras and their photographs, where there are any; the photographs are not opened.

    Args:
        path, images: as in ``load_cameras``.
    """
    source = find_cameras(path)
    return image_files(_read(source, "undistort"), source.roots, images)


def _read(source: CameraSource, distorted: Distorted) -> Cameras:
    if source.format == "colmap":
        return read_colmap(source.path, distorted)
    if source.format == "nerfstudio":
        return read_transforms(source.path, distorted)
    return read_inria_cameras(source.path)
