"""From a path of any kind to Gaussians and cameras."""

from __future__ import annotations

import os
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from scoup.base import FileFormatError, InputError, ScoupWarning, check_arguments, counted
from scoup.io.camera_images import MissingImages, attach_images, image_files
from scoup.io.camera_sources import CAMERA_FORMATS, CameraSource, find_cameras
from scoup.io.cameras.colmap import model_images
from scoup.io.cameras.gsplat_frame import in_gsplat_frame
from scoup.io.cameras.nerfstudio import read_transforms
from scoup.io.cameras.trained_frame import in_trained_frame
from scoup.io.cameras.training_run import GSPLAT_CONFIG, trained_antialiased
from scoup.io.reading import Distorted
from scoup.io.splats.formats import splat_source, written_format
from scoup.scene import Cameras, Gaussians

_COARSE = 0.1  # step of float32 as a share of the median scale, beyond which positions are wrong


def load_gaussians(path: str | Path, keep_axes: bool = False, activated: bool = False) -> Gaussians:
    """Load a trained splat, on the CPU.

    Args:
        path: a file of any splat format that is read (docs/formats.md); the output folder of a training by nerfstudio
            (splatfacto), by gsplat or by Inria's code (the last step is taken); or a folder with one splat.
        keep_axes: do not turn formats that name their axes, such as .spz and glTF, to those of 3DGS.
        activated: of a PLY or checkpoint that holds scales and opacities as they are, not as logarithms and logits.

    Raises:
        MissingFileError: there is nothing of the kind.
        FileFormatError: the file is damaged or of a kind not supported, or so far from the origin that float32 cannot
            tell its Gaussians apart.

    Warns:
        ScoupWarning: rows were dropped because they are not finite, or the file is longer than it says.

    Example:
        >>> gaussians = scoup.load_gaussians("scene/point_cloud.ply")
        >>> gaussians.means.shape[1], gaussians.quats.shape[1]
        (3, 4)
    """
    check_arguments("load_gaussians", path=(path, Path))
    source = splat_source(path)
    assert source.kind.read is not None
    if activated and not source.kind.keeps_logs:
        raise InputError(
            f"{source.path}: `activated=True` is for PLY files and checkpoints; others hold no logarithms"
        )
    gaussians = source.kind.read(source.path, *([True] if activated else []))
    if not len(gaussians):
        raise FileFormatError(
            source.path, "contains no Gaussians with finite values", "export the splat again"
        )
    _check_precision(source.path, gaussians)
    trained = os.path.isdir(path) and trained_antialiased(Path(path))
    gaussians = replace(gaussians, antialiased=gaussians.antialiased or trained)
    return source.kind.turned(gaussians) if keep_axes else gaussians  # the half-turn of its reader, undone


def _check_precision(path: Path, gaussians: Gaussians) -> None:
    """Raise a FileFormatError if float32 is too coarse for the positions of most Gaussians."""
    largest = gaussians.means.abs().amax(1).median()
    step = float(np.spacing(largest.numpy()))
    scale = float(gaussians.scales.median())
    if step > _COARSE * scale > 0:
        middle = ", ".join(f"{-value:.0f}" for value in gaussians.means.median(0).values.tolist())
        raise FileFormatError(
            path,
            f"is too far from the origin: coordinates of {float(largest):,.0f} are exact to {step:.2g}, but its "
            f"Gaussians have a median scale of {scale:.2g}",
            f"move splat and cameras by one offset, for example ({middle}), before float32 rounds them",
        )


