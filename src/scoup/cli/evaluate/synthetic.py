"""scoup eval synthetic: a data set made by a program, in the layout of a published one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from scoup.cli.console import Console
from scoup.cli.options import WritesCommon, common_last


@common_last
@dataclass(frozen=True, kw_only=True)
class Synthetic(WritesCommon):
    """Write a complete data set in the layout of LERF-OVS, 3D-OVS or Mip-NeRF 360, made by a program.

    Images, COLMAP cameras, splat, region features, text vectors and labels, all simulated: scores on it say nothing
    about the data set whose layout it has.
    """

    data_set: Annotated[
        tyro.conf.Positional[Literal["lerf-ovs", "3d-ovs", "mipnerf360"]],
        tyro.conf.arg(help_behavior_hint=""),
    ]
    """Whose layout."""
    root: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="ROOT", help_behavior_hint="")]
    """Folder to write into."""
    scenes: Annotated[
        tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="LAYOUT", help_behavior_hint="")
    ] = ()
    """Layouts of the demo (table, shelves, hall, yard), a scene each; repeat it for several. Default: all four."""
    seed: int = 0
    """Of everything random."""
    n_gaussians: int = 60_000
    """Gaussians in each scene."""
    width: int = 320
    """Of the views, in pixels."""
    height: int = 240
    """Of the views, in pixels."""
    views: int = 16
    """Of each scene."""
    labelled: int = 4
    """Of these with labels."""

    def run(self, console: Console) -> None:
        """Make and write."""
        from scoup.synthetic.data_sets import DataSetSize, write_data_set
        from scoup.synthetic.layouts import LAYOUTS

        size = DataSetSize(self.n_gaussians, self.width, self.height, self.views, self.labelled)
        scenes = self.scenes or tuple(LAYOUTS)
        with console.progress() as progress:
            write_data_set(self.data_set, self.root, scenes, size, self.seed, self.overwrite, progress)
        console.say(
            f"{self.root}: {', '.join(scenes)}; score them with: scoup eval {self.data_set} {self.root}"
        )
        console.result({"root": self.root, "data_set": self.data_set, "scenes": list(scenes)})
