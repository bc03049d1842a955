"""Figures that papers report, to stand beside measured ones and marked as published. None was measured by us.

Each row says in which table it stands, whose evaluation that is, where it was read if the paper itself was not at hand,
and in what its rules are known to differ from those that SCOUP's paper (arXiv 2605.13600) scores by, which are this
package's. A figure that was read nowhere is not here. Scenes are named as in ``scoup_lab.evaluate.protocols``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Origin:
    """The source of figures."""

    source: str  # the paper in which they stand
    by: str = ""  # whose evaluation or table that is, if not that of the system's own paper
    read_in: str = ""  # where they were read, if not in that paper

    def __str__(self) -> str:
        parts = [self.source, f"evaluated or quoted by {self.by}" if self.by else ""]
        return "; ".join(part for part in [*parts, f"read in {self.read_in}" if self.read_in else ""] if part)


@dataclass(frozen=True)
class Published:
    """A row of a paper."""

    system: str  # whose figures
    miou: float | None  # in percent, over the data set; None where there is none
    # in percent, of localisation; under "3D selection" the share of pairs with an IoU above 0.25. None where
    # there is none.
    accuracy: float | None
    # scene -> (mIoU or None, accuracy or None), in percent
    by_scene: dict[str, tuple[float | None, float | None]]
    origin: Origin  # where the figures are from
    protocol: str = ""  # in what the rules are known to differ, or that they are not known

    @property
    def note(self) -> str:
        """Return the source of the row in one line."""
        return f"{self.origin}; {self.protocol}" if self.protocol else str(self.origin)


Figures = tuple[float | None, float | None]


def _lerf(figurines: Figures, teatime: Figures, ramen: Figures, waldo_kitchen: Figures) -> dict[str, Figures]:
    return {"figurines": figurines, "teatime": teatime, "ramen": ramen, "waldo_kitchen": waldo_kitchen}


def _mious(scenes: str, *mious: float) -> dict[str, Figures]:
    return {scene: (miou, None) for scene, miou in zip(scenes.split(), mious, strict=True)}


_LERF = "figurines teatime ramen waldo_kitchen"
_DOCUMENTS = "the project's background documents"
_NOTES = "notes on the paper in a public repository"
_PAPER_NOTES = "github.com/zhaoyang97/Paper-Notes-en, docs/"
_RADIO_GS = "notes of github.com/Arthurshen926/RADIO-GS"
_SCOUP = Origin("SCOUP (arXiv 2605.13600)", read_in=_DOCUMENTS)
_OPENGAFF = Origin("OpenGaFF, table 1 (arXiv 2605.06088)", "OpenGaFF", _RADIO_GS)
_OPENGAFF_3D = Origin("OpenGaFF (arXiv 2605.06088)", "OpenGaFF", _RADIO_GS)
_COS3D = Origin("COS3D (arXiv 2510.20238)", "COS3D", _PAPER_NOTES + "NeurIPS2025/segmentation")
_LIGHTSPLAT = Origin("LightSplat (arXiv 2603.24146)", "LightSplat", _PAPER_NOTES + "CVPR2026/3d_vision")
_RELAGS = Origin("ReLaGS (arXiv 2603.17605)", "ReLaGS", _PAPER_NOTES + "CVPR2026/3d_vision")
_CCL = Origin("CCL-LGS (arXiv 2505.20469)", "CCL-LGS", _NOTES)
_LANGSPLAT = Origin("LangSplat (arXiv 2312.16084)", read_in=_NOTES)
_V2 = Origin(
    "LangSplatV2 (arXiv 2507.07136)",
    read_in=f"{_NOTES}, which give LangSplat other figures than its own paper does",
)
_UNKNOWN = "kernel and threshold not stated where it was read"
_NEWER = f"newer system; {_UNKNOWN}"
_CLUSTERS = "newer system; clusters of Gaussians are chosen and drawn, rules of masks not stated"

_ROOMS, _FOUR = "bed bench room sofa lawn", "room counter garden bonsai"
PUBLISHED: dict[str, tuple[Published, ...]] = {
    "lerf-ovs 2D": (
        Published(
            "SCOUP (paper)", 64.4, 86.9, _lerf((60.4, 85.7), (75.3, 91.5), (57.6, 74.7), (64.4, 95.5)), _SCOUP
        ),
        Published("dense 512-d uplift (SCOUP's paper)", 60.5, 82.0, {}, _SCOUP),
        Published("sparse uplift, no top-K (SCOUP's paper)", 60.0, 81.2, {}, _SCOUP),
        Published(
            "LangSplat",
            51.4,
            84.3,
            _lerf((44.7, 80.4), (65.1, 88.1), (51.2, 73.2), (44.5, 95.5)),
            _LANGSPLAT,
            "kernel 30 with a reflected border, threshold 0.4",
        ),
        Published(
            "LangSplatV2",
            59.9,
            84.1,
            _lerf((56.4, 82.1), (72.2, 93.2), (51.8, 74.7), (59.1, 95.5)),
            _OPENGAFF,
            "kernel 29, threshold 0.4; localisation overall is the mean over pairs: that over scenes is 86.4",
        ),
        Published(
            "GAGS",
            54.12,
            81.66,
            _lerf((53.59, 78.57), (60.29, 88.14), (46.81, 69.01), (55.80, 90.91)),
            _OPENGAFF,
        ),
        Published(
            "Occam's LGS",
            61.3,
            82.5,
            _lerf((58.6, 80.4), (70.2, 93.2), (51.0, 74.7), (65.3, 81.8)),
            _OPENGAFF,
        ),
        Published(
            "GOI", 42.0, 59.2, _lerf((23.9, 44.6), (55.8, 67.8), (33.7, 56.3), (54.5, 68.2)), _OPENGAFF
        ),
        Published("GOI", 50.6, None, _mious(_LERF, 44.5, 63.7, 52.6, 41.4), _CCL),
        Published(
            "LEGaussians",
            None,
            67.8,
            _lerf((None, 76.7), (None, 68.3), (None, 73.7), (None, 52.3)),
            Origin("LEGaussians, table 5 of the supplement (CVPR 2024)", read_in=_RADIO_GS),
            "localisation only; its last scene is called kitchen, and its labels may be others",
        ),
        Published(
            "GALA",
            55.49,
            73.43,
            _lerf((59.35, 82.14), (76.73, 88.14), (35.13, 50.70), (50.75, 72.73)),
            _OPENGAFF,
        ),
        Published("VALA", 61.7, None, _mious(_LERF, 59.9, 70.2, 51.5, 65.1), _RELAGS),
        Published("LaGa", 64.0, None, _mious(_LERF, 64.1, 70.9, 55.6, 65.6), _RELAGS),
        Published("THGS", 54.9, None, _mious(_LERF, 57.3, 68.3, 43.5, 50.7), _RELAGS),
        Published(
            "CCL-LGS", 65.6, None, _mious(_LERF, 61.2, 71.8, 62.3, 67.1), replace(_CCL, by=""), _UNKNOWN
        ),
        Published(
            "OpenGaFF",
            64.98,
            None,
            {},
            replace(_OPENGAFF_3D, by="", read_in="wizwand.com/paper/69fd6e145497b3b670c89409"),
            _NEWER,
        ),
        Published(
            "ReLaGS",
            64.36,
            None,
            _mious(_LERF, 64.69, 80.98, 51.15, 60.60),
            replace(_RELAGS, by=""),
            _CLUSTERS,
        ),
    ),
    "mipnerf360 2D": (
        Published("SCOUP (paper)", 69.5, None, _mious(_FOUR, 66.5, 82.3, 57.4, 71.7), _SCOUP),
        Published("LangSplatV2", 69.4, None, {}, _V2, "kernel 29, threshold 0.4"),
    ),
    "3d-ovs 2D": (
        Published("SCOUP (paper)", 92.6, None, _mious(_ROOMS, 87.7, 94.9, 95.1, 88.2, 97.2), _SCOUP),
        Published("LangSplat", 93.4, None, _mious(_ROOMS, 92.5, 94.2, 94.1, 90.0, 96.1), _LANGSPLAT),
        Published("LangSplatV2", 94.6, None, {}, _V2, "kernel 29, threshold 0.25"),
        Published(
            "Gaussian Grouping",
            82.9,
            None,
            _mious(_ROOMS, 97.3, 73.7, 79.0, 68.1, 96.5),
            Origin("GaussianSelector, table 2 (arXiv 2608.01492)", "GaussianSelector", _NOTES),
            "interactive segmentation, not by text",
        ),
    ),
    "3D selection": (
        Published("LangSplat", 9.66, 12.41, {}, _COS3D),
        Published("LangSplat", 7.66, 9.37, {}, _LIGHTSPLAT),
        Published("LEGaussians", 16.21, 23.82, {}, _COS3D),
        Published(
            "OpenGaussian",
            38.36,
            51.43,
            _lerf((39.29, 55.36), (60.44, 76.27), (31.01, 42.25), (22.70, 31.82)),
            _OPENGAFF_3D,
        ),
        Published("OpenGaussian", 42.15, 56.22, {}, _LIGHTSPLAT),
        Published(
            "SuperGSeg",
            35.94,
            52.02,
            _lerf((43.68, 60.71), (55.31, 77.97), (18.07, 23.94), (26.71, 45.45)),
            _OPENGAFF_3D,
        ),
        Published(
            "LangSplatV2",
            35.87,
            55.80,
            _lerf((45.15, 67.86), (49.30, 79.66), (19.01, 21.13), (30.00, 54.55)),
            _OPENGAFF_3D,
        ),
        Published(
            "Occam's LGS",
            47.22,
            74.84,
            _lerf((52.90, 78.57), (61.02, 93.22), (32.01, 54.92), (42.95, 72.72)),
            _OPENGAFF_3D,
        ),
        Published(
            "Dr. Splat",
            43.29,
            64.30,
            _lerf((54.42, 80.36), (57.35, 77.97), (24.33, 35.21), (37.05, 63.64)),
            _OPENGAFF_3D,
        ),
        Published("Dr. Splat", 43.58, 63.87, {}, _COS3D),
        Published(
            "GALA",
            36.71,
            59.71,
            _lerf((45.25, 69.64), (53.27, 84.75), (17.08, 25.35), (31.22, 59.09)),
            _OPENGAFF_3D,
        ),
        Published("InstanceGaussian", 45.30, 58.44, {}, _COS3D),
        Published("COS3D", 50.76, 72.08, {}, replace(_COS3D, by="")),
        Published("LightSplat", 47.58, 68.32, {}, replace(_LIGHTSPLAT, by=""), _CLUSTERS),
        Published("OpenGaFF", 54.36, 80.84, {}, replace(_OPENGAFF_3D, by=""), _NEWER),
    ),
}
"""By protocol; the rows of "3D selection" are of LERF-OVS."""

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
