"""Scans whose things and boxes are known, for the study of archives: simulated ones, and the four with real models.

A simulated scan is made without photographs, splat or vote, from the statistics of an embedding model: it has a random
half of the things of a layout. A thing has several regions. Their embeddings are that of the instance with some of its
surroundings and noise, in a few a neighbour's; the mean is that of the thing, and its norm the agreement. Parts are
things of level s, groups of level l. Some instances have no thing of level m, some have two. A third of all things are
fragments of few regions and low stability that blend two instances.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

import scoup
from benchmarks.embedding_kinds import EmbeddingKind, draw_prototypes
from benchmarks.real_scenes import ABSENT, FOLDERS, RealScene
from benchmarks.scenes import LAYOUTS
from scoup.field import NO_THING, ThingTable
from scoup.models import CANONICAL_PHRASES
from scoup.query import OrientedBox, ThingIndex
from scoup.query import Thing as ThingOfField
from scoup.query.thing_judge import shares_of
from scoup_lab.synthetic.art.things import Thing
from scoup_lab.synthetic.observe import PART_OFFSET, REGION_NOISE, SURROUNDINGS, VIEW_NOISE, noise
from scoup_lab.synthetic.words import unit

Floats = NDArray[np.float64]
EVERYDAY = 200  # further words of the table
NEIGHBOURS = 3
TWICE, FRAGMENTS = 0.1, 0.5  # shares of instances in two things, and of fragments per other thing
REGIONS, STABILITY = (3, 20), (0.7, 0.15)  # ends; mean and standard deviation
NOISE = 1.25 * float(np.hypot(VIEW_NOISE, REGION_NOISE))
TOLERANCE = 0.05  # of a box, as a share of its diagonal


@dataclass(frozen=True, eq=False)
class TrueScan:
    """A scan, and the boxes [2, 3] of the instances of each word in it."""

    name: str
    table: ThingTable
    index: ThingIndex  # of it, and the everyday words
    things: Sequence[ThingOfField]
    boxes: Mapping[str, list[Floats]]

    def contains(self, word: str, thing: int) -> bool:
        """Return whether a thing is in the box of an instance of a word."""
        place = next(each.position.numpy() for each in self.things if each.number == thing)
        return any(
            bool(((place >= box[0] - slack) & (place <= box[1] + slack)).all())
            for box in self.boxes.get(word, [])
            for slack in [TOLERANCE * np.linalg.norm(box[1] - box[0])]
        )


@dataclass(frozen=True, eq=False)
class World:
    """Words, and which of them the things of each layout are called."""

    meanings: dict[str, dict[str, str]]  # layout -> name of a thing -> word
    asked: tuple[str, ...]  # all of these words, and some that nothing is called
    everyday: tuple[str, ...]  # these and others
    vectors: dict[str, Floats]  # of the everyday words and canonical phrases

    @classmethod
    def open(cls, data: Path) -> World:
        """Open the words of the scenes with real models, in the folder of the data."""
        meanings = {}
        for layout in LAYOUTS:
            words = json.loads((data / FOLDERS[f"{layout}-real"] / "words.json").read_text())
            meanings[layout] = {name: word for word, names in words.items() for name in names}
        called = sorted({word for names in meanings.values() for word in names.values()})
        encoder = scoup.TextEncoder.open(data / "desk" / "desk_words.npz")
        asked = [*called, *(word for word in ABSENT.split(",") if word in (encoder.names or ()))]
        others = [word for word in encoder.names or () if word not in {*asked, *CANONICAL_PHRASES}]
        some = np.random.default_rng(0).permutation(len(others))[:EVERYDAY].tolist()
        everyday = [*asked, *(others[place] for place in some)]
        rows = unit(encoder.encode([*everyday, *CANONICAL_PHRASES]).double().numpy())
        vectors = dict(zip([*everyday, *CANONICAL_PHRASES], rows, strict=True))
        return cls(meanings, tuple(asked), tuple(everyday), vectors)

    def of(self, words: Sequence[str]) -> torch.Tensor:
        """Return the vectors of words, [n, D] float32."""
        return torch.from_numpy(np.stack([self.vectors[word] for word in words])).float()

    def simulate(self, kind: EmbeddingKind, count: int, seed: int) -> list[TrueScan]:
        """Return scans of all layouts in turn, with embeddings of a kind."""
        rng = np.random.default_rng([seed, 58])
        layouts = [(name, layout.things()) for name, layout in LAYOUTS.items()]
        chosen = [
            (name, [thing for thing in things if rng.random() < 0.5])
            for name, things in (layouts * count)[:count]
        ]
        named = [self.meanings[name].get(thing.name) for name, things in chosen for thing in things]
        of_name = {
            word: [number for number, own in enumerate(named) if own == word] for word in self.everyday
        }
        prototypes = draw_prototypes(kind, self.vectors, of_name, len(named), rng)
        everyday, scans = self.of(self.everyday), []
        for number, (layout, things) in enumerate(chosen):
            words = [named.pop(0) for _ in things]
            own, prototypes = prototypes[: len(things)], prototypes[len(things) :]
            maker = _Scan(things, own, kind, rng)
            maker.make()
            boxes = _boxes(zip(words, things, strict=True))
            scans.append(TrueScan(f"{layout}-{number:03}", *maker.finished(everyday), boxes))
        return scans

    def real(self, data: Path) -> list[TrueScan]:
        """Build the fields of the scenes with real models, and return them as scans."""
        encoder, scans = RealScene.open("table-real", data).encoder, []
        for layout, art in LAYOUTS.items():
            field = RealScene.open(f"{layout}-real", data).field()
            table, index = field.thing_table, ThingIndex.of_field(field, encoder)
            assert table is not None
            assert index is not None
            boxes = _boxes((self.meanings[layout].get(each.name), each) for each in art.things())
            scans.append(
                TrueScan(layout, table, index, ThingOfField.of_table(field, range(len(table))), boxes)
            )
        return scans


@dataclass(eq=False)
class _Scan:
    """A scan in the making: instances, and the things added so far. A Gaussian is of one part of one instance."""

    instances: list[Thing]
    prototypes: Floats  # [I, D]
    kind: EmbeddingKind
    rng: np.random.Generator
    levels: list[int] = field(default_factory=list)
    means: list[Floats] = field(default_factory=list)
    regions: list[int] = field(default_factory=list)
    stability: list[float] = field(default_factory=list)
    pieces: list[NDArray[np.bool_]] = field(default_factory=list)  # which parts each thing has

    def make(self) -> None:
        """Add all things."""
        self.parts = [(n, part) for n, each in enumerate(self.instances) for part in dict.fromkeys(
            piece.part for piece in each.pieces)]  # fmt: skip
        self.owners = np.array([owner for owner, _ in self.parts])
        clouds = [
            np.concatenate([self.instances[owner].mesh(piece).vertices for piece in self.instances[owner].pieces
                            if piece.part == part]) for owner, part in self.parts
        ]  # fmt: skip
        self.middles = np.stack([np.median(cloud, 0) for cloud in clouds])
        self.sizes = np.array([12 + int(400 * np.ptp(cloud, 0).max()) for cloud in clouds])
        centres = np.stack([self.middles[self.owners == n].mean(0) for n in range(len(self.instances))])
        apart = np.linalg.norm(centres[:, None] - centres, axis=2)
        self.near = apart.argsort(1)[:, 1 : NEIGHBOURS + 1]
        swallowed = self.rng.random(len(self.instances)) < self.kind.errors.swallowed
        for n in range(len(self.instances)):
            self._add_instance(n, swallowed)
        groups: dict[str, list[int]] = {}
        for n, thing in enumerate(self.instances):
            groups.setdefault(thing.group or thing.name, []).append(n)
        for members in groups.values():
            weights = np.array([self.sizes[self.owners == n].sum() for n in members])
            self._add(2, weights @ self.prototypes[members], np.isin(self.owners, members), members[0])
        for _ in range(int(FRAGMENTS * len(self.levels))):
            self._add_fragment()

    def _add_instance(self, n: int, swallowed: NDArray[np.bool_]) -> None:
        mine, base = self.owners == n, self.prototypes[n]
        for part in np.flatnonzero(mine):
            offset = noise(base.shape, PART_OFFSET if mine.sum() > 1 else 0.0, self.rng)
            self._add(0, base + offset, np.arange(len(mine)) == part, n)
        if swallowed[n]:
            return
        for other in self.near[n][:1][swallowed[self.near[n][:1]]]:
            base, mine = 0.8 * base + 0.2 * self.prototypes[other], mine | (self.owners == other)
        if self.rng.random() < TWICE:
            half = mine & (self.rng.random(len(mine)) < 0.5)
            self._add(1, base, half if half.any() else mine, n, stability=0.3)
        self._add(1, base, mine, n)

    def _add_fragment(self) -> None:
        n = int(self.rng.integers(len(self.instances)))
        other, share = int(self.rng.choice(self.near[n])), self.rng.uniform(0.2, 0.8)
        base = share * self.prototypes[n] + (1 - share) * self.prototypes[other]
        pieces = np.isin(self.owners, [n, other]) & (self.rng.random(len(self.owners)) < 0.5)
        stability, regions = self.rng.uniform(0.02, 0.4), int(self.rng.integers(1, REGIONS[0] + 1))
        pieces = pieces if pieces.any() else self.owners == n
        self._add(int(self.rng.integers(3)), base, pieces, n, regions, stability)

    def _add(
        self,
        level: int,
        base: Floats,
        pieces: NDArray[np.bool_],
        n: int,
        regions: int = 0,
        stability: float = 0,
    ) -> None:
        rng, errors = self.rng, self.kind.errors
        count = regions or int(rng.integers(*REGIONS))
        beside = self.prototypes[rng.choice(self.near[n], count)]
        share = rng.uniform(*SURROUNDINGS, (count, 1))
        share[rng.random(count) < errors.wrong] = 1.0
        factor = errors.noise * np.exp(errors.tail * rng.normal(size=(count, 1)))
        rows = (1 - share) * unit(base) + share * beside
        rows = unit(rows + noise(rows.shape, NOISE, rng) * factor)
        self.levels.append(level)
        self.means.append(rows.mean(0))
        self.regions.append(count)
        self.stability.append(float(np.clip(stability or rng.normal(*STABILITY), 0.02, 1)))
        self.pieces.append(pieces)

    def finished(self, everyday: torch.Tensor) -> tuple[ThingTable, ThingIndex, list[ThingOfField]]:
        """Return the things of the scan."""
        order = np.argsort(self.levels, kind="stable")
        levels, means = np.array(self.levels)[order], np.stack(self.means)[order]
        pieces = np.stack(self.pieces)[order].astype(np.float64)
        counts = pieces @ self.sizes
        shared = (pieces * self.sizes) @ pieces.T
        shared[(levels[:, None] == levels) & ~np.eye(len(levels), dtype=bool)] = 0
        table = ThingTable(
            torch.empty((0, 3), dtype=torch.int32),
            torch.from_numpy(levels).to(torch.uint8),
            torch.full((len(levels),), NO_THING, dtype=torch.int32),
            torch.from_numpy(unit(means)).half(),
            torch.from_numpy(np.linalg.norm(means, axis=1)).float(),
            torch.from_numpy(np.array(self.regions)[order]).int(),
            torch.from_numpy(np.sqrt(counts)).float(),
            torch.from_numpy(np.array(self.stability)[order]).float(),
        )
        pairs = torch.from_numpy(shared).float().to_sparse()
        rows, others = pairs.indices()
        shares = shares_of(rows, others, pairs.values(), len(levels))
        index = ThingIndex.of(table, everyday, torch.from_numpy(counts).float(), shares)
        middles = torch.from_numpy((pieces * self.sizes) @ self.middles / counts[:, None])
        sides, none = torch.full((3,), 0.1, dtype=torch.float64), torch.zeros(0, dtype=torch.int64)
        things = [
            ThingOfField(n, "sml"[levels[n]], None, "", None, place, OrientedBox(place, torch.eye(3).double(), sides),
                         none, None)
            for n, place in enumerate(middles)
        ]  # fmt: skip
        return table, index, things


def _boxes(named: Iterable[tuple[str | None, Thing]]) -> dict[str, list[Floats]]:
    found: dict[str, list[Floats]] = {}
    for word, thing in named:
        if word is not None:
            vertices = np.concatenate([thing.mesh(piece).vertices for piece in thing.pieces])
            found.setdefault(word, []).append(np.stack([vertices.min(0), vertices.max(0)]))
    return found
