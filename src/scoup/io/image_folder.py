"""A folder of image files: which file belongs to which name. No file is opened."""

from __future__ import annotations

import os
import warnings
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path, PurePosixPath, PureWindowsPath

from scoup.base.counts import counted, listed
from scoup.base.errors import ScoupWarning

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
        """Return the image of that name: exactly, else without its extension, else its last part alone if unique."""
        if name in self._exact:
            return self._exact[name]
        pure = PurePosixPath(name)
        for key in (name, pure.name, pure.with_suffix("").as_posix() if pure.name else name, pure.stem):
            paths = self._loose.get(key, set())
            if len(paths) == 1:
                return next(iter(paths))
        return None


def is_outside(folder: Path, name: str) -> bool:
    """Return whether a path in a file of a scene, relative to ``folder`` or absolute, leaves that folder.

    Links are not followed: a scene may link to its photographs, which is its owner's choice.
    """
    if PureWindowsPath(name).drive:
        return True
    home = os.path.abspath(folder)
    return os.path.commonpath([home, os.path.abspath(os.path.join(home, name))]) != home


def warn_of_outside(source: Path, folder: Path, names: Iterable[str]) -> None:
    """Warn of names of images that leave the scene's folder.

    Args:
        source: the file that has them.
        folder: of the scene.
    """
    outside = [name for name in names if is_outside(folder, name)]
    if outside:
        warnings.warn(
            f"{source}: names {counted(len(outside), 'image')} outside of the scene's folder ({listed(outside)}); only "
            "those in it are opened, found by their names; put the images into its folder images, or name their folder "
            "with `images`",
            ScoupWarning,
            stacklevel=4,
        )


def find_beside(folder: Path, relative: str) -> Path | None:
    """Return the file ``relative`` to ``folder``, as it is or with an image extension added, if there is one inside."""
    if is_outside(folder, relative):
        return None
    candidate = folder / relative
    for end in ("", *EXTENSIONS, *(item.upper() for item in EXTENSIONS)):
        path = f"{candidate}{end}"
        if os.path.isfile(path):
            return Path(path)
    return None
