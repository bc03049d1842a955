"""Photographs of a scene, decoded one by one to upright RGB, a few ahead of their use."""

from __future__ import annotations

import hashlib
import os
import warnings
from collections.abc import Generator, Iterable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from scoup.base import ScoupError, file_sha256, worked_ahead
from scoup.io import DYNAMIC_MASK, ScenePaths, open_image, rgb_image

Keeps = Literal["white", "black", "all"]
_FOLDERS = ("masks", "mask")
LOSSY = (".jpg", ".jpeg")
MAX_HEIGHT = 1080  # pixels, as LangSplat: higher photographs are reduced
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
    masks_keep: Keeps = "white"
    """Where there are regions. all: neither mask nor transparency counts."""
    guessed: bool = False
    """The mask was found by its name, and nobody said what it keeps."""

    def digest(self) -> str:
        """Return that of ``Pixels``; "" if a file cannot be read, which is reported when its turn comes."""
        try:
            return _digest(self.path, self.mask, self.masks_keep)
        except ScoupError:
            return ""


@dataclass(frozen=True, eq=False)
class Pixels:
    """A decoded photograph, turned from the orientation of the file, in which cameras and region maps are."""

    image: NDArray[np.uint8]  # [H, W, 3] RGB, upright
    turns: int  # quarter turns against the clock
    mirrored: bool  # left to right, after the turns
    digest: str  # SHA-256 of the file, or of this with its mask
    masked: NDArray[np.bool_] | None = None  # [H, W] where there are no regions, upright

    def as_stored(self, labels: NDArray[Any]) -> NDArray[Any]:
        """Turn labels [H, W] of the upright image to the orientation of the file."""
        unmirrored = labels[:, ::-1] if self.mirrored else labels
        return np.ascontiguousarray(np.rot90(unmirrored, -self.turns))


def find_photographs(
    scene: str | Path, images: str | Path | None = None, masks: Literal["white", "black", False] | None = None
) -> list[Photograph]:
    """Return the photographs of a scene, in order of their names, with their masks: those that cameras name, else files
    as COLMAP (masks/x.jpg.png), LichtFeld Studio and Brush (masks/x.png), RealityScan (x.jpg.mask.png) and 3DGRUT
    (x_mask.png) name them.

    Args:
        scene: a folder with cameras as ``load_cameras`` reads them (their photographs are taken), or a folder
            with ``images``, ``images_2`` and so on, or of photographs.
        images: the folder of the photographs, where it is another.
        masks: where they allow regions; None: where white, unless that seems wrong (``report_masks``). False: ignore
            them, and transparency.

    Raises:
        MissingFileError: there is no scene, or no photograph.
        FileFormatError: a file of cameras is damaged, or photographs have another shape than their cameras.
    """
    found = []
    for name, path, named in ScenePaths(Path(scene)).photographs(images):
        mask = None if masks is False else named or _mask_of(name, path)
        guessed = (
            mask is not None and named is None and masks is None and not mask.name.startswith(DYNAMIC_MASK)
        )
        found.append(Photograph(name, path, mask, "all" if masks is False else masks or "white", guessed))
    return found


def _mask_of(name: str, image: Path) -> Path | None:
    """Return the mask of a photograph, beside it or in a folder of masks above it."""
    stems = {file: os.path.splitext(file)[0] for file in (image.name, PurePosixPath(name).name)}
    forms = [form for file, stem in stems.items() for form in (
        f"{file}.png", f"{file}.mask.png", f"{stem}.mask.png", f"{stem}_mask.png")]  # fmt: skip
    files = [
        image.with_name(form) for form in (*forms, *(f"{DYNAMIC_MASK}{stem}.png" for stem in stems.values()))
    ]
    forms += [f"{stem}{ending}" for stem in stems.values() for ending in (".png", *LOSSY)]
    for home in image.parents[:3]:
        within = image.parent.relative_to(home)
        for folder in [
            home / usual / part for usual in _FOLDERS for part in (within, Path(*within.parts[1:]))
        ]:
            files += [folder / form for form in forms] if folder.is_dir() else []
    return next((file for file in files if file != image and file.is_file()), None)


