"""Write a synthetic data set with a scene of each layout, in the layout of a published data set.

    python -m benchmarks.scenes lerf-ovs ROOT [--layout table ...] [--n-gaussians 60000] [--views 16] [--labelled 4]

Then ``scoup eval lerf-ovs ROOT`` scores it. Everything in it is simulated: scores say nothing about the published data
set.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from benchmarks.scenes import LAYOUTS, find_layout
from scoup.base.errors import ScoupError
from scoup_lab.synthetic.data_sets import DataSetSize, write_data_set


@dataclass(frozen=True)
class Arguments:
    data_set: tyro.conf.Positional[
        Literal["lerf-ovs", "3d-ovs", "mipnerf360", "ref-lerf", "scannet", "scenesplat"]
    ]
    """The layout of the files."""
    root: tyro.conf.Positional[Path]
    """Folder to write into."""
    layout: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME ...")] = tuple(LAYOUTS)
    """Kinds of scenes, one scene each."""
    seed: int = 0
    """Of everything random."""
    n_gaussians: int = 60_000
    """Gaussians in each scene."""
    width: int = 320
    """Of the views, in pixels."""
    height: int = 240
    """Of the views, in pixels."""
    views: int = 16
    """Views of each scene."""
    labelled: int = 4
    """How many of them have labels."""
    overwrite: bool = False
    """Replace existing files."""


def main(arguments: Arguments) -> None:
    size = DataSetSize(
        arguments.n_gaussians, arguments.width, arguments.height, arguments.views, arguments.labelled
    )
    layouts = [find_layout(name) for name in arguments.layout]
    names = write_data_set(
        arguments.data_set, arguments.root, layouts, size, (arguments.seed,), arguments.overwrite
    )
    print(f"{arguments.root}: {', '.join(names)}; to score: scoup eval {arguments.data_set} {arguments.root}")


if __name__ == "__main__":
    try:
        main(tyro.cli(Arguments, description=__doc__))
    except ScoupError as error:
        sys.exit(f"error: {error}")
