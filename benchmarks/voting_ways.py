"""The ways compared by benchmarks/voting.py: methods, and how the level of a mask is chosen."""

from __future__ import annotations

from typing import Any, NamedTuple

from scoup.base.errors import looked_up
from scoup.baselines.method import Method
from scoup.baselines.methods import METHODS
from scoup.baselines.sparse import SparseUplift
from scoup.query.presets import LevelChoice


class Way(NamedTuple):
    """A method, and how the level of a mask is chosen."""

    method: Method
    level_choice: LevelChoice = "peak"


OF_BASE: dict[str, Any] = {"k": 4, "wide": False, "keep": 4, "effort": "best"}
"""What all ways but the default are measured with, unless their names say otherwise."""


def _sparse(name: str, n_atoms: int = 64, rounds: int = 1, **changes: Any) -> Method:
    """The paper's sizes, codes and vote with exact coding, but for some changes."""
    return Method(name, SparseUplift(n_atoms=n_atoms, rounds=rounds, **{**OF_BASE, **changes}))


DENSE, PAPER, EXACT = METHODS["dense"], METHODS["paper"], METHODS["sparse-64"]
EXACT_128 = _sparse("exact-128", 128)
TWO_ROUNDS = _sparse("exact-128-rounds", 128, 2)
THREE_ROUNDS = _sparse("exact-128-rounds-3", 128, 3)
WAYS: dict[str, Way] = {
    "dense": Way(DENSE),
    "dense-mask": Way(DENSE, "mask"),
    "paper": Way(PAPER),
    "paper-no-top-k": Way(_sparse("paper-no-top-k", solver="adam", keep=0)),
    "paper-128": Way(_sparse("paper-128", 128, solver="adam")),
    "paper-128-rounds-mask": Way(_sparse("paper-128-rounds", 128, 2, solver="adam"), "mask"),
    "exact": Way(EXACT),
    "exact-no-top-k": Way(METHODS["sparse-64-all"]),
    "exact-mask": Way(EXACT, "mask"),
    "exact-128": Way(EXACT_128),
    "exact-128-mask": Way(EXACT_128, "mask"),
    "exact-rounds": Way(_sparse("exact-rounds", rounds=2)),
    "exact-128-rounds": Way(TWO_ROUNDS),
    "exact-128-rounds-mask": Way(TWO_ROUNDS, "mask"),
    "exact-128-rounds-3": Way(THREE_ROUNDS),
    "exact-128-rounds-3-mask": Way(THREE_ROUNDS, "mask"),
    "exact-32": Way(_sparse("exact-32", 32)),
    "exact-256": Way(_sparse("exact-256", 256)),
    "exact-k2": Way(_sparse("exact-k2", k=2, keep=2)),
    "exact-k8": Way(_sparse("exact-k8", k=8, keep=8)),
    "exact-128-k2-rounds-mask": Way(_sparse("exact-128-k2-rounds", 128, 2, k=2, keep=2), "mask"),
    "exact-128-k2-keep-4-rounds-mask": Way(
        _sparse("exact-128-k2-keep-4-rounds", 128, 2, k=2, keep=4), "mask"
    ),
    "exact-128-k1-keep-4-rounds-mask": Way(
        _sparse("exact-128-k1-keep-4-rounds", 128, 2, k=1, keep=4), "mask"
    ),
    "default": Way(METHODS["sparse"], "mask"),
}
"""By name. "paper" is the published method; "default" is what ``scoup build`` does
unasked, with the level by its mask; the masks of all ways are cut at the paper's threshold."""

COMPARISONS: dict[str, tuple[str, str]] = {
    "exact - paper": ("exact", "paper"),
    "exact, K = 2 - paper": ("exact-k2", "paper"),
    "exact, K = 2 - K = 4": ("exact-k2", "exact"),
    "exact, K = 8 - K = 4": ("exact-k8", "exact"),
    "exact, 32 - 64 atoms": ("exact-32", "exact"),
    "exact, 256 - 64 atoms": ("exact-256", "exact"),
    "top-K - no top-K, paper": ("paper", "paper-no-top-k"),
    "top-K - no top-K, exact": ("exact", "exact-no-top-k"),
    "mask - peak, dense": ("dense-mask", "dense"),
    "mask - peak, exact": ("exact-mask", "exact"),
    "128 - 64 atoms": ("exact-128", "exact"),
    "two rounds - one": ("exact-128-rounds", "exact-128"),
    "two rounds - one, mask": ("exact-128-rounds-mask", "exact-128-mask"),
    "three rounds - two, mask": ("exact-128-rounds-3-mask", "exact-128-rounds-mask"),
    "default - dense": ("default", "dense"),
    "default - dense-mask": ("default", "dense-mask"),
    "default - paper": ("default", "paper"),
    "default - exact": ("default", "exact"),
    "K = 2 - default": ("exact-128-k2-rounds-mask", "default"),
}
"""First way minus second way."""


def find_way(name: str) -> Way:
    """A way by name.

    Raises:
        UnknownNameError: there is none.
    """
    return looked_up("way", name, WAYS)
