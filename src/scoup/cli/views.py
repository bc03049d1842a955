"""scoup views: cameras and renders for a splat that comes without photographs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from scoup.base import counted
from scoup.cli.console import Console, command, kept
from scoup.cli.options import Direction, WritesCommon, arg


@dataclass(frozen=True, kw_only=True)
class OwnViews:
    """Settings of the views."""

    views: int | None = None
    """Number of views. Default: as many as still show something new."""
    width: int = 960
    """Width of the views, in pixels."""
    height: int = 720
    """Height of the views, in pixels."""
    up: Direction = None
    """The direction that is up in the splat. Default: estimated from its floors and tables."""
    keep_axes: bool = False
    """Take the up direction in the axes of the file, for .spz and glTF of programs that keep the numbers of the PLY."""


@dataclass(frozen=True, kw_only=True)
class MakeViews:
    """Choose cameras for a splat without photographs, and render their views.

    Takes the fewest views that show nearly all of the splat clearly and from several directions. The folder is a scene
    for scoup extract and for scoup build --gaussians SPLAT.
    """

    splat: Annotated[tyro.conf.Positional[Path], arg(metavar="SPLAT")]
    """The splat: .ply, .splat, .spz, .sog, .glb and more, or a folder that contains one."""
    out: Path | None = None
    """The scene folder to write: transforms.json, images, and views.png, a sheet of all views. Default: <name of
    SPLAT>_views here."""
    view: OwnViews = OwnViews()
    common: WritesCommon = WritesCommon()

    def run(self, console: Console) -> None:
        from scoup.extract import SHEET

        record = self.make(console)
        out = record["scene"]
        console.say(
            f"look at {out / SHEET}; then: {command('extract', out)}, "
            f"{command('build', out, '--gaussians', self.splat)}"
        )
        console.result(record)

    def make(self, console: Console) -> dict[str, Any]:
        """Choose the cameras and write the scene; returns what the result says."""
        from scoup.extract import write_own_views
        from scoup.io import splat_source

        out, view = self.out or Path(f"{splat_source(self.splat).path.stem}_views"), self.view
        sizes = {"width": view.width, "height": view.height, "count": view.views}
        with console.progress() as progress:
            cameras, shown = write_own_views(
                self.splat, out, view.up, view.keep_axes, self.common.overwrite, progress, **sizes
            )
        console.say(
            f"{out}: {counted(len(cameras), 'view')}; {shown.once:.1%} of the opaque Gaussians are in one or "
            f"more, {shown.often:.1%} in three or more"
        )
        return {"scene": out, "views": len(cameras), "coverage": shown.once, "coverage_by_three": shown.often}


def is_splat(path: Path) -> bool:
    """Tell whether a file, by its name, is a splat rather than a scene."""
    from scoup.io import is_splat_name

    return is_splat_name(path) and not path.is_dir()


def make_views(console: Console, splat: Path, folder: Path, overwrite: bool) -> None:
    """Make views of a splat alone in a folder, unless they are there already; with ``overwrite`` incomplete
    ones are replaced."""
    from scoup.extract import TRANSFORMS

    if (folder / TRANSFORMS).exists():
        again = command("views", splat, "--out", folder, "--overwrite")
        console.say(f"{folder}: uses the existing views; to replace them: {again}")
    else:
        MakeViews(splat=splat, out=folder, common=WritesCommon(overwrite=overwrite)).make(console)
    console.kept = lambda: kept("the views")
