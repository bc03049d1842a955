"""Figures of SCOUP's paper (arXiv 2605.13600), to stand beside measured ones and marked as published. None was measured
by us. Scenes are named as in ``scoup_lab.evaluate.protocols``.
"""

from __future__ import annotations

from dataclasses import dataclass

SOURCE = "SCOUP's paper (arXiv 2605.13600)"


@dataclass(frozen=True)
class Published:
    """A row of the paper."""

    system: str  # whose figures
    miou: float  # in percent, over the data set
    accuracy: float | None = None  # in percent, of localisation; None where there is none
    # scene -> (mIoU, accuracy or None), in percent
    by_scene: dict[str, tuple[float, float | None]] | None = None


def _mious(scenes: str, *mious: float) -> dict[str, tuple[float, float | None]]:
    return {scene: (miou, None) for scene, miou in zip(scenes.split(), mious, strict=True)}


_OF_LERF: dict[str, tuple[float, float | None]] = {
    "figurines": (60.4, 85.7),
    "teatime": (75.3, 91.5),
    "ramen": (57.6, 74.7),
    "waldo_kitchen": (64.4, 95.5),
}
PUBLISHED: dict[str, tuple[Published, ...]] = {
    "lerf-ovs 2D": (
        Published("SCOUP (paper)", 64.4, 86.9, _OF_LERF),
        Published("dense 512-d uplift (paper)", 60.5, 82.0),
        Published("sparse uplift, no top-K (paper)", 60.0, 81.2),
    ),
    "mipnerf360 2D": (
        Published("SCOUP (paper)", 69.5, None, _mious("room counter garden bonsai", 66.5, 82.3, 57.4, 71.7)),
    ),
    "3d-ovs 2D": (
        Published(
            "SCOUP (paper)", 92.6, None, _mious("bed bench room sofa lawn", 87.7, 94.9, 95.1, 88.2, 97.2)
        ),
    ),
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
"""Ablations on LERF-OVS: (mIoU, localisation accuracy) in percent."""
