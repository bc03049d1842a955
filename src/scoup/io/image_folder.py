"""A folder of image files, found by name. No file is opened."""

from __future__ import annotations

import os
import posixpath
import re
import unicodedata
import warnings
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path, PurePosixPath, PureWindowsPath

from scoup.base import ScoupWarning, counted, listed

EXTENSIONS = (
    ".jpg", ".jpeg", ".png", ".webp", ".bmp", ".tif", ".tiff", ".jfif", ".jpe", ".gif", ".ppm", ".pgm", ".pnm",
)  # fmt: skip
UNREAD = (
    ".heic", ".heif", ".hif", ".avif", ".jxl", ".jp2", ".j2k", ".jpx", ".jpf", ".exr", ".dng", ".cr2", ".cr3", ".nef",
    ".arw", ".raf", ".orf", ".rw2",
)  # fmt: skip
"""Endings of photographs that are only read after conversion."""
_MASK = re.compile(r"[._-]mask$", re.I)
DYNAMIC_MASK = "dynamic_mask_"
"""Begins the names of masks of instant-ngp, beside their photographs, which are 0 where these count."""

_ASIDE = re.compile(
    r"(^|[/_-])(masks?|depths?|normals?|seg|segmentations?|semantics?|labels?|alphas?|mattes?)([/_-]|$)", re.I
)


