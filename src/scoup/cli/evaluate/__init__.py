"""scoup eval: the tables of the papers, and other studies of how good answers are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro

from scoup.cli.console import Console
from scoup.cli.evaluate.comparisons import Baselines, Presence
from scoup.cli.evaluate.data_sets import LerfOvs, MipNerf360, ThreeDOvs
from scoup.cli.evaluate.studies import Ablations, Consistency, Curves
from scoup.cli.evaluate.synthetic import Synthetic

What = (
    Annotated[LerfOvs, tyro.conf.subcommand("lerf-ovs", prefix_name=False)]
    | Annotated[ThreeDOvs, tyro.conf.subcommand("3d-ovs", prefix_name=False)]
    | Annotated[MipNerf360, tyro.conf.subcommand("mipnerf360", prefix_name=False)]
    | Annotated[Baselines, tyro.conf.subcommand("baselines", prefix_name=False)]
    | Annotated[Ablations, tyro.conf.subcommand("ablations", prefix_name=False)]
    | Annotated[Curves, tyro.conf.subcommand("curves", prefix_name=False)]
    | Annotated[Consistency, tyro.conf.subcommand("consistency", prefix_name=False)]
    | Annotated[Presence, tyro.conf.subcommand("presence", prefix_name=False)]
    | Annotated[Synthetic, tyro.conf.subcommand("synthetic", prefix_name=False)]
)


@dataclass(frozen=True)
class Eval:
    """Score fields by the protocols of the papers: tables with intervals, and pictures of the worst answers.

    `scoup eval synthetic lerf-ovs ROOT` writes a synthetic data set, to try the others on and to see the layout.
    """

    what: tyro.conf.OmitArgPrefixes[What]

    def run(self, console: Console) -> None:
        """Run the command named."""
        self.what.run(console)
