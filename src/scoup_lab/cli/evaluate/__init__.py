"""scoup eval: the tables of the papers, and other studies of how good answers are."""

from __future__ import annotations

from scoup.cli.evaluate.comparisons import Baselines
from scoup.cli.evaluate.data_sets import LerfOvs, MipNerf360, RefLerf, ThreeDOvs
from scoup.cli.evaluate.point_labels import ScanNet, SceneSplat
from scoup.cli.evaluate.studies import Ablations, Consistency, Curves
from scoup.cli.evaluate.synthetic import Synthetic
from scoup.cli.parsing import Family

EVAL = Family(
    """Score fields by the protocols of the papers: tables with intervals, and pictures of the worst answers.

    `scoup eval synthetic lerf-ovs ROOT` writes a synthetic data set, to try the others on and to see the layout.
    """,
    {
        "lerf-ovs": LerfOvs,
        "3d-ovs": ThreeDOvs,
        "mipnerf360": MipNerf360,
        "ref-lerf": RefLerf,
        "scannet": ScanNet,
        "scenesplat": SceneSplat,
        "baselines": Baselines,
        "ablations": Ablations,
        "curves": Curves,
        "consistency": Consistency,
        "synthetic": Synthetic,
    },
)
