"""A folder of image files: which file belongs to which name. No file is opened."""

from __future__ import annotations

import os
from collections import defaultdict
from pathlib import Path, PurePosixPath

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
