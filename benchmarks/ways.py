"""Ways of building a field and groups of scenes, for the studies of answers."""

from __future__ import annotations

from collections.abc import Sequence

from benchmarks.answer_scenes import DrawName
from benchmarks.embedding_kinds import KINDS
from benchmarks.real_scenes import PHOTOGRAPHED, REAL_SCENES, place_of
from scoup_lab.baselines.method import Method
from scoup_lab.baselines.methods import METHODS
from scoup_lab.baselines.sparse import SparseUplift

DRAWS = tuple(f"kitchen-{seed}" for seed in range(11, 16))
LAYOUTS = ("table-1", "shelves-1", "hall-1", "yard-1")
WAYS = {
    "dense": METHODS["dense"],
    "paper": METHODS["paper"],
    "votes": Method("votes", SparseUplift(things=False)),
    "default": METHODS["sparse"],
}
"""By name; "votes" is the default without things."""
FULL_SIZE = ("dense", "paper")
"""Those that read region sums of whole images."""


def groups_of(scenes: Sequence[str]) -> dict[str, list[str]]:
    """Group scenes by what they are: draws of the kitchen by kind and noise, the real scene, procedural layouts."""
    groups: dict[str, list[str]] = {}
    for name in scenes:
        groups.setdefault(_group_of(name), []).append(name)
    return groups


def _group_of(name: str) -> str:
    if name in REAL_SCENES:
        place = place_of(name)
        return f"{place} (real)" if place in PHOTOGRAPHED else "rendered photographs, real models"
    draw = DrawName.parse(name)
    if draw is None:
        return "procedural"
    kind = f", {KINDS[draw.kind].title}" if draw.kind else ""
    return f"kitchen draws{kind}" + (f", noise x {draw.noise:g}" if draw.noise != 1 else "")
