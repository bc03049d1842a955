"""The rows of the ablation table: what is changed from a base, one thing at a time.

The base has the paper's sizes (64 atoms, 4 of them, top-4 vote, one round) with exact coding, which takes seconds, and
votes with the codes that the codebook was learned with.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

from scoup.base import UnknownNameError
from scoup_lab.baselines.method import Method
from scoup_lab.baselines.methods import METHODS
from scoup_lab.baselines.sparse import Half, SparseUplift
from scoup_lab.evaluate.rules import MaskRule
from scoup_lab.evaluate.studies.study_scene import ScoringRule


@dataclass(frozen=True)
class Ablation:
    """A row of the table."""

    name: str
    group: str
    method: Method  # rows that differ in the rule only share it
    rule: Callable[[MaskRule], ScoringRule] = ScoringRule  # from the protocol's constants
    published: str = ""  # name of the paper's row that changes the same, if any

    @property
    def is_base(self) -> bool:
        """Return whether nothing is changed."""
        return self.method is BASE and self.rule is ScoringRule


BASE = METHODS["sparse-64"]
BESIDE_EVERYDAY = partial(ScoringRule, everyday=True)


def by_mask(rule: MaskRule) -> ScoringRule:
    """Return the rule of the protocol with the level by the mean relevancy in the mask."""
    return ScoringRule(replace(rule, level_choice="mask"))


def _changed(
    name: str, group: str, dropped: Half | None = None, published: str = "", **changes: int
) -> Ablation:
    """Return a row with other codes or another vote than the base."""
    of_base = {"n_atoms": 64, "k": 4, "rounds": 1, "effort": "best"}
    uplift = SparseUplift(dropped, **{**of_base, **changes})
    return Ablation(name, group, Method(name, uplift), published=published)


_CALM, _TORN = "without the 50 % of highest entropy", "without the 50 % of lowest entropy"
ABLATIONS: tuple[Ablation, ...] = (
    Ablation("base: L=64, K=4, top-K", "vote", BASE, published="top-K (L=64, K=4)"),
    Ablation("dense uplift", "vote", METHODS["dense"], published="dense uplift"),
    Ablation("no top-K", "vote", METHODS["sparse-64-all"], published="no top-K"),
    _changed("two rounds", "vote", rounds=2),
    _changed("L=32", "atoms", published="L=32", n_atoms=32),
    _changed("L=128", "atoms", published="L=128", n_atoms=128),
    _changed("K=2", "non-zeros", published="K=2", k=2, keep=2),
    _changed("K=8", "non-zeros", published="K=8", k=8, keep=8),
    _changed(_CALM, "entropy", dropped="highest", published=_CALM),
    _changed(_TORN, "entropy", dropped="lowest", published=_TORN),
    Ablation("Adam", "solver", METHODS["paper"]),
    Ablation("level by mask", "levels", BASE, by_mask),
    Ablation("beside everyday words", "phrases", BASE, BESIDE_EVERYDAY),
)


def find_ablations(groups: Sequence[str]) -> list[Ablation]:
    """Return the base, and the rows of some groups (all, for none)."""
    known = list(dict.fromkeys(ablation.group for ablation in ABLATIONS))
    for group in groups:
        if group not in known:
            raise UnknownNameError("group of ablations", group, known)
    return [row for row in ABLATIONS if row.is_base or not groups or row.group in groups]
