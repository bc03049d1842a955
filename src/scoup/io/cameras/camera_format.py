"""A format of cameras, as the table in ``camera_sources`` lists it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from scoup.base.registry import Entry
from scoup.io.reading import Distorted
from scoup.scene.cameras import Cameras


@dataclass(frozen=True)
class CameraFormat(Entry):
    """A format of cameras: how to recognise and read it."""

    read: Callable[[Path, Distorted], Cameras]
    """Takes a file (of COLMAP a folder), and what to do about lens distortion."""
    takes: Callable[[Path], bool]
    """Whether an existing file is of this format; the first format that takes a file reads it."""
    files: tuple[str, ...] = ()
    """Names of its files in the folder of a scene."""


def begins_with(path: Path, ending: str, beginning: bytes) -> bool:
    """Return whether a file has an ending, and begins with some bytes behind blanks."""
    if path.suffix.lower() != ending:
        return False
    with open(path, "rb") as stream:
        return stream.read(4096).lstrip(b"\xef\xbb\xbf \t\r\n").startswith(beginning)
