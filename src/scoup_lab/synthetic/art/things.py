"""Things: what a scene is made of, their pieces, and where they are."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from scoup.base import InputError
from scoup_lab.synthetic.art.meshes import Floats, Mesh, merged
from scoup_lab.synthetic.art.paints import Paint


@dataclass(frozen=True, eq=False)
class Piece:
    """A painted mesh in the frame of its thing, in centimetres."""

    part: str  # the name of the part it belongs to; pieces of one part share it
    mesh: Mesh  # its surface
    paint: Paint  # its colours
    detail: float = 1.0  # Gaussians per area, as a multiple of the average
    # the largest standard deviation of a Gaussian on it, in centimetres; small for wires and rims
    thin: float = np.inf
    gloss: float = 0.0  # strength of the highlight, 0..1
    glow: float = 0.0  # share of its own light, 0 (none) to 1 (a lamp)


@dataclass(frozen=True, eq=False)
class Thing:
    """An object: what a person would point at and name."""

    name: str  # unique in the scene unless it is one of ``several``
    pieces: tuple[Piece, ...]  # what it is made of
    group: str = ""  # the larger whole it belongs to; empty if it is a group of its own
    turn: Floats = field(default_factory=lambda: np.eye(3))  # [3, 3] rotation
    place: Floats = field(default_factory=lambda: np.zeros(3))  # [3] position in metres
    size: float = 0.01  # metres per centimetre of the pieces
    # whether other things may have its name and then are the same object, such as four chairs
    several: bool = False

    def mesh(self, piece: Piece) -> Mesh:
        """Return the mesh of a piece where the thing is, in metres."""
        return piece.mesh.moved(self.place, self.turn, self.size)


@dataclass(frozen=True, eq=False)
class Parts:
    """The names at three levels and how they nest. Numbers run from 0 in the order of first appearance."""

    # parts, objects, groups: names, unique at their level
    parts: tuple[str, ...]
    objects: tuple[str, ...]
    groups: tuple[str, ...]
    object_of_part: np.ndarray  # [parts] int64 number of the object that a part belongs to
    group_of_object: np.ndarray  # [objects] int64
    several: frozenset[str] = frozenset()  # the objects that are several things of one name

    @classmethod
    def of(cls, things: tuple[Thing, ...]) -> Parts:
        """Return numbers for everything in ``things``."""
        groups = tuple(dict.fromkeys(thing.group or thing.name for thing in things))
        objects = {thing.name: thing.group or thing.name for thing in things}
        numbers = {name: number for number, name in enumerate(objects)}
        owners: dict[str, int] = {}
        for thing in things:
            for piece in thing.pieces:
                if owners.setdefault(piece.part, numbers[thing.name]) != numbers[thing.name]:
                    raise InputError(f"{piece.part!r} names parts of two things")
            if objects[thing.name] != (thing.group or thing.name):
                raise InputError(f"things called {thing.name!r} belong to different groups")
            members = [other.name for other in things if (other.group or other.name) == thing.name]
            inside = {piece.part for piece in thing.pieces}
            if (thing.name in inside and len(inside) > 1) or set(members) - {thing.name}:
                raise InputError(
                    f"{thing.name!r} names an object and also a part or a group that differs from it"
                )
        named = Counter(thing.name for thing in things)
        alone = Counter(thing.name for thing in things if not thing.several)
        if any(named[name] > 1 for name in alone) or set(groups) & (set(owners) - set(objects)):
            raise InputError("two things share a name")
        return cls(
            tuple(owners),
            tuple(objects),
            groups,
            np.array(list(owners.values())),
            np.array([groups.index(group) for group in objects.values()]),
            frozenset(name for name, count in named.items() if count > 1),
        )

    def at_level(self, parts: np.ndarray, level: str) -> np.ndarray:
        """Return part numbers (any shape, -1 = nothing) as numbers of level "s" (parts), "m" (objects) or
        "l" (groups)."""
        lookup = np.arange(len(self.parts))
        if level != "s":
            lookup = self.object_of_part
        if level == "l":
            lookup = self.group_of_object[lookup]
        return np.append(lookup, -1)[parts]

    def names(self, level: str) -> tuple[str, ...]:
        return {"s": self.parts, "m": self.objects, "l": self.groups}[level]


@dataclass(frozen=True, eq=False)
class Surface:
    """All things as one mesh, in metres."""

    mesh: Mesh  # the triangles
    part_of_face: np.ndarray  # [F] int64 part numbers

    @classmethod
    def of(cls, things: tuple[Thing, ...], parts: Parts) -> Surface:
        meshes = [
            (thing.mesh(piece), parts.parts.index(piece.part)) for thing in things for piece in thing.pieces
        ]
        return cls(
            merged([mesh for mesh, _ in meshes]),
            np.concatenate([np.full(len(mesh.faces), part) for mesh, part in meshes]),
        )
