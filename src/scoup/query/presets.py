"""Presets of queries: how relevancy maps become points and masks (docs/protocols.md)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, get_args

from scoup.base.errors import InputError, UnknownNameError
from scoup.query.smoothing import Border, VoteBorder

LevelChoice = Literal["peak", "mask", "evidence"]


@dataclass(frozen=True)
class QueryPreset:
    """Rules by which relevancy maps become points and masks."""

    name: str
    """Name of the system it follows."""
    kernel: int
    """Side of the box that averages the relevancy, in pixels."""
    border: Border
    """"inside" averages over the pixels of the box inside the image; "reflect" mirrors the image at its edge pixels
    (which are not repeated)."""
    threshold: float | None
    """A pixel belongs to the mask if its rescaled relevancy is above this; None: of each map the threshold at which the
    area changes least (``scoup.query.stable_threshold``)."""
    smoothing: int
    """Side of the box that smooths the mask by majority; 1 is off."""
    level_choice: LevelChoice = "peak"
    """Which level answers. "peak": the level with the largest smoothed relevancy, as in the papers' protocol for
    LERF-OVS; "mask": the level whose own mask has the largest mean of smoothed relevancy; "evidence": that mean, how
    stable the mask is, and whether it contains another level's (``scoup.query.segment.choose_level``)."""
    smoothing_border: VoteBorder = "inside"
    """Which pixels of that box have a vote. "inside": those inside the image; "but last": those inside it but for its
    last row and column, as LangSplat's code has it."""

    @property
    def follows_things(self) -> bool:
        """Return whether things answer where a field has them; thresholds and the papers' rules are for votes."""
        return self.level_choice == "evidence" and self.threshold is None

    def __post_init__(self) -> None:
        if self.kernel < 1 or self.smoothing < 1:
            raise InputError(f"box sides must be at least 1 pixel, got {self.kernel} and {self.smoothing}")
        if self.threshold is not None and not 0 <= self.threshold <= 1:
            raise InputError(f"the threshold must be 0 to 1, got {self.threshold}")
        if self.level_choice not in get_args(LevelChoice):
            raise InputError(
                f"the level choice must be 'peak', 'mask' or 'evidence', got {self.level_choice!r}"
            )


QUERY_PRESETS: dict[str, QueryPreset] = {
    "default": QueryPreset(
        "default", kernel=7, border="inside", threshold=None, smoothing=7, level_choice="evidence"
    ),
    "scoup": QueryPreset("scoup", kernel=7, border="inside", threshold=0.6, smoothing=7),
    "langsplatv2": QueryPreset("langsplatv2", kernel=29, border="inside", threshold=0.4, smoothing=7),
    "langsplat": QueryPreset(
        "langsplat", kernel=30, border="reflect", threshold=0.4, smoothing=7, smoothing_border="but last"
    ),
}
"""Presets by name: "default" for everyday use, the others with their systems' rules for LERF-OVS."""

DATASET_THRESHOLDS: dict[str, dict[str, float | None]] = {
    "lerf-ovs": {"default": None, "scoup": 0.6, "langsplatv2": 0.4, "langsplat": 0.4},
    "3d-ovs": {"default": None, "scoup": 0.3, "langsplatv2": 0.25},
    "mipnerf360": {"default": None, "scoup": 0.45, "langsplatv2": 0.4},
}
"""Thresholds that the papers tuned per data set; ours needs none."""


def query_preset(name: str, dataset: str = "lerf-ovs", threshold: float | None = None) -> QueryPreset:
    """Return a preset by name, with the threshold of a data set or the one given."""
    if name not in QUERY_PRESETS:
        raise UnknownNameError("query preset", name, QUERY_PRESETS)
    if threshold is None:
        if dataset not in DATASET_THRESHOLDS:
            raise UnknownNameError("data set with thresholds", dataset, DATASET_THRESHOLDS)
        if name not in DATASET_THRESHOLDS[dataset]:
            raise UnknownNameError(f"query preset for {dataset}", name, DATASET_THRESHOLDS[dataset])
        threshold = DATASET_THRESHOLDS[dataset][name]
    return replace(QUERY_PRESETS[name], threshold=threshold)
