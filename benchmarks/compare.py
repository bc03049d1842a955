"""Changes between two captures of one place, against what truly changed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

import scoup
from benchmarks.data import data_folder
from benchmarks.real_scenes import RealScene
from benchmarks.scenes import LAYOUTS, field_of, find_layout
from benchmarks.study import Record, Study
from benchmarks.things_truth import Instances
from scoup.query import compare
from scoup.query.comparison import Change, Comparison, Kind
from scoup_lab.bench import markdown
from scoup_lab.synthetic.art.layout import Layout
from scoup_lab.synthetic.art.meshes import Floats
from scoup_lab.synthetic.art.things import Thing
from scoup_lab.synthetic.scene import DemoScene, make_demo_scene

Shifts = Mapping[int, Floats]
"""Number of a thing -> [3] metres."""
AWAY = np.array([0.0, 0.0, -1000.0])  # metres, where no camera sees it
OF_EACH = 3  # things that are removed, added, moved
SIZES = (0.06, 0.9)  # metres: diagonals of these things
MOVES = (0.5, 4.0)  # sizes of a thing that it moves
SIZES_OF_VIEWS = 360, 270, 18, 0  # pixels, and views with and without regions
PART = 0.4  # of the path of cameras
LEAST_VIEWS, LEAST_PIXELS = 3, 75  # in which a thing that changes is visible
KINDS: tuple[Kind, ...] = ("removed", "added", "moved")


@dataclass(frozen=True, kw_only=True)
class Compare(Study):
    """Compare pairs of captures of simulated places, and parts of the views of scenes with real models.

    Pairs of a layout with a seed: three things removed, three added, up to three moved; the same changes, with the
    later capture from a part of the path of the cameras, where only false changes count; nothing changed. No camera is
    in both captures, and splat, masks and embeddings are drawn again. Scenes with real models: every other view, and
    both halves of the path; nothing changed. The constants of scoup.query.comparison were tuned on the seed 100 and on
    table-real.
    """

    scenes: tuple[str, ...] = tuple(f"{layout}-{seed}" for seed in (0, 1) for layout in LAYOUTS)
    """Layouts of benchmarks.scenes with a seed."""
    n_gaussians: int = 40_000
    """Of a capture."""
    real: tuple[str, ...] = ("desk", "shelves-real", "hall-real", "yard-real")
    """Scenes with real models."""
    data: Path = field(default_factory=data_folder)
    """Folder of the scenes with real models."""

    def measure(self, known: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        for name in self.scenes:
            if name not in known:
                yield name, of_layout(name, self.n_gaussians)
        for name in self.real:
            if name not in known:
                yield name, of_real(name, self.data)

    @staticmethod
    def table(record: Record) -> str:
        """Return precision, recall and false changes, over the pairs of each sort."""
        rows, body = record["rows"].values(), []
        for pair in PAIRS:
            pairs = [row[pair] for row in rows if pair in row]
            known = any(of[kind][2] for of in pairs for kind in KINDS)
            for kinds in [(kind,) for kind in KINDS] if known else [KINDS]:
                right, reported, true = (
                    sum(of[kind][place] for of in pairs for kind in kinds) for place in range(3)
                )
                title = " or ".join(kinds)
                found = f"{right} of {true}" if known else ""
                body.append([f"{pair} ({len(pairs)})", title, f"{right} of {reported}", found])
        return markdown(["pairs of captures", "reported as", "right", "of the true ones found"], body)


PAIRS = (
    "changed",
    "changed, seen in part",
    "unchanged",
    "real models, every other view",
    "real models, halves of the path",
)


@dataclass(frozen=True, eq=False)
class ChangedLayout(Layout):
    """A layout whose things are shifted."""

    shifts: Shifts = field(default_factory=dict)

    def things(self) -> tuple[Thing, ...]:
        """Return the things where they are now."""
        return tuple(
            replace(thing, place=thing.place + self.shifts.get(number, 0))
            for number, thing in enumerate(super().things())
        )

    def seen(self, part: float = 1.0, between: bool = False) -> ChangedLayout:
        """Return the layout with the cameras of the first part of its path, or with those between these."""
        path = self.path
        return replace(self, path=lambda step, count, _, rng: path(step, round(count / part), between, rng))


@dataclass(frozen=True)
class Truth:
    """The numbers of the things that changed."""

    removed: frozenset[int] = frozenset()
    added: frozenset[int] = frozenset()
    moved: frozenset[int] = frozenset()


def of_layout(name: str, n_gaussians: int) -> Record:
    """Return right, reported and true changes of each kind, for each sort of pair of a layout."""
    kind, _, seed = name.rpartition("-")
    layout = find_layout(kind)
    before, after, truth = drawn_changes(layout.things(), np.random.default_rng([int(seed), 58]))

    def capture(shifts: Shifts, more: int, part: float = 1.0) -> tuple[DemoScene, scoup.LanguageField]:
        scene = changed_scene(layout, int(seed), n_gaussians, shifts, more, part)
        return scene, field_of(scene)

    old = capture(before, 0)
    # Another number of Gaussians, so that no draw of the splat is the same.
    pairs = {
        "changed": (after, 1000, 1.0),
        "changed, seen in part": (after, 1001, PART),
        "unchanged": (before, 1002, 1.0),
    }
    found = {}
    for pair, of in pairs.items():
        new = capture(*of)
        expected = Truth() if pair == "unchanged" else truth
        found[pair] = scored(
            compare(old[1], new[1], old[0].words.texts), old[0], new[0], expected, "part" in pair
        )
    return found


def changed_scene(
    layout: Layout, seed: int, n_gaussians: int, shifts: Shifts, more: int, part: float = 1.0
) -> DemoScene:
    """Return the scene of a layout with things shifted, with ``more`` Gaussians from other cameras."""
    changed = ChangedLayout(**vars(layout), shifts=shifts).seen(part, between=bool(more))
    return make_demo_scene(seed, n_gaussians + more, *SIZES_OF_VIEWS, layout=changed)


def drawn_changes(
    things: tuple[Thing, ...], rng: np.random.Generator, of_each: int = OF_EACH
) -> tuple[Shifts, Shifts, Truth]:
    """Draw the things that are removed, added and moved, which is sideways, to where no other small thing is; return
    the shifts of the old and of the new capture, and these changes."""
    boxes = [np.concatenate([thing.mesh(piece).vertices for piece in thing.pieces]) for thing in things]
    boxes = np.stack([[each.min(0), each.max(0)] for each in boxes])
    sizes = np.linalg.norm(boxes[:, 1] - boxes[:, 0], axis=1)
    small = (sizes >= SIZES[0]) & (sizes <= SIZES[1])
    order = [
        number for number in rng.permutation(np.flatnonzero(small)).tolist() if not things[number].several
    ]
    removed, added, moves = order[:of_each], order[of_each : 2 * of_each], dict[int, Floats]()
    for number in order[2 * of_each :]:
        if len(moves) == of_each:
            break
        for _ in range(50):
            turn, far = rng.uniform(0, 2 * np.pi), rng.uniform(*MOVES) * sizes[number]
            shift = far * np.array([np.cos(turn), np.sin(turn), 0])
            others = boxes[small & (np.arange(len(things)) != number)]
            apart = (boxes[number, 0] + shift > others[:, 1]) | (boxes[number, 1] + shift < others[:, 0])
            if apart.any(1).all():
                moves[number] = shift
                break
    truth = Truth(frozenset(removed), frozenset(added), frozenset(moves))
    return dict.fromkeys(added, AWAY), dict.fromkeys(removed, AWAY) | moves, truth


def scored(found: Comparison, old: DemoScene, new: DemoScene, truth: Truth, in_part: bool) -> Record:
    """Return [right, reported, true] of each kind of change; what a part of the path does not show is not known.

    A thing that moved to, or from, where no camera sees it was removed, or added.
    """
    owners = Instances.of(old).of_gaussian, Instances.of(new).of_gaussian
    of_old, of_new = (
        {number for number in truth.removed | truth.added | truth.moved if _is_visible(scene, number)}
        for scene in (old, new)
    )
    places: dict[Kind, tuple[frozenset[int], set[int]]] = {
        "removed": (truth.removed | truth.moved - of_new, of_old),
        "added": (truth.added | truth.moved - of_old, of_new),
        "moved": (truth.moved, of_old & of_new),
    }
    figures: Record = {}
    for kind, (true, visible) in places.items():
        reported = [_instances(change, owners) for change in found.changes if change.kind == kind]
        right = {numbers.pop() for numbers in reported if len(numbers) == 1 and numbers <= true}
        figures[kind] = [len(right), len(reported), 0 if in_part else len(true & visible | right)]
    return figures


def _instances(change: Change, owners: tuple[np.ndarray, np.ndarray]) -> set[int]:
    """Return the true things that most Gaussians of a change are of, one for each capture that has it."""
    found = set()
    for thing, of_gaussian in zip((change.old, change.new), owners, strict=True):
        if thing is not None:
            counts = np.bincount(of_gaussian[thing.gaussians.numpy()] + 1)
            found.add(int(counts.argmax()) - 1 if counts.max() * 2 > counts.sum() else -1)
    return found


def _is_visible(scene: DemoScene, number: int) -> bool:
    place = scene.parts.objects.index(scene.layout.things()[number].name)
    shown = [(scene.parts.at_level(of, "m") == place).sum() for of in scene.part_maps.values()]
    return sum(each >= LEAST_PIXELS for each in shown) >= LEAST_VIEWS


def of_real(name: str, data: Path) -> Record:
    """Return the changes, all false, between fields of parts of the views of a scene with real models."""
    scene = RealScene.open(name, data)
    cameras = scene.cameras
    half = len(cameras) // 2
    halves = {PAIRS[3]: (cameras[::2], cameras[1::2]), PAIRS[4]: (cameras[:half], cameras[half:])}
    words = list(scene.encoder.names or ())
    return {
        pair: false_changes(compare(scene.field(some), scene.field(others), words))
        for pair, (some, others) in halves.items()
    }


def false_changes(found: Comparison) -> Record:
    """Return the changes of captures between which nothing changed, as ``scored``."""
    return {kind: [0, sum(change.kind == kind for change in found.changes), 0] for kind in KINDS}
