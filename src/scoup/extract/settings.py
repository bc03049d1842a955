"""Settings of the masks, with presets."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any, Literal, get_args

from scoup.base import InputError

Preset = Literal["langsplat", "fast"]


@dataclass(frozen=True)
class MaskSettings:
    """Settings of a model that predicts masks from points; the defaults are LangSplat's."""

    points_per_side: int = 32
    """Of the square grid of points, in the image and in each crop."""
    points_per_batch: int = 64
    """Points predicted at a time; decides memory, not the result."""
    predicted_iou: float = 0.7
    """Masks above it are kept."""
    stability: float = 0.85
    """Least share of a mask's area that remains when the threshold of its logits moves from -offset to +offset."""
    stability_offset: float = 1.0
    """See ``stability``."""
    box_overlap: float = 0.7
    """Largest IoU of boxes within a crop."""
    crop_overlap: float = 0.7
    """Largest IoU of boxes across crops."""
    crop_layers: int = 1
    """Further layers of crops; layer n has 2^n x 2^n."""
    crop_share: float = 512 / 1500
    """Overlap of neighbouring crops in the first layer, as a share of the image's shorter side."""
    least_area: int = 100
    """Smaller holes are filled and smaller islands removed, in pixels."""
    mask_overlap: float = 0.8
    """Of the mask rule, as the next three: see ``overlaps.keep_by_masks``."""
    least_score: float = 0.7
    inside: float = 0.85
    covered: float = 0.5
    coarse_filters: bool = False
    """Filter by stability and boxes on the model's low-resolution masks, and upscale only the rest."""
    by_need: bool = False
    """Predict the points of the grid from coarse to fine, and leave out those of which earlier ones found the masks.
    Needs coarse_filters."""
    drop_hidden: bool = False
    """Leave out masks that later ones paint over entirely."""
    cut_last: bool = True
    """Leave out the last row and column of a box in its crop (``crops.mask_crops``)."""
    half: bool = False
    """Run the model in 16 bits where the device can."""

    def __post_init__(self) -> None:
        for name in ("points_per_side", "points_per_batch"):
            if getattr(self, name) < 1:
                raise InputError(f"{name} must be at least 1, got {getattr(self, name)}")
        if not 0 <= self.crop_layers <= 4:
            raise InputError(f"crop_layers must be 0 to 4, got {self.crop_layers}")
        if self.by_need and not self.coarse_filters:
            raise InputError("by_need needs coarse_filters")
        if self.least_area < 0:
            raise InputError(f"least_area must not be negative, got {self.least_area}")

    def to_dict(self) -> dict[str, Any]:
        """Return the settings that decide the result, as plain values for the manifest."""
        values = asdict(self)
        del values["points_per_batch"]
        return values


_FAST = replace(
    MaskSettings(),
    points_per_batch=256,
    crop_layers=0,
    coarse_filters=True,
    by_need=True,
    drop_hidden=True,
    cut_last=False,
    half=True,
)


def mask_settings(preset: Preset = "langsplat", **changes: Any) -> MaskSettings:
    """Return a preset with changes; changes that are None are ignored.

    ``langsplat`` is faithful. ``fast`` uses one grid of points instead of five, leaves out points that would find known
    masks, filters the model's low-resolution masks before upscaling them, and runs in 16 bits
    where the device can.
    """
    if preset not in get_args(Preset):
        raise InputError(f"there is no preset {preset!r}; use one of {', '.join(get_args(Preset))}")
    start = _FAST if preset == "fast" else MaskSettings()
    return replace(start, **{name: value for name, value in changes.items() if value is not None})
