"""Figures that papers report, to stand beside measured ones and marked as published.

Only what docs/method.md and docs/protocols.md of the project's background state is here: all of it as SCOUP's paper
(arXiv 2605.13600) gives it, LangSplat's two figures as those of the 3D-selection papers. None was measured by us.
"""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Published:
    """A row of a paper.

    Attributes:
        system: whose figures.
        miou: in percent, over the data set.
        accuracy: of localisation, in percent; None where there is none.
        by_scene: scene -> (mIoU, accuracy or None), in percent.
    """

    system: str
    miou: float
    accuracy: float | None = None
    by_scene: dict[str, tuple[float, float | None]] = field(default_factory=dict)


PUBLISHED: dict[str, tuple[Published, ...]] = {
    "lerf-ovs 2D": (
        Published(
            "SCOUP (paper)",
            64.4,
            86.9,
            {
                "ramen": (57.6, 74.7),
                "teatime": (75.3, 91.5),
                "waldo_kitchen": (64.4, 95.5),
                "figurines": (60.4, 85.7),
            },
        ),
        Published("dense 512-d uplift (SCOUP's paper)", 60.5, 82.0),
        Published("sparse uplift, no top-K (SCOUP's paper)", 60.0, 81.2),
        Published("LangSplat", 51.4),
    ),
    "mipnerf360 2D": (
        Published(
            "SCOUP (paper)",
            69.5,
            None,
            {"room": (66.5, None), "counter": (82.3, None), "garden": (57.4, None), "bonsai": (71.7, None)},
        ),
    ),
    "3d-ovs 2D": (
        Published(
            "SCOUP (paper)",
            92.6,
            None,
            {
                "bed": (87.7, None),
                "bench": (94.9, None),
                "room": (95.1, None),
                "sofa": (88.2, None),
                "lawn": (97.2, None),
            },
        ),
    ),
    "3D selection": (Published("LangSplat", 9.66),),
}
"""By protocol."""

ABLATIONS: dict[str, tuple[float, float]] = {
    "dense uplift": (60.5, 82.0),
    "no top-K": (60.0, 81.2),
    "top-K (L=64, K=4)": (64.4, 86.9),
    "L=32": (60.6, 77.2),
    "L=128": (65.5, 85.1),
    "K=2": (62.5, 82.9),
    "K=8": (63.8, 78.1),
    "without the 50 % of highest entropy": (61.0, float("nan")),
    "without the 50 % of lowest entropy": (33.1, float("nan")),
}
"""Ablations of SCOUP's paper on LERF-OVS: (mIoU, localisation accuracy) in percent."""