def read_photograph(
    path: Path, max_height: int = MAX_HEIGHT, mask: Path | None = None, masks_keep: Keeps = "white"
) -> Pixels:
    """Decode a photograph and its mask: upright by the photograph's EXIF orientation, RGB, 8 bits.

    FileFormatError where one cannot be read.

    Images higher than ``max_height`` (as stored) are reduced to it, widths truncated, as LangSplat does.
    """
    from PIL import Image

    with open_image(path) as stored:
        width, height = stored.size
        orientation = int(stored.getexif().get(0x0112, 1))
        rgb = rgb_image(stored)
        if height > max_height:
            size = (max(1, int(width / (height / max_height))), max_height)
            rgb = rgb.resize(size, Image.Resampling.BILINEAR)
        array = np.asarray(rgb)
        seen = _opaque(stored, rgb.size) if masks_keep != "all" else None
    mirrored = orientation in _MIRRORED
    turns = _MIRRORED.get(orientation, 0) if mirrored else _TURNS.get(orientation, 0)

    def upright(stored: NDArray[Any]) -> NDArray[Any]:
        turned = np.rot90(stored, turns)
        return np.array(turned[:, ::-1] if mirrored else turned, order="C")

    masked = None if seen is None else upright(~seen)
    if mask is not None and masks_keep != "all":
        with open_image(mask) as stored:
            brightest = Image.fromarray(np.asarray(rgb_image(stored)).max(2))
        least = 128 if mask.suffix.lower() in LOSSY else 1
        dark = np.asarray(brightest.resize(rgb.size, Image.Resampling.NEAREST)) < least
        hidden = upright(dark != (mask.name.startswith(DYNAMIC_MASK) != (masks_keep == "black")))
        masked = hidden if masked is None else masked | hidden
    return Pixels(upright(array), turns, mirrored, _digest(path, mask, masks_keep), masked)


def _digest(path: Path, mask: Path | None, masks_keep: Keeps) -> str:
    """Return the SHA-256 of a photograph's file; where a mask counts, or transparency does not, of this with that."""
    digest = file_sha256(path)
    if masks_keep != "all":
        more = "" if mask is None else f"{masks_keep} {file_sha256(mask)}"
    elif path.suffix.lower() in LOSSY:
        more = ""
    else:
        with open_image(path) as stored:
            more = "all" if _has_alpha(stored) else ""
    return hashlib.sha256(f"{digest} {more}".encode()).hexdigest() if more else digest


def _has_alpha(image: Any) -> bool:
    return image.mode in ("RGBA", "LA", "PA") or "transparency" in image.info


def _opaque(image: Any, size: tuple[int, int]) -> NDArray[np.bool_] | None:
    """Return [H, W] where an image of Pillow is not transparent; None if that is everywhere or nowhere."""
    from PIL import Image

    if not _has_alpha(image):
        return None
    alpha = image.convert("RGBA").getchannel("A").resize(size, Image.Resampling.NEAREST)
    seen = np.asarray(alpha) > 0
    return seen if seen.any() and not seen.all() else None


def read_ahead(
    photographs: Iterable[Photograph],
) -> Generator[tuple[Photograph, Pixels | ScoupError], None, None]:
    """Yield photographs with their pixels, or the error of one that cannot be decoded, in order.

    Threads decode the next ones meanwhile; at most ``AHEAD`` + 1 images are in memory.
    """
    with warnings.catch_warnings():
        # Not in the threads: filters belong to the process, and threads would restore each other's.
        warnings.filterwarnings("ignore", module=r"PIL\.")

        def read(item: Photograph) -> Pixels:
            return read_photograph(item.path, MAX_HEIGHT, item.mask, item.masks_keep)

        for item, future in worked_ahead(read, photographs, AHEAD):
            try:
                result: Pixels | ScoupError = future.result()
            except ScoupError as error:
                result = error
            del future  # it keeps the image
            yield item, result
