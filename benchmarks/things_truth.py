"""The truth of `python -m benchmarks things`: instances of scenes, and relations of their boxes.

The rules here are independent of ``scoup.query.relations``: they know whole meshes and the true up (for the kitchen,
the Gaussians that were labelled by hand), and keep only clear cases. What is neither clearly true nor clearly false is
None.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import KDTree

from benchmarks.kitchen_draws import NOT_ASKED, Truth
from scoup.scene import Camera
from scoup_lab.synthetic.scene import DemoScene

RIGHT, UP, AWAY = range(3)
LEAST = 20  # Gaussians of an instance
TOUCHING, APART = 0.015, 0.1
"""Metres between the bottom of a thing and the top of what it is on, or clearly not on."""
MOSTLY = 0.9  # share of a footprint
STRAYS = 0.02  # share of a hand-labelled object's Gaussians beyond each end of its box

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Instances:
    """The objects of a scene, each instance of a name by itself."""

    names: tuple[str, ...]  # of T instances
    of_gaussian: NDArray[np.int64]  # [N], -1 for haze
    vertices: list[Floats]  # [V, 3] of each
    shell: tuple[bool, ...]  # walls and the like, which enclose the scene
    strays: float = 0.0  # share of the vertices beyond each end of a box

    @classmethod
    def of_kitchen(cls, truth: Truth) -> Instances:
        """The objects of the kitchen; those that nobody asks for are named "" and have no relations."""
        asked = [number for number, name in truth.names.items() if name and name not in NOT_ASKED]
        names = tuple((truth.names[number] or "") if number in asked else "" for number in truth.names)
        of_gaussian = np.full(len(truth.ids), -1)
        for place, number in enumerate(truth.names):
            of_gaussian[truth.ids == number] = place
        means = truth.gaussians.means.double().numpy()
        vertices = [means[of_gaussian == place] for place in range(len(names))]
        return cls(names, of_gaussian, vertices, tuple(name in ("", "wall") for name in names), STRAYS)

    @classmethod
    def of(cls, scene: DemoScene) -> Instances:
        """Gaussians of a name that several things have belong to the nearest of these."""
        things = scene.layout.things()
        vertices = [
            np.concatenate([thing.mesh(piece).vertices for piece in thing.pieces]) for thing in things
        ]
        objects = scene.parts.at_level(scene.part_of_gaussian.numpy(), "m")
        names = tuple(thing.name for thing in things)
        of_gaussian = np.full(len(objects), -1)
        for number, name in enumerate(scene.parts.objects):
            rows, alike = (
                np.flatnonzero(objects == number),
                [i for i, each in enumerate(names) if each == name],
            )
            means = scene.gaussians.means[rows].double().numpy()
            distances = (
                [KDTree(vertices[i]).query(means)[0] for i in alike]
                if len(alike) > 1
                else [np.zeros(len(rows))]
            )
            of_gaussian[rows] = np.array(alike)[np.argmin(distances, 0)]
        return cls(names, of_gaussian, vertices, tuple(name in scene.layout.light.shell for name in names))

    @property
    def counts(self) -> Counter[str]:
        """How many instances of each name have Gaussians."""
        sizes = np.bincount(self.of_gaussian + 1, minlength=len(self.names) + 1)[1:]
        return Counter(name for name, size in zip(self.names, sizes, strict=True) if size >= LEAST)

    def boxes(self, axes: Floats) -> dict[str, Floats]:
        """Return the spans [3, 2] along axes [3, 3] of names with one instance that is not of the shell."""
        ends = [self.strays, 1 - self.strays]
        return {
            name: np.quantile(points @ axes.T, ends, axis=0).T
            for name, points, shell in zip(self.names, self.vertices, self.shell, strict=True)
            if self.counts[name] == 1 and self.names.count(name) == 1 and not shell
        }


def true_axes(camera: Camera) -> Floats:
    """Return right, up and away as seen from a camera in a scene whose third axis points up."""
    away = torch.as_tensor(camera.viewmat)[2, :3].double().numpy() * [1, 1, 0]
    away = away / np.linalg.norm(away)
    return np.stack([np.cross(away, [0, 0, 1]), [0, 0, 1], away])


def is_true(relation: str, one: Floats, other: Floats) -> bool | None:
    """Return whether a relation of two boxes clearly holds, clearly does not, or None."""
    if relation in ("on", "above"):
        return (_on if relation == "on" else _above)(one, other)
    return _before(one, other, RIGHT if relation == "left of" else AWAY)


def _before(one: Floats, other: Floats, axis: int) -> bool | None:
    if one[axis, 1] < other[axis, 0]:
        return True
    return False if one[axis].mean() > other[axis].mean() else None


def _overlap(one: Floats, other: Floats) -> Floats:
    """Lengths [3] of what two boxes share; negative where they are apart."""
    return np.minimum(one[:, 1], other[:, 1]) - np.maximum(one[:, 0], other[:, 0])


def _footprint(one: Floats, other: Floats) -> float:
    """The share of the footprint of the smaller box that both have."""
    sides = [RIGHT, AWAY]
    area = min(float(np.prod(np.diff(box[sides], axis=1))) for box in (one, other))
    return float(np.prod(_overlap(one, other)[sides].clip(0))) / max(area, 1e-9)


def _on(one: Floats, other: Floats) -> bool | None:
    gap = one[UP, 0] - other[UP, 1]
    if _footprint(one, other) == 0 or gap > APART or one[UP, 1] < other[UP, 0]:
        return False
    lies_over = np.prod(_overlap(one, other)[[RIGHT, AWAY]].clip(0)) >= MOSTLY * np.prod(
        np.diff(one[[RIGHT, AWAY]])
    )
    return True if lies_over and abs(gap) <= TOUCHING else None


def _above(one: Floats, other: Floats) -> bool | None:
    share = _footprint(one, other)
    if share == 0 or one[UP, 1] < other[UP].mean():
        return False
    return True if share >= MOSTLY and one[UP, 0] >= other[UP, 1] - TOUCHING else None