def save_gaussians(
    gaussians: Gaussians, path: str | Path, overwrite: bool = False, keep_axes: bool = False
) -> None:
    """Write a splat in the format that the ending of the name means: .ply (Inria's layout), .compressed.ply, .spz, .glb
    and more. All but .ply round values (docs/formats.md).

    Args:
        keep_axes: as ``load_gaussians``.

    Raises:
        InputError: another ending, or values that the format has no place for.
        OutputExistsError: the file exists and ``overwrite`` is false.
        ScoupError: the format needs a package that is not there.

    Example:
        >>> gaussians = scoup.load_gaussians("scene/point_cloud.ply")
        >>> scoup.save_gaussians(gaussians.select(gaussians.opacities > 0.5), "opaque.ply")
    """
    check_arguments("save_gaussians", gaussians=(gaussians, Gaussians), path=(path, Path))
    kind = written_format(path)
    assert kind.write is not None
    if gaussians.antialiased and not kind.keeps_antialiased:
        message = (
            f"{path}: this format cannot say that the splat was trained with antialiasing; .ply and .spz can"
        )
        warnings.warn(message, ScoupWarning, stacklevel=2)
    kind.write(kind.turned(gaussians) if keep_axes else gaussians, Path(path), overwrite)


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
            and the cameras stand alone, names of images leave the scene's folder, or there are other models of COLMAP.

    Example:
        >>> len(scoup.load_cameras("scene"))
        4
    """
    check_arguments("load_cameras", path=(path, Path))
    if downscale not in (None, 1, 2, 4, 8):
        raise InputError(f"downscale is {downscale}, expected 1, 2, 4 or 8")
    if distorted not in ("refuse", "undistort"):
        raise InputError(f"distorted is {distorted!r}, expected 'refuse' or 'undistort'")
    if missing_images not in ("skip", "keep"):
        raise InputError(f"missing_images is {missing_images!r}, expected 'skip' or 'keep'")
    source, cameras = _posed_cameras(path, distorted, dataparser_transforms)
    warn = missing_images == "skip"
    return attach_images(cameras, source.path, source.roots, images, downscale, missing_images, warn)


def all_cameras(path: str | Path) -> Cameras:
    """Return the cameras of a scene, those without an image too, with the warnings that ``load_cameras`` gives."""
    source, cameras = _posed_cameras(path, "undistort")
    return attach_images(cameras, source.path, source.roots, None, None, "keep", warn=True)


def _posed_cameras(
    path: str | Path, distorted: Distorted, dataparser_transforms: str | Path | None = None
) -> tuple[CameraSource, Cameras]:
    source = _one_source(path)
    if source.others:
        others = ", ".join(f"{other} ({len(model_images(other)):,})" for other in source.others)
        warnings.warn(
            f"{source.path}: used, with {counted(len(model_images(source.path)), 'image')}, and not {others}; to use "
            "another COLMAP model, pass its folder",
            ScoupWarning,
            stacklevel=2,
        )
    frame = source.frame if dataparser_transforms is None else Path(dataparser_transforms)
    cameras = _read(replace(source, frame=frame), distorted)
    if frame is not None and frame.name == GSPLAT_CONFIG:
        cameras = in_gsplat_frame(cameras, source.path, _means_of(frame.parent))
    elif frame is not None:
        transforms = source.path if source.format == "nerfstudio" else None
        cameras = in_trained_frame(cameras, frame, transforms)
    return source, cameras


def _one_source(path: str | Path) -> CameraSource:
    """Return the source of cameras; a FileFormatError where models of COLMAP have as many images."""
    source = find_cameras(path)
    if source.rivals:
        problem = (
            f"has as many images ({len(model_images(source.path)):,}) as {', '.join(map(str, source.rivals))}"
        )
        raise FileFormatError(
            source.path, problem, "pass the folder of the model in whose frame the splat is"
        )
    return source


def _means_of(results: Path) -> np.ndarray | None:
    """Return [N, 3] finite means of the splat in a folder of results; None where there is none."""
    try:
        return load_gaussians(results).means.double().numpy()
    except InputError:  # the cameras may be all that is needed
        return None


def camera_photographs(
    path: str | Path, images: str | Path | None = None
) -> tuple[list[tuple[str, Path, Path | None]], str]:
    """Return names of a scene's cameras, their photographs where there are any, and the masks of these; and what was
    looked for where there are none. Images of another shape than their cameras are refused, by their headers alone.
    Arguments as of ``load_cameras``."""
    source = _one_source(path)
    return image_files(_read(source, "undistort"), source.roots, images)


def _read(source: CameraSource, distorted: Distorted) -> Cameras:
    if source.format == "nerfstudio":
        return read_transforms(source.path, distorted, by_nerfstudio=source.frame is not None)
    return CAMERA_FORMATS[source.format].read(source.path, distorted)
