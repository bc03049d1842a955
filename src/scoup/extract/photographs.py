"""Photographs of a scene, decoded one by one to upright RGB, a few ahead of their use."""

from __future__ import annotations

import warnings
from collections.abc import Generator, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scoup.base import ScoupError, file_sha256, worked_ahead
from scoup.io import DYNAMIC_MASK, ScenePaths, open_image, rgb_image

AHEAD = 2  # photographs that are read before they are needed
_TURNS = {3: 2, 6: 3, 8: 1}  # EXIF orientation -> quarter turns against the clock that put the image upright
_MIRRORED = {2: 0, 4: 2, 5: 3, 7: 1}  # mirrored left to right after the turns


@dataclass(frozen=True)
class Photograph:
    """A photograph on disk."""

    name: str
    """As cameras name it."""
    path: Path
    """Of the file."""
    mask: Path | None = None
    """Of an image that is 0 where there are no regions; of instant-ngp's, where there are."""

    def digest(self) -> str:
        """Return the SHA-256 of the file; "" if it cannot be read, which is reported when its turn comes."""
        try:
            return file_sha256(self.path)
        except ScoupError:
            return ""


@dataclass(frozen=True, eq=False)
class Pixels:
    """A decoded photograph, turned from the orientation of the file, in which cameras and region maps are."""

    image: NDArray[np.uint8]  # [H, W, 3] RGB, upright
    turns: int  # quarter turns against the clock
    mirrored: bool  # left to right, after the turns
    digest: str  # SHA-256 of the file
    masked: NDArray[np.bool_] | None = None  # [H, W] where there are no regions, upright

    def as_stored(self, labels: NDArray[Any]) -> NDArray[Any]:
        """Turn labels [H, W] of the upright image to the orientation of the file."""
        unmirrored = labels[:, ::-1] if self.mirrored else labels
        return np.ascontiguousarray(np.rot90(unmirrored, -self.turns))


def find_photographs(scene: str | Path, images: str | Path | None = None) -> list[Photograph]:
    """Return the photographs of a scene, in order of their names.

    Args:
        scene: a folder with cameras as ``load_cameras`` reads them (their photographs are taken), or a folder
            with ``images``, ``images_2`` and so on, or of photographs.
        images: the folder of the photographs, where it is another.

    Raises:
        MissingFileError: there is no scene, or no photograph.
        FileFormatError: a file of cameras is damaged, or photographs have another shape than their cameras.
    """
    return [Photograph(*item) for item in ScenePaths(Path(scene)).photographs(images)]


def read_photograph(path: Path, max_height: int | None = 1080, mask: Path | None = None) -> Pixels:
    """Decode a photograph and its mask: upright by the photograph's EXIF orientation, RGB, 8 bits.

    FileFormatError where one cannot be read.

    Images higher than ``max_height`` (as stored) are reduced to it, widths truncated, as LangSplat does.
    """
    from PIL import Image

    with open_image(path) as stored:
        width, height = stored.size
        orientation = int(stored.getexif().get(0x0112, 1))
        rgb = rgb_image(stored)
        if max_height is not None and height > max_height:
            size = (max(1, int(width / (height / max_height))), max_height)
            rgb = rgb.resize(size, Image.Resampling.BILINEAR)
        array = np.asarray(rgb)
    mirrored = orientation in _MIRRORED
    turns = _MIRRORED.get(orientation, 0) if mirrored else _TURNS.get(orientation, 0)

    def upright(stored: NDArray[Any]) -> NDArray[Any]:
        turned = np.rot90(stored, turns)
        return np.array(turned[:, ::-1] if mirrored else turned, order="C")

    masked = None
    if mask is not None:
        with open_image(mask) as stored:
            brightest = Image.fromarray(np.asarray(rgb_image(stored)).max(2))
        dark = np.asarray(brightest.resize(rgb.size, Image.Resampling.NEAREST)) == 0
        masked = upright(dark != mask.name.startswith(DYNAMIC_MASK))
    return Pixels(upright(array), turns, mirrored, file_sha256(path), masked)


def read_ahead(
    photographs: Iterable[Photograph], max_height: int | None
) -> Generator[tuple[Photograph, Pixels | ScoupError], None, None]:
    """Yield photographs with their pixels, or the error of one that cannot be decoded, in order.

    Threads decode the next ones meanwhile; at most ``AHEAD`` + 1 images are in memory.
    """
    with warnings.catch_warnings():
        # Not in the threads: filters belong to the process, and threads would restore each other's.
        warnings.filterwarnings("ignore", module=r"PIL\.")

        def read(item: Photograph) -> Pixels:
            return read_photograph(item.path, max_height, item.mask)

        for item, future in worked_ahead(read, photographs, AHEAD):
            try:
                result: Pixels | ScoupError = future.result()
            except ScoupError as error:
                result = error
            del future  # it keeps the image
            yield item, result
