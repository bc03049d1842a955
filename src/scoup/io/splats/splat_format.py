"""A format of trained splats, as the table in ``formats`` lists it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from scoup.io.splats.axes import Axis
from scoup.scene.gaussians import Gaussians

Preset = Literal["inria", "gsplat"]


def _any_name(path: Path) -> bool:
    return True


def _in_no_folder(folder: Path) -> Path | None:
    return None


@dataclass(frozen=True)
class SplatFormat:
    """A format of splats: how to recognise, read and write it."""

    name: str
    """For people."""
    endings: tuple[str, ...] = ()
    """Of the names of its files, in small letters; the longest ending of all formats decides."""
    read: Callable[[Path], Gaussians] | None = None
    """Takes a file with such a name, or what ``find`` returned; None: it is only written."""
    write: Callable[[Gaussians, Path, bool], None] | None = None
    """Takes the Gaussians, the file and whether to overwrite; None: it is only read."""
    preset: Preset = "inria"
    """Constants of the rasteriser that these splats are trained with."""
    axis: Axis | None = None
    """Of the half-turn that reading and writing make, for a format that names its axes."""
    has_name: Callable[[Path], bool] = _any_name
    """Whether a file with one of the endings is of this format, by its name."""
    find: Callable[[Path], Path | None] = _in_no_folder
    """Return the splat of a folder that a training has left: a file, or the folder itself; None if it is not one."""
    in_scenes: bool = True
    """Whether a file of this format in the folder of a scene is its splat, and not a mesh."""
