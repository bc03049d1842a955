"""A format of trained splats, as the table in ``formats`` lists it."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from scoup.base import Entry
from scoup.io.splats.axes import Axis, turned, turned_direction
from scoup.scene import Gaussians

Preset = Literal["inria", "gsplat"]


_BEGINNINGS = {
    b"\x1f\x8b\x08": "gzip (a .spz, or an archive)", b"PK\x03\x04": "zip (a .sog, .usdz, or an archive)",
    b"\x28\xb5\x2f\xfd": "zstd", b"7z\xbc\xaf": "7z", b"Rar!": "rar", b"ply\n": "PLY", b"ply\r": "PLY",
    b"NGSP": ".spz", b"glTF": ".glb", b"PXR-USDC": "OpenUSD", b"\x93NUMPY": ".npy", b"\xff\xd8\xff": "JPEG",
    b"\x89PNG": "PNG", b"RIFF": "WebP",
}  # fmt: skip
_TEXTS = {"<": "a web page or other XML", "{": "JSON", "[": "JSON"}
_KSPLAT = struct.Struct("<2B2xI8xIH")  # version, sections, splats, level of compression


def kind_inside(content: bytes) -> str:
    """Return the kind of file by its first 64 bytes, for formats that do not begin in a way of their own; "" if
    unknown."""
    for beginning, kind in _BEGINNINGS.items():
        if content.startswith(beginning):
            return kind
    start = content.removeprefix(b"\xef\xbb\xbf").lstrip()
    if start and start.isascii() and all(chr(byte).isprintable() or chr(byte).isspace() for byte in start):
        text = start.decode("ascii")
        return next((kind for beginning, kind in _TEXTS.items() if text.startswith(beginning)), "text")
    if len(content) >= _KSPLAT.size:
        major, minor, sections, splats, level = _KSPLAT.unpack_from(content)
        if major == 0 and minor < 2 and 0 < sections < 1 << 16 and splats and level < 3:
            return ".ksplat"
    return ""


@dataclass(frozen=True)
class SplatFormat(Entry):
    """A format of splats: how to recognise, read and write it."""

    endings: tuple[str, ...] = ()
    """Of the names of its files, in small letters; the longest ending of all formats decides."""
    read: Callable[..., Gaussians] | None = None
    """Takes a file with such a name, or what ``find`` returned; None: it is only written."""
    write: Callable[[Gaussians, Path, bool], None] | None = None
    """Takes the Gaussians, the file and whether to overwrite; None: it is only read."""
    preset: Preset = "inria"
    """Constants of the rasteriser that these splats are trained with."""
    axis: Axis | None = None
    """Of the half-turn that reading and writing make, for a format that names its axes."""
    has_name: Callable[[Path], bool] = lambda path: True
    """Tells by its name if a file with one of the endings is of this format."""
    find: Callable[[Path], Path | None] = lambda folder: None
    """Return the splat of a folder that a training has left: a file, or the folder itself; None if it is not one."""
    keeps_antialiased: bool = False
    """True if its files record training with antialiasing."""
    keeps_logs: bool = False
    """True if its files hold logarithms of scales and logits of opacities: ``read`` also takes ``activated``."""
    in_scenes: bool = True
    """True if a file of this format in the folder of a scene is its splat, and not a mesh."""

    def turned(self, gaussians: Gaussians) -> Gaussians:
        """Return Gaussians turned from the axes of 3DGS to those of this format, or back, on the CPU."""
        return gaussians if self.axis is None else turned(gaussians, self.axis)

    def turned_direction(self, direction: Sequence[float]) -> tuple[float, ...]:
        return tuple(direction) if self.axis is None else turned_direction(direction, self.axis)
