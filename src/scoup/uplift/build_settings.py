"""Settings of a build, and the named ones."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from scoup.base.arguments import check_arguments
from scoup.base.errors import InputError, looked_up

_OF_FIT = ("n_atoms", "k", "solver", "effort", "epochs", "tolerance", "seed")


@dataclass(frozen=True)
class BuildSettings:
    """Everything that decides what a build computes. ``BUILD_PRESETS`` names two: "default" (what answers best, and
    what ``BuildSettings()`` is) and "paper".

    Attributes:
        n_atoms: L, atoms in each level's codebook.
        k: K, atoms in the code of a region.
        keep: atoms kept for each Gaussian by the vote; 0 keeps all (no top-K step).
        rounds: of the vote, 1 or more. One is the paper's; in each further one regions count by their cosine with the
            outcome of the round before (``scoup.uplift.reweighting``).
        solver: how codes are learned, see ``fit_codes``.
        effort: of the "exact" solver, "fast" or "best".
        epochs: epochs of the "adam" solver.
        tolerance: stop the "adam" solver once its loss has fallen by less than this over 100 epochs; None never.
        seed: of the codebook's start.
        raster_preset: rasteriser constants the scene was trained with: "inria" or "gsplat".
        things: merge the regions of all views into instances, which answer texts (``scoup.uplift.things``).

    Example:
        >>> scoup.BuildSettings(n_atoms=64, things=False).n_atoms
        64
    """

    n_atoms: int = 128
    k: int = 4
    keep: int = 4
    rounds: int = 2
    solver: str = "exact"
    effort: str = "fast"
    epochs: int = 4000
    tolerance: float | None = None
    seed: int = 0
    raster_preset: str = "inria"
    things: bool = True

    @property
    def of_fit(self) -> dict[str, Any]:
        """Those that decide the codebook (``fit_codes``)."""
        return {name: getattr(self, name) for name in _OF_FIT}

    @property
    def of_codes(self) -> dict[str, Any]:
        """Those that decide the codes of the regions."""
        return {**self.of_fit, "things": self.things}

    def __post_init__(self) -> None:
        if not 1 <= self.k <= self.n_atoms or not 0 <= self.keep <= self.n_atoms:
            raise InputError(
                f"k ({self.k}) and keep ({self.keep}) must not exceed the {self.n_atoms} atoms, and k must be at "
                "least 1"
            )
        if self.rounds < 1:
            raise InputError(f"the vote takes at least one round, not {self.rounds}")
        if self.tolerance is not None and not self.tolerance >= 0:
            raise InputError(f"the tolerance must be 0 or more, got {self.tolerance}")
        if not 0 <= self.seed < 1 << 63:
            raise InputError(f"the seed must be 0 to 2^63 - 1, got {self.seed}")


BUILD_PRESETS: dict[str, BuildSettings] = {
    "default": BuildSettings(),
    "paper": BuildSettings(n_atoms=64, k=4, rounds=1, solver="adam", things=False),
}
"""What answers best at little cost (docs/answers.md), and the paper's method as published."""


def build_settings(settings: BuildSettings | str = "default", **changes: Any) -> BuildSettings:
    """Settings, or a preset by name, with some fields changed; None leaves a field as it is.

    With fewer atoms than a code has, k and keep become as many, unless they are given.

    Raises:
        UnknownNameError: there is no such preset.
        InputError: the settings do not go together.
    """
    if isinstance(settings, str):
        settings = looked_up("build preset", settings, BUILD_PRESETS)
    check_arguments("build_settings", settings=(settings, BuildSettings))
    changes = {name: value for name, value in changes.items() if value is not None}
    # A small codebook is no error: codes are as long as it allows, unless they were given a length.
    for name in ("k", "keep"):
        if name not in changes and changes.get("n_atoms", 0) > 0:
            changes[name] = min(getattr(settings, name), changes["n_atoms"])
    return dataclasses.replace(settings, **changes)
