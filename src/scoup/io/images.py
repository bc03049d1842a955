"""One image file: its size, its pixels, and writing it."""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from scoup.base import FileFormatError, InputError, MissingFileError, atomic_file, existing_file
from scoup.io.cameras.undistort import photograph_pixels, sample_bilinear
from scoup.io.image_folder import conversion
from scoup.io.reading import MAX_IMAGE_PIXELS, MAX_IMAGE_SIDE, read_bytes
from scoup.scene import Camera

FORMATS = ("JPEG", "PNG", "WEBP", "BMP", "TIFF", "GIF", "PPM")  # some others start programs
ANY_PIXELS = 1 << 25  # that a file of any size may claim
PIXELS_A_BYTE = 1100  # of larger images; no photograph comes near, and deflate shrinks bytes by 1032 at most
_FOREIGN = {
    re.compile(rb"....ftypavi[fs]|....ftyp.{8,60}avif", re.S): "AVIF", re.compile(rb"....ftypcrx ", re.S): "CR3",
    re.compile(rb"....ftyp(hei|hev|mif|msf)", re.S): "HEIC", re.compile(rb"\xff\x0a|....JXL ", re.S): "JPEG XL",
    re.compile(rb"\xff\x4f\xff\x51|....jP  ", re.S): "JPEG 2000", re.compile(rb"v/1\x01"): "OpenEXR",
}  # fmt: skip
"""How photographs begin that are not read."""
_END_OF_PNG = b"\0\0\0\0IEND\xaeB`\x82"
_END_OF_JPEG = b"\xff\xd9"


def image_size(path: str | Path) -> tuple[int, int]:
    """Return width and height of an image file in pixels, from its header alone; EXIF orientation is not applied."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Pillow warns about every large photograph
        return size_in_header(path)


def size_in_header(path: str | Path) -> tuple[int, int]:
    """Return ``image_size`` with Pillow's warnings. For threads: filters of warnings belong to the process, and threads
    would restore those of each other."""
    from PIL import Image

    path = existing_file(path, "an image")
    try:
        with Image.open(path, formats=FORMATS) as image:
            width, height = image.size
    except Exception as error:  # damaged images raise nearly everything inside Pillow
        if isinstance(error, OSError) and error.errno is not None:
            raise FileFormatError.unreadable(path, error) from error
        problem, remedy = "is not an image that can be read", "copy it again, or remove it"
        with open(path, "rb") as stream:
            start = stream.read(64)
        if kind := next((kind for beginning, kind in _FOREIGN.items() if beginning.match(start)), ""):
            problem = f"is {kind}, which is not read"
            remedy = f"convert it and others like it: {conversion(path.with_name(f'*{path.suffix}'))}"
        raise FileFormatError(path, problem, remedy) from error
    if not (1 <= width <= MAX_IMAGE_SIDE and 1 <= height <= MAX_IMAGE_SIDE):
        raise FileFormatError(path, f"claims {width} x {height} pixels", "the file is damaged; copy it again")
    return width, height


def image_fault(path: Path) -> str:
    """Return why an image file cannot be decoded; "" where it can. Files that end as they should are not decoded."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            size_in_header(path)
            if not _is_whole(path):
                with open_image(path) as image:
                    image.load()
    except FileFormatError as error:
        return error.problem
    return ""


def _is_whole(path: Path) -> bool:
    """Return whether a file ends as a JPEG or PNG does; one that does not may be whole, too."""
    with open(path, "rb") as stream:
        stream.seek(max(0, path.stat().st_size - len(_END_OF_PNG)))
        end = stream.read()
    return end == _END_OF_PNG or end.endswith(_END_OF_JPEG)


def load_image(camera: Camera) -> Tensor:
    """Return the photograph of a camera at the camera's size, undistorted where the camera says so.

    EXIF orientation is not applied: COLMAP ignores it too, so poses belong to the pixels as they are stored.
    Transparency is dropped.

    Returns:
        [H, W, 3] uint8 RGB.

    Raises:
        MissingFileError: the camera has no image, or it is gone.
        FileFormatError: the file is not an image or is damaged.

    Example:
        >>> camera = scoup.load_cameras("scene")["view_00"]
        >>> scoup.load_image(camera).shape == (camera.height, camera.width, 3)
        True
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
    """Write a PNG: [H, W, 3] or [H, W, 4] uint8 colour, [H, W] uint8 grey, or [H, W] bool (true is white)."""
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


@contextmanager
def open_image(path: Path) -> Iterator[Any]:
    """Yield an image of Pillow; whatever fails in the block, decoding included, is a FileFormatError.

    Pillow's warnings are not silenced, for the reason that ``size_in_header`` gives.
    """
    from PIL import Image

    width, height = size_in_header(path)
    if width * height > MAX_IMAGE_PIXELS:
        raise FileFormatError(
            path, f"has {width} x {height} pixels, too many to decode", "scale it down first"
        )
    size = path.stat().st_size
    if width * height > max(ANY_PIXELS, PIXELS_A_BYTE * size):
        problem = f"claims {width} x {height} pixels, more than a photograph of {size:,} bytes can contain"
        raise FileFormatError(path, problem, "the file is damaged; copy it again")
    # Not from the file itself: where a chunk claims gigabytes, Pillow would ask the system for as many.
    data = io.BytesIO(read_bytes(path))
    try:
        with Image.open(data, formats=FORMATS) as image:
            yield image
    except Exception as error:  # damaged images raise nearly everything inside Pillow
        raise FileFormatError(path, f"cannot be decoded ({error})", "copy it again, or remove it") from error


def rgb_image(image: Any) -> Any:
    """Return an image of Pillow as 8-bit RGB: 16-bit values lose their lower byte, transparency is dropped.

    Grey integers of 32 bits that fit in 16 count as 16-bit values. Grey floats are in 0..1, 0..255 or 0..65535, by
    the largest one.

    Raises:
        ValueError: the values are in no such range.
    """
    from PIL import Image

    if image.mode.startswith("I") or image.mode == "F":
        values = np.asarray(image).astype(np.float64)
        ranges = (1.0, 255.0, 65535.0) if image.mode == "F" else (65535.0, 2.0**31 - 1)
        most = next((most for most in ranges if values.min() >= 0 and values.max() <= most), None)
        if most is None:
            raise ValueError("grey values outside of 0..1, 0..255 and 0..65535")
        return Image.fromarray((values * (255.999 / most)).astype(np.uint8)).convert("RGB")
    return image.convert("RGB")


def _decode(path: Path, width: int, height: int) -> np.ndarray:
    from PIL import Image

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with open_image(path) as image:
            image.draft("RGB", (width, height))  # lets JPEG skip detail that would be thrown away
            rgb = rgb_image(image)
            if rgb.size != (width, height):
                rgb = rgb.resize((width, height), Image.Resampling.BICUBIC)
            return np.array(rgb)
