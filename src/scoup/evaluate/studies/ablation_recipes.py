"""The rows of the ablation table: what is changed from a base recipe, one thing at a time.

The base has the paper's sizes (64 atoms, 4 of them, top-4 vote, one round) with exact coding, which takes seconds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

from scoup.base.errors import UnknownNameError

Start = Literal["k-means", "random regions", "random directions"]


@dataclass(frozen=True)
class Recipe:
    """From regions to something that can be asked.

    Attributes:
        coding: "dense" keeps embeddings.
        n_atoms, k: L and K.
        keep: atoms of a Gaussian; None keeps all.
        rounds: of the vote.
        start: of the codebook, of "adam" only.
        logit_scale: of "adam": first logits are this times the cosine to each atom; 0 starts all equal.
        dropped: Gaussians whose votes' entropy is in that half lose their code.
        views: share of the views, spread evenly.
        stride: every so manyth pixel of every so manyth row counts.
    """

    coding: Literal["dense", "exact", "adam"] = "exact"
    n_atoms: int = 64
    k: int = 4
    keep: int | None = 4
    rounds: int = 1
    start: Start = "k-means"
    logit_scale: float = 4.0
    dropped: Literal["highest", "lowest"] | None = None
    views: float = 1.0
    stride: int = 1

    @property
    def coded_once(self) -> Recipe:
        """The recipe up to the vote: recipes that share it share their codes."""
        return replace(self, keep=4, rounds=1, dropped=None, stride=1)


@dataclass(frozen=True)
class Ablation:
    """A row of the table.

    Attributes:
        name, group: for people.
        recipe: see there.
        rule: how the level is chosen: as the protocol does; by "peak", by "mask"; or only one level is asked; or, with
            "everyday", asked beside everyday words and chosen as the protocol does.
        published: name of the paper's row that asks the same, if any.
    """

    name: str
    group: str
    recipe: Recipe
    rule: Literal["protocol", "peak", "mask", "s", "m", "l", "everyday"] = "protocol"
    published: str = ""


BASE = Recipe()
ABLATIONS: tuple[Ablation, ...] = (
    Ablation("base: L=64, K=4, top-K", "vote", BASE, published="top-K (L=64, K=4)"),
    Ablation("dense uplift", "vote", Recipe("dense"), published="dense uplift"),
    Ablation("no top-K", "vote", replace(BASE, keep=None), published="no top-K"),
    Ablation("two rounds", "vote", replace(BASE, rounds=2)),
    Ablation("two rounds, no top-K", "vote", replace(BASE, rounds=2, keep=None)),
    Ablation("L=32", "atoms", replace(BASE, n_atoms=32), published="L=32"),
    Ablation("L=128", "atoms", replace(BASE, n_atoms=128), published="L=128"),
    Ablation("K=2", "non-zeros", replace(BASE, k=2, keep=2), published="K=2"),
    Ablation("K=8", "non-zeros", replace(BASE, k=8, keep=8), published="K=8"),
    Ablation(
        "without the 50 % of highest entropy",
        "entropy",
        replace(BASE, dropped="highest"),
        published="without the 50 % of highest entropy",
    ),
    Ablation(
        "without the 50 % of lowest entropy",
        "entropy",
        replace(BASE, dropped="lowest"),
        published="without the 50 % of lowest entropy",
    ),
    Ablation("Adam", "solver and start", replace(BASE, coding="adam")),
    Ablation(
        "Adam, from random regions", "solver and start", replace(BASE, coding="adam", start="random regions")
    ),
    Ablation(
        "Adam, from random directions",
        "solver and start",
        replace(BASE, coding="adam", start="random directions"),
    ),
    Ablation("Adam, equal logits", "solver and start", replace(BASE, coding="adam", logit_scale=0.0)),
    Ablation("only level s", "levels", BASE, "s"),
    Ablation("only level m", "levels", BASE, "m"),
    Ablation("only level l", "levels", BASE, "l"),
    Ablation("level by peak", "levels", BASE, "peak"),
    Ablation("level by mask", "levels", BASE, "mask"),
    Ablation("beside everyday words", "phrases", BASE, "everyday"),
    Ablation("1/8 of the views", "views", replace(BASE, views=0.125)),
    Ablation("1/4 of the views", "views", replace(BASE, views=0.25)),
    Ablation("1/2 of the views", "views", replace(BASE, views=0.5)),
    Ablation("every 2nd pixel", "pixels", replace(BASE, stride=2)),
    Ablation("every 4th pixel", "pixels", replace(BASE, stride=4)),
    Ablation("every 8th pixel", "pixels", replace(BASE, stride=8)),
)


def find_ablations(groups: Sequence[str]) -> list[Ablation]:
    """The base, and the rows of some groups (all, for none).

    Raises:
        UnknownNameError: there is no such group.
    """
    known = list(dict.fromkeys(ablation.group for ablation in ABLATIONS))
    for group in groups:
        if group not in known:
            raise UnknownNameError("group of ablations", group, known)
    return [
        each
        for each in ABLATIONS
        if (each.recipe == BASE and each.rule == "protocol") or not groups or each.group in groups
    ]