class ImageFolder:
    """The image files below a folder, found by their paths relative to it, as COLMAP names them.

    Names are compared in one form of Unicode (NFC), as some systems write accents as characters of their own; and where
    that finds none, without regard to small and capital letters.

    Args:
        folder: listed once, links to folders in it too; must exist.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._exact: dict[str, Path] = {}
        self._endings: Counter[str] = Counter()  # of all files
        # By sub-folder, and name without its ending, or to its first dot.
        self._stems: dict[tuple[str, str], list[Path]] = defaultdict(list)
        self._starts: dict[tuple[str, str], list[Path]] = defaultdict(list)
        for root, folders, files in os.walk(folder, followlinks=True):
            folders[:] = sorted(name for name in folders if not _leads_above(root, name))
            within = "" if Path(root) == folder else _composed(Path(root).relative_to(folder).as_posix())
            for listed_name in sorted(files):
                file = _composed(listed_name)
                stem, ending = _split(file)
                self._endings[os.path.splitext(file)[1].lower() or "without ending"] += 1
                if not ending:
                    continue
                path = Path(root) / listed_name
                self._exact[posixpath.join(within, file)] = path
                key = within.casefold()
                self._stems[key, stem.casefold()].append(path)
                # x.jpg.png is most often the mask of x.jpg.
                if not _split(stem)[1] and not _MASK.search(stem):
                    self._starts[key, file.split(".", 1)[0].casefold()].append(path)
        self._folders = sorted({within for within, _ in self._stems})
        # (sub-folder, ending, ending): images with both lie there, such as x.jpg and its mask x.png.
        self._pairs = {
            (within, one.suffix.lower(), other.suffix.lower())
            for (within, _), paths in self._stems.items()
            for one in paths
            for other in paths
            if one != other
        }

    def __len__(self) -> int:
        return len(self._exact)

    def contents(self) -> str:
        """Return the numbers of its files by their endings, in words, with the command that converts photographs which
        are not read."""
        several = self._endings.most_common(5)
        found = ", ".join(f"{count} {ending}" for ending, count in several) or "no files"
        unread = [ending for ending in self._endings if ending in UNREAD]
        how = f"; convert them: {conversion(self.folder / f'*{unread[0]}')}" if unread else ""
        return f"{self.folder} contains {found}{how}"

    def photographs(self) -> dict[str, Path]:
        """Return all images by their names, in order, but for hidden files, masks, depth maps and the like."""
        return {
            name: self._exact[name]
            for name in sorted(self._exact)
            if not (posixpath.basename(name).startswith((".", DYNAMIC_MASK)) or _split(_split(name)[0])[1])
            and not _MASK.search(_split(name)[0])
            and not _ASIDE.search(posixpath.dirname(name))
        }

    def find(self, name: str) -> Path | None:
        """Return the image of that name: the file of that path.

        Its ending may be another if the name has none or one of ``UNREAD``, or no image of the sub-folder has both. A
        name without a folder may be that of a single file in a sub-folder, unless images lie outside of these.
        """
        name = _composed(name)
        for candidate in (*self._places(name), *self._places(name.replace("\\", "/"))):
            path = self._in(*posixpath.split(candidate))
            if path is not None:
                return path
        if "/" in name or "" in self._folders:
            return None
        others = [self._in(within, name) for within in self._folders if not _ASIDE.search(within)]
        paths = [path for path in others if path is not None]
        return paths[0] if len(paths) == 1 else None

    def _in(self, within: str, file: str) -> Path | None:
        path = self._exact.get(posixpath.join(within, file))
        if path is not None:
            return path
        stem, ending = _split(file.casefold())
        within = within.casefold()
        paths = self._stems.get((within, stem), [])
        if ending:
            same = [path for path in paths if path.suffix.lower() == ending]
            paths = same or [
                path for path in paths if (within, ending, path.suffix.lower()) not in self._pairs
            ]
        elif not paths:
            start, end = os.path.splitext(stem)
            unread = end in UNREAD
            paths = (self._stems if unread else self._starts).get((within, start if unread else stem), [])
        return paths[0] if len(paths) == 1 else None

    def _places(self, name: str) -> Iterator[str]:
        """Yield the name, and what follows this folder in it; of an absolute path or one with .., all ends."""
        parts = PurePosixPath(name).parts
        yield "/".join(parts)  # without ./ and //
        root = self.folder.absolute()
        folders = (*root.parent.parts, re.sub(r"^images_\d+$", "images", root.name))
        elsewhere = ".." in parts or PurePosixPath(name).is_absolute() or bool(PureWindowsPath(name).drive)
        for count in range(1, len(parts)):
            if elsewhere or folders[-count:] == parts[:count]:
                yield "/".join(parts[count:])


def conversion(files: Path) -> str:
    """Return the command that writes photographs as JPEG, found by their stems."""
    return f"magick mogrify -format jpg {files}"


def _composed(name: str) -> str:
    return unicodedata.normalize("NFC", name)


def _leads_above(root: str, name: str) -> bool:
    """Return whether a folder is a link to one that it is in."""
    path = os.path.join(root, name)
    return os.path.islink(path) and Path(os.path.realpath(root)).is_relative_to(os.path.realpath(path))


def _split(file: str) -> tuple[str, str]:
    """Return a name without the ending of an image, and this ending in small letters; "" if it has none."""
    stem, ending = os.path.splitext(file)
    return (stem, ending.lower()) if ending.lower() in EXTENSIONS else (file, "")


def is_outside(folder: Path, name: str) -> bool:
    """Return whether a path in a file of a scene, relative to ``folder`` or absolute, leaves that folder. Links are not
    followed: a scene may link to its photographs."""
    if PureWindowsPath(name).drive:
        return True
    home = os.path.abspath(folder)
    return os.path.commonpath([home, os.path.abspath(os.path.join(home, name))]) != home


def warn_of_outside(source: Path, folder: Path, names: Iterable[str]) -> None:
    """Warn of names of images, in a file ``source``, that leave the scene's folder."""
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
    """Return the file ``relative`` to ``folder``, as it is or with an image extension added, if there is one inside; of
    one that is not read its conversion, if there is one."""
    if is_outside(folder, relative):
        return None
    stem, ending = os.path.splitext(relative)
    if ending.lower() in UNREAD and (converted := find_beside(folder, stem)) is not None:
        return converted
    added = () if _split(relative)[1] else (*EXTENSIONS, *(item.upper() for item in EXTENSIONS))
    for form in dict.fromkeys([relative, _composed(relative), unicodedata.normalize("NFD", relative)]):
        for end in ("", *added):
            path = f"{folder / form}{end}"
            if os.path.isfile(path):
                return Path(path)
    return None
