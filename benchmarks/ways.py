"""Ways of building a field, held-out scenes, and the fields of both, for the studies of answers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from benchmarks.answer_scenes import AnswerScene, DrawName, SceneSize, make_scene
from benchmarks.data import data_folder
from benchmarks.embedding_kinds import KINDS
from benchmarks.real_scenes import REAL_SCENES
from benchmarks.study import Study
from scoup.base.errors import looked_up
from scoup.uplift.build_settings import Scale
from scoup_lab.baselines.fitted import FittedMethod
from scoup_lab.baselines.method import Method, MethodSettings
from scoup_lab.baselines.methods import METHODS
from scoup_lab.baselines.sparse import SparseUplift

DRAWS = tuple(f"kitchen-{seed}" for seed in range(11, 16))
LAYOUTS = ("table-1", "shelves-1", "hall-1", "yard-1")
WAYS = {
    "dense": METHODS["dense"],
    "paper": METHODS["paper"],
    "votes": Method("votes", SparseUplift(things=False)),
    "default": METHODS["sparse"],
    **{
        name: Method(name, SparseUplift(scale=scale))
        for scale in (1.0, 0.5, 0.35, 0.25)
        for name in [f"default at {scale:g}"]
    },
}
"""By name; "votes" is the default without things, "default at 0.5" the default with region sums at this scale."""


def scale_of(way: str) -> Scale:
    """Return the scale of the region sums that a way reads."""
    uplift = WAYS[way].uplift
    return uplift.changes.get("scale", "auto") if isinstance(uplift, SparseUplift) else 1.0


@dataclass(frozen=True, kw_only=True)
class StudyOfScenes(Study):
    """Options of studies that ask the fields of scenes."""

    scenes: tuple[str, ...] = (*DRAWS, *LAYOUTS)
    """Draws of the kitchen, layouts of benchmarks.scenes with a seed, desk and desk-all."""
    ways: tuple[str, ...] = ("dense", "default")
    """Names of WAYS; paper takes minutes a scene and seed."""
    size: SceneSize = field(default_factory=SceneSize)
    data: Path = field(default_factory=data_folder)
    """Folder that contains kitchen/ and clip/, and desk/ for its scenes."""

    def check(self) -> None:
        for name in self.ways:
            looked_up("way", name, WAYS)

    def fields(self, known: Mapping[str, Any], seed: int) -> Iterator[tuple[str, AnswerScene, FittedMethod]]:
        """Yield "way/scene", the scene and its field by a codebook seed for all that is not known."""
        for name in self.scenes:
            missing = [way for way in self.ways if f"{way}/{name}" not in known]
            if not missing:
                continue
            scene = make_scene(name, self.data, self.size)
            for way in missing:
                inputs = scene.inputs(scale=scale_of(way))
                yield f"{way}/{name}", scene, WAYS[way].uplift(inputs, MethodSettings(seed))


def nested(rows: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return rows named "a/b" as a table of tables."""
    found: dict[str, dict[str, Any]] = {}
    for key, figures in rows.items():
        first, _, second = key.partition("/")
        found.setdefault(first, {})[second] = figures
    return found


def groups_of(scenes: Sequence[str]) -> dict[str, list[str]]:
    """Group scenes by what they are: draws of the kitchen by kind and noise, the real scene, procedural layouts."""
    groups: dict[str, list[str]] = {}
    for name in scenes:
        groups.setdefault(_group_of(name), []).append(name)
    return groups


def _group_of(name: str) -> str:
    if name in REAL_SCENES:
        return "desk (real)" if name.startswith("desk") else "rendered photographs, real models"
    draw = DrawName.parse(name)
    if draw is None:
        return "procedural"
    kind = f", {KINDS[draw.kind].title}" if draw.kind else ""
    return f"kitchen draws{kind}" + (f", noise x {draw.noise:g}" if draw.noise != 1 else "")
