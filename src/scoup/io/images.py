"""Photographs in, pictures out."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from scoup.base.atomic import atomic_file
from scoup.base.errors import FileFormatError, InputError, MissingFileError
from scoup.io.cameras.undistort import photograph_pixels, sample_bilinear
from scoup.io.image_folder import image_size
from scoup.scene.cameras import Camera

MAX_PIXELS = 1 << 29  # decoded at three bytes each


def load_image(camera: Camera) -> Tensor:
    """The photograph of a camera at the camera's size, undistorted where the camera says so.

    EXIF orientation is not applied: COLMAP ignores it too, so poses belong to the pixels as they are stored.
    Transparency is dropped.

    Returns:
        [H, W, 3] uint8 RGB.

    Raises:
        MissingFileError: the camera has no image, or it is gone.
        FileFormatError: the file is no image or is damaged.
    """
    if camera.image_path is None:
        raise MissingFileError(
            camera.name, "this camera has no image on disk", "load the cameras with images=FOLDER"
        )
    pixels = _decode(camera.image_path, camera.width, camera.height)
    image = torch.from_numpy(pixels)
    if not camera.distortion:
        return image
    return sample_bilinear(image, photograph_pixels(camera, image.shape[1], image.shape[0]))


def save_png(image: Tensor | np.ndarray, path: str | Path, overwrite: bool = False) -> None:
    """Write a PNG: [H, W, 3] or [H, W, 4] uint8 colour, [H, W] uint8 grey, or [H, W] bool (true is white).

    Raises:
        InputError: another shape or dtype.
        OutputExistsError: as ``atomic.check_output``.
    """
    from PIL import Image

    array = image.detach().cpu().numpy() if isinstance(image, Tensor) else np.asarray(image)
    if array.dtype == np.bool_:
        array = array.astype(np.uint8) * 255
    grey = array.ndim == 2
    if (
        array.dtype != np.uint8
        or not (grey or (array.ndim == 3 and array.shape[2] in (3, 4)))
        or not array.size
    ):
        raise InputError(
            f"{path}: a picture is uint8 [H, W, 3 or 4] or [H, W], not {array.dtype} {list(array.shape)}"
        )
    with atomic_file(path, overwrite) as stream:
        Image.fromarray(np.ascontiguousarray(array)).save(stream, format="PNG")


def _decode(path: Path, width: int, height: int) -> np.ndarray:
    from PIL import Image

    stored = image_size(path)
    if stored[0] * stored[1] > MAX_PIXELS:
        raise FileFormatError(
            path, f"has {stored[0]} x {stored[1]} pixels, too many to decode", "scale it down first"
        )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with Image.open(path) as image:
                image.draft("RGB", (width, height))  # lets JPEG skip detail that would be thrown away
                rgb = image.convert("RGB")
                if rgb.size != (width, height):
                    rgb = rgb.resize((width, height), Image.Resampling.BICUBIC)
                return np.array(rgb)
    except Exception as error:  # damaged images raise nearly everything inside Pillow
        raise FileFormatError(path, f"cannot be decoded ({error})", "copy it again, or remove it") from error
