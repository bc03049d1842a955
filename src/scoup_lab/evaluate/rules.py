"""Rules of the papers, by which relevancy maps of a view become points and masks (docs/evaluation.md)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Border = Literal["inside", "reflect"]
VoteBorder = Literal["inside", "but last"]
LevelChoice = Literal["peak", "mask"]


@dataclass(frozen=True)
class MaskRule:
    """The constants of a system."""

    name: str
    """Name of the system."""
    kernel: int
    """Side of the box that averages the relevancy, in pixels."""
    border: Border
    """"inside" averages over the pixels of the box inside the image; "reflect" mirrors the image at its edge pixels
    (which are not repeated)."""
    threshold: float
    """A pixel belongs to the mask if its rescaled relevancy is above this."""
    smoothing: int
    """Side of the box that smooths the mask by majority; 1 is off."""
    level_choice: LevelChoice = "peak"
    """Which level answers. "peak": the level with the largest smoothed relevancy, as in LERF-OVS; "mask": the level
    whose own mask has the largest mean of smoothed relevancy."""
    smoothing_border: VoteBorder = "inside"
    """Which pixels of that box have a vote. "inside": those inside the image; "but last": those inside it but for its
    last row and column, as LangSplat's code has it."""


MASK_RULES: dict[str, MaskRule] = {
    "scoup": MaskRule("scoup", kernel=7, border="inside", threshold=0.6, smoothing=7),
    "langsplatv2": MaskRule("langsplatv2", kernel=29, border="inside", threshold=0.4, smoothing=7),
    "langsplat": MaskRule(
        "langsplat", kernel=30, border="reflect", threshold=0.4, smoothing=7, smoothing_border="but last"
    ),
}
"""By name of the system, as for LERF-OVS."""
