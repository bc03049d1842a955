"""scoup eval: the tables of the papers, and other studies of the quality of answers."""

from __future__ import annotations

from scoup.cli import Family

EVAL = Family(
    """Score fields by the protocols of the papers: tables with intervals, and pictures of the worst answers.

    `scoup eval synthetic lerf-ovs ROOT` writes a synthetic data set, to try the others on and to see the layout.
    """,
    {
        "lerf-ovs": "scoup_lab.cli.evaluate.data_sets:LerfOvs",
        "3d-ovs": "scoup_lab.cli.evaluate.data_sets:ThreeDOvs",
        "mipnerf360": "scoup_lab.cli.evaluate.data_sets:MipNerf360",
        "scannet": "scoup_lab.cli.evaluate.data_sets:ScanNet",
        "baselines": "scoup_lab.cli.evaluate.studies:Baselines",
        "ablations": "scoup_lab.cli.evaluate.studies:Ablations",
        "consistency": "scoup_lab.cli.evaluate.studies:Consistency",
        "synthetic": "scoup_lab.cli.evaluate.synthetic:Synthetic",
    },
    "scoup_lab.cli.evaluate.data_sets:verb_of_protocol",
)
