"""Which image file belongs to which camera name, and how large it is, without decoding it."""

from __future__ import annotations

import os
import warnings
from collections import defaultdict
from pathlib import Path, PurePosixPath

from scoup.base.errors import FileFormatError
from scoup.io.reading import MAX_IMAGE_SIDE, existing_file

EXTENSIONS = (".jpg", ".jpeg", ".png", ".webp", ".bmp", ".tif", ".tiff")


class ImageFolder:
    """The image files below a folder, found by name with or without extension or sub-folder.

    Args:
        folder: listed once; must exist.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._exact: dict[str, Path] = {}
        self._loose: dict[str, set[Path]] = defaultdict(set)
        for root, folders, files in os.walk(folder):
            folders.sort()
            for file in sorted(files):
                if not file.lower().endswith(EXTENSIONS):
                    continue
                path = Path(root) / file
                relative = path.relative_to(folder)
                self._exact[relative.as_posix()] = path
                for key in (file, relative.with_suffix("").as_posix(), relative.stem, file.split(".", 1)[0]):
                    self._loose[key].add(path)

    def __len__(self) -> int:
        return len(self._exact)

    def find(self, name: str) -> Path | None:
        """The image of that name: exactly, else without its extension, else its last part alone if unique."""
        if name in self._exact:
            return self._exact[name]
        pure = PurePosixPath(name)
        for key in (name, pure.name, pure.with_suffix("").as_posix() if pure.name else name, pure.stem):
            found = self._loose.get(key, set())
            if len(found) == 1:
                return next(iter(found))
        return None


def find_beside(folder: Path, relative: str) -> Path | None:
    """The file ``relative`` to ``folder``, as it is or with an image extension added, if there is one."""
    candidate = folder / relative
    for end in ("", *EXTENSIONS, *(item.upper() for item in EXTENSIONS)):
        path = f"{candidate}{end}"
        if os.path.isfile(path):
            return Path(path)
    return None


def image_size(path: str | Path) -> tuple[int, int]:
    """Width and height of an image file in pixels, from its header alone; EXIF orientation is not applied.

    Raises:
        MissingFileError: there is no such file.
        FileFormatError: it is no image, or absurdly large.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Pillow warns about every large photograph
        return size_in_header(path)


def size_in_header(path: str | Path) -> tuple[int, int]:
    """``image_size`` with Pillow's warnings. For threads: filters of warnings belong to the process, and threads would
    put back each other's.
    """
    from PIL import Image

    path = existing_file(path, "an image")
    try:
        with Image.open(path) as image:
            width, height = image.size
    except Exception as error:  # damaged images raise nearly everything inside Pillow
        raise FileFormatError(
            path, "is not an image that can be read", "copy it again, or remove it"
        ) from error
    if not (1 <= width <= MAX_IMAGE_SIDE and 1 <= height <= MAX_IMAGE_SIDE):
        raise FileFormatError(path, f"claims {width} x {height} pixels", "the file is damaged; copy it again")
    return width, height
