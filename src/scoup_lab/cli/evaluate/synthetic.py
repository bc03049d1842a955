"""scoup eval synthetic: a synthetic data set in the layout of a published one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from scoup.cli import Console, WritesCommon, arg, command


@dataclass(frozen=True, kw_only=True)
class Synthetic:
    """Write a complete synthetic data set in the layout of LERF-OVS, 3D-OVS, Mip-NeRF 360 or ScanNet.

    Images, COLMAP cameras, splat, region features, text vectors and labels are all simulated, so scores say nothing
    about the data set whose layout is used.
    """

    data_set: Annotated[
        tyro.conf.Positional[Literal["lerf-ovs", "3d-ovs", "mipnerf360", "scannet"]], arg(metavar="LAYOUT")
    ]
    """Data set whose layout is used: lerf-ovs, 3d-ovs, mipnerf360 or scannet."""
    root: Annotated[tyro.conf.Positional[Path], arg(metavar="ROOT")]
    """Folder to write into."""
    scenes: int = 2
    """Number of scenes, each with its own seed."""
    seed: int = 0
    """Seed of the first scene; the others follow it."""
    n_gaussians: int = 60_000
    """Gaussians in each scene."""
    width: int = 320
    """Width of the views, in pixels."""
    height: int = 240
    """Height of the views, in pixels."""
    views: int = 16
    """Views of each scene."""
    labelled: int = 4
    """Views with labels."""
    common: WritesCommon = WritesCommon()

    def run(self, console: Console) -> None:
        """Make and write."""
        from scoup_lab.synthetic.data_sets import DataSetSize, write_data_set

        size = DataSetSize(self.n_gaussians, self.width, self.height, self.views, self.labelled)
        seeds = range(self.seed, self.seed + self.scenes)
        with console.progress() as progress:
            names = write_data_set(
                self.data_set,
                self.root,
                size=size,
                seeds=seeds,
                overwrite=self.common.overwrite,
                progress=progress,
            )
        score = command("eval", self.data_set, self.root)
        console.say(f"{self.root}: {', '.join(names)}; to score: {score}")
        console.result({"root": self.root, "data_set": self.data_set, "scenes": list(names)})
