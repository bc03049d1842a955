"""Settings of a build, and its presets."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

from scoup import raster
from scoup.base import InputError, check_arguments, looked_up

Scale: TypeAlias = float | Literal["auto"]
"""Size of the images that region sums are made of, relative to the cameras'."""
_OF_FIT = ("n_atoms", "k", "solver", "effort", "epochs", "tolerance", "seed")


def check_scale(scale: Scale) -> None:
    """Raise an InputError for an invalid scale."""
    if scale != "auto" and not (isinstance(scale, (int, float)) and 0 < scale <= 1):
        raise InputError(f'the scale must be "auto", or above 0 and at most 1, got {scale!r}')


@dataclass(frozen=True)
class BuildSettings:
    """Everything that decides what a build computes, and how.

    ``BUILD_PRESETS`` names two: "default", same as ``BuildSettings()``, and "paper".

    Example:
        >>> scoup.BuildSettings(n_atoms=64, things=False).n_atoms
        64
    """

    n_atoms: int = 128
    """Atoms in the codebook of each level (L)."""
    k: int = 4
    """Atoms in the code of a region (K)."""
    keep: int = 4
    """Atoms each Gaussian keeps after the vote; 0 keeps all."""
    rounds: int = 2
    """Rounds of the vote. After the first, regions count by their cosine with the result of the previous round."""
    solver: str = "exact"
    """How codes are learned: exact, or adam as in the paper, which takes minutes where exact takes a second."""
    effort: str = "fast"
    """How long the exact solver searches: best, or fast in half the time."""
    epochs: int = 4000
    """Epochs of the adam solver; fewer are faster and slightly worse."""
    tolerance: float | None = None
    """Stop adam once its loss falls by less than this in 100 epochs."""
    seed: int = 0
    """Seed of the codebook's start; the same seed gives the same file (for adam, with the same number of threads)."""
    raster_preset: str = "inria"
    """Rasteriser constants the scene was trained with: "inria" or "gsplat". Their near plane is replaced where it cuts
    what the cameras see, unless it is named, as in "inria:0.2" (``scoup.uplift.near_plane``)."""
    scale: Scale = "auto"
    """Size of the images that region sums are made of, relative to the cameras', above 0 and up to 1; auto: the longer
    side has 500 pixels, or the camera's if it is shorter."""
    things: bool = True
    """Merge the regions of all views into instances, which answer texts (``scoup.uplift.things``)."""
    check_fit: bool = True
    """Compare small renders of some views with their photographs first (``scoup.uplift.fit``)."""
    backend: str | None = None
    """Backend of rasteriser and vote; by default the fastest for the device."""

    @property
    def of_fit(self) -> dict[str, Any]:
        """The settings that decide the codebook (``fit_codes``)."""
        return {name: getattr(self, name) for name in _OF_FIT}

    def to_dict(self) -> dict[str, Any]:
        """Return the settings that decide the result, as JSON values: all but ``check_fit`` and ``backend``."""
        return {
            name: value
            for name, value in dataclasses.asdict(self).items()
            if name not in ("check_fit", "backend")
        }

    def __post_init__(self) -> None:
        if not 1 <= self.k <= self.n_atoms or not 0 <= self.keep <= self.n_atoms:
            raise InputError(
                f"k ({self.k}) and keep ({self.keep}) must not exceed the {self.n_atoms} atoms, and k must be at "
                "least 1"
            )
        if self.rounds < 1:
            raise InputError(f"the vote needs at least one round, got {self.rounds}")
        raster.raster_preset(self.raster_preset)
        check_scale(self.scale)
        if self.tolerance is not None and not self.tolerance >= 0:
            raise InputError(f"the tolerance must be 0 or more, got {self.tolerance}")
        if not 0 <= self.seed < 1 << 63:
            raise InputError(f"the seed must be 0 to 2^63 - 1, got {self.seed}")


BUILD_PRESETS: dict[str, BuildSettings] = {
    "default": BuildSettings(),
    "paper": BuildSettings(n_atoms=64, k=4, rounds=1, solver="adam", scale=1.0, things=False),
}
"""The best answers at little cost (docs/answers.md), and the paper's method as published."""


def build_settings(settings: BuildSettings | str = "default", **changes: Any) -> BuildSettings:
    """Return settings, or a preset by name, with some fields changed; None leaves a field as it is.

    With fewer atoms than k or keep, these become as many, unless they are among the changes.
    """
    if isinstance(settings, str):
        settings = looked_up("build preset", settings, BUILD_PRESETS)
    check_arguments("build_settings", settings=(settings, BuildSettings))
    changes = {name: value for name, value in changes.items() if value is not None}
    for name in ("k", "keep"):
        if name not in changes and changes.get("n_atoms", 0) > 0:
            changes[name] = min(getattr(settings, name), changes["n_atoms"])
    return dataclasses.replace(settings, **changes)
