"""The ways compared by benchmarks/voting.py: how regions are coded, how Gaussians vote, how a level is chosen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import torch
from torch import Tensor

from scoup.base.errors import InputError, UnknownNameError
from scoup.coding import fit_codes
from scoup.query.presets import QUERY_PRESETS, LevelChoice
from scoup.scene.codes import SparseCodes
from scoup.synthetic.faults import LevelSums
from scoup.uplift import vote as uplift
from scoup.uplift.build_settings import BUILD_PRESETS, BuildSettings
from scoup.uplift.consensus import consensus_of
from scoup.uplift.region_sums import RegionSums


@dataclass(frozen=True)
class Recipe:
    """How region embeddings become something a Gaussian keeps.

    Attributes:
        coding: solver of ``fit_codes``, or "dense" for full embeddings.
        epochs: of "adam"; 0 for the others.
        n_atoms, k: L and K.
        keep: atoms of a Gaussian; None keeps all.
        consensus: regions seen by the same Gaussians agree before they are coded (``scoup.uplift.consensus``).
        rounds: of the vote (``scoup.uplift.reweighting``).
        effort: of "exact".
    """

    coding: Literal["dense", "adam", "exact"]
    epochs: int = 0
    n_atoms: int = 64
    k: int = 4
    keep: int | None = 4
    consensus: bool = False
    rounds: int = 1
    effort: str = "best"

    @classmethod
    def of(cls, settings: BuildSettings) -> Recipe:
        """What ``build`` does with these settings."""
        if settings.solver == "exact":
            coding, epochs = "exact", 0
        elif settings.solver == "adam":
            coding, epochs = "adam", settings.epochs
        else:
            raise InputError(f"no recipe for the solver {settings.solver!r}")
        return cls(
            coding,
            epochs,
            settings.n_atoms,
            settings.k,
            settings.keep or None,
            settings.consensus,
            settings.rounds,
            settings.effort,
        )

    @property
    def key(self) -> str:
        """Tells recipes apart in the results on disk."""
        if self.coding == "dense":
            return "dense"
        keep = "all" if self.keep is None else self.keep
        coding = "exact fast" if (self.coding, self.effort) == ("exact", "fast") else self.coding
        name = f"{coding}{self.epochs or ''} L{self.n_atoms} K{self.k} keep {keep}"
        return (
            name + (" consensus" if self.consensus else "") + (f" rounds {self.rounds}" * (self.rounds > 1))
        )

    @property
    def coded_once(self) -> Recipe:
        """The recipe up to the vote: recipes that share it share their codes."""
        return replace(self, keep=4, rounds=1)


@dataclass(frozen=True)
class Way:
    """A recipe, and how the level of a mask is chosen."""

    recipe: Recipe
    level_choice: LevelChoice = "peak"


DENSE = Recipe("dense")
PAPER = Recipe.of(BUILD_PRESETS["paper"])
PAPER_128 = replace(PAPER, n_atoms=128)
EXACT = Recipe("exact")
EXACT_128 = replace(EXACT, n_atoms=128)
WAYS: dict[str, Way] = {
    "dense": Way(DENSE),
    "dense-mask": Way(DENSE, "mask"),
    "paper": Way(PAPER),
    "paper-no-top-k": Way(replace(PAPER, keep=None)),
    "paper-128": Way(PAPER_128),
    "paper-128-rounds-mask": Way(replace(PAPER_128, rounds=2), "mask"),
    "exact": Way(EXACT),
    "exact-no-top-k": Way(replace(EXACT, keep=None)),
    "exact-mask": Way(EXACT, "mask"),
    "exact-128": Way(EXACT_128),
    "exact-128-mask": Way(EXACT_128, "mask"),
    "exact-rounds": Way(replace(EXACT, rounds=2)),
    "exact-128-rounds": Way(replace(EXACT_128, rounds=2)),
    "exact-128-rounds-mask": Way(replace(EXACT_128, rounds=2), "mask"),
    "exact-128-rounds-3": Way(replace(EXACT_128, rounds=3)),
    "exact-128-rounds-3-mask": Way(replace(EXACT_128, rounds=3), "mask"),
    "exact-32": Way(replace(EXACT, n_atoms=32)),
    "exact-256": Way(replace(EXACT, n_atoms=256)),
    "exact-k2": Way(replace(EXACT, k=2, keep=2)),
    "exact-k8": Way(replace(EXACT, k=8, keep=8)),
    "exact-128-k2-rounds-mask": Way(replace(EXACT_128, k=2, keep=2, rounds=2), "mask"),
    "exact-128-k2-keep-4-rounds-mask": Way(replace(EXACT_128, k=2, keep=4, rounds=2), "mask"),
    "exact-128-k1-keep-4-rounds-mask": Way(replace(EXACT_128, k=1, keep=4, rounds=2), "mask"),
    "exact-consensus": Way(replace(EXACT, consensus=True)),
    "exact-consensus-mask": Way(replace(EXACT, consensus=True), "mask"),
    "default": Way(Recipe.of(BUILD_PRESETS["default"]), QUERY_PRESETS["default"].level_choice),
}
"""By name. "paper" is the published method; "default" is what ``scoup build`` and ``scoup query`` do unasked."""

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
    "consensus - none": ("exact-consensus", "exact"),
    "default - dense": ("default", "dense"),
    "default - dense-mask": ("default", "dense-mask"),
    "default - paper": ("default", "paper"),
    "default - exact": ("default", "exact"),
    "K = 2 - default": ("exact-128-k2-rounds-mask", "default"),
}
"""First way minus second way."""


def find_way(name: str, epochs: int) -> Way:
    """A way by name, with so many epochs wherever it uses "adam".

    Raises:
        UnknownNameError: there is none.
    """
    if name not in WAYS:
        raise UnknownNameError("way", name, WAYS)
    way = WAYS[name]
    if way.recipe.coding == "adam":
        return replace(way, recipe=replace(way.recipe, epochs=epochs))
    return way


def code(levels: Sequence[LevelSums], recipe: Recipe, seed: int) -> tuple[list[SparseCodes], Tensor]:
    """Codes of the regions of each level, and the codebook [S, L, D]."""
    books = []
    for level in levels:
        rows = level.embeddings
        if recipe.consensus:
            rows = consensus_of(level.matrix, rows)
        books.append(
            fit_codes(
                rows,
                recipe.n_atoms,
                recipe.k,
                recipe.coding,
                seed,
                epochs=recipe.epochs,
                effort=recipe.effort,
            )
        )
    return [book.codes for book in books], torch.stack([book.atoms for book in books])


def vote(
    sums: RegionSums, codes: Sequence[SparseCodes], codebook: Tensor, recipe: Recipe
) -> tuple[Tensor, Tensor]:
    """Indices and weights [N, S, K] as a field stores them, from the codes of all regions."""
    found = uplift.vote(sums, codes, codebook, recipe.rounds, recipe.keep, recipe.keep or recipe.k)
    return found.indices, found.weights.half()


def bytes_per_gaussian(recipe: Recipe, n_levels: int, dim: int) -> float:
    """What a Gaussian keeps, all levels, without the codebook."""
    if recipe.coding == "dense":
        return 4.0 * n_levels * dim
    if recipe.keep is None:  # the indices need not be stored
        return 2.0 * n_levels * recipe.n_atoms
    return (2.0 + (1 if recipe.n_atoms <= 256 else 2)) * n_levels * recipe.keep
