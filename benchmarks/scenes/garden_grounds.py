"""The garden under and behind its things. All sizes in centimetres, standing on z = 0."""

from __future__ import annotations

import numpy as np

from benchmarks.scenes.alterations import plain
from scoup_lab.synthetic.art.meshes import (
    Floats,
    Mesh,
    box,
    cylinder,
    ellipsoid,
    merged,
    plane,
    rotation,
    sheet,
    smooth_curve,
    tube,
)
from scoup_lab.synthetic.art.paints import color, gradient, mix, smooth_noise, solid, spotted, wood
from scoup_lab.synthetic.art.things import Piece, Thing


def tree(seed: int, height: float) -> Thing:
    """Return a round tree, far enough away that its crown may be a few lumps."""
    rng = np.random.default_rng(seed)
    trunk = tube(
        smooth_curve([(0, 0, 0), (6, 3, height * 0.3), (0, 0, height * 0.62)], 14), np.linspace(17, 9, 14), 14
    )
    lumps = []
    for step in range(11):
        turn, level = step * 2.4, rng.uniform(0.52, 0.86)
        out = height * 0.2 * np.sqrt(rng.uniform(0.1, 1))
        size = height * rng.uniform(0.13, 0.19)
        lumps.append(
            ellipsoid((size, size, size * 0.85), (out * np.cos(turn), out * np.sin(turn), level * height), 20)
        )
    green = spotted("3f7a3a", "6fa650", 16, 0.1, seed)
    return Thing(
        "tree",
        (
            Piece("tree trunk", trunk, wood("6a4c32", 2, 8, contrast=0.3), 0.3),
            Piece("tree crown", merged(lumps), green, 0.22),
        ),
    )


def hedge(half: float, height: float, thick: float, gap: float) -> Thing:
    """Return a clipped hedge along three sides of a square of half width ``half``, open to +y, and on the
    fourth up to a ``gap`` in its middle."""
    side = (2 * half - gap) / 2
    blocks = [
        box((thick, 2 * half, height), 12, (-half, 0, height / 2)),
        box((thick, 2 * half, height), 12, (half, 0, height / 2)),
        box((2 * half + thick, thick, height), 12, (0, -half, height / 2)),
        *(box((side, thick, height), 12, (x * (half - side / 2), half, height / 2)) for x in (-1, 1)),
    ]
    return plain("hedge", Piece("", merged(blocks), spotted("2f5f30", "4f8a42", 9, 0.05), 0.15))


def shed(width: float, depth: float, height: float) -> Thing:
    """Return a wooden garden house, its door towards -y."""
    walls = box((width, depth, height), 1, (0, 0, height / 2))
    rise = width * 0.3
    slope = float(np.hypot(width / 2 + 20, rise))
    lean = float(np.degrees(np.arctan2(rise, width / 2 + 20)))
    roof = [
        box((slope, depth + 40, 7), 1, (side * slope / 2, 0, 0)).moved(
            (0, 0, height + rise - 2), rotation(y=side * lean)
        )
        for side in (-1, 1)
    ]
    edge = rise * (width / 2) / (width / 2 + 20)
    gable = [
        Mesh(
            np.array([(-width / 2, y, height - 1.0), (width / 2, y, height - 1.0), (0.0, y, height + edge)]),
            np.tile([0.0, np.sign(y), 0.0], (3, 1)),
            np.array([[0, 1, 2] if y < 0 else [0, 2, 1]]),
        )
        for y in (-depth / 2, depth / 2)
    ]
    front = -depth / 2
    door = merged(
        [
            box((86, 5, 190), 1, (-width * 0.18, front - 1, 95)),
            box((7, 7, 7), 2, (-width * 0.18 + 33, front - 6, 96)),
        ]
    )
    frame = [box((90, 4, 6), 1, (width * 0.26, front - 2, z)) for z in (100, 140, 180)] + [
        box((6, 4, 86), 1, (width * 0.26 + x, front - 2, 140)) for x in (-42, 0, 42)
    ]
    panes = box((86, 2, 82), 0.3, (width * 0.26, front - 0.6, 140))
    return Thing(
        "garden shed",
        (
            Piece(
                "shed walls", merged([walls, *gable]), wood("a9785a", 2, 8, planks=16, contrast=0.14), 0.25
            ),
            Piece("shed roof", merged(roof), wood("6a4038", 1, 10, planks=30), 0.25),
            Piece("shed door", door, solid("3f6f86", 0.05, 8), 0.4),
            Piece("shed window", merged(frame), solid("f2eee4"), 0.5),
            Piece("shed window", panes, gradient("6f8fa6", "c4dcec", 2, 100, 180), 0.4, gloss=0.6),
        ),
    )


def lawn(half: float) -> Thing:
    """Return grass on a square of half width ``half``."""

    def grass(points: Floats, normals: Floats) -> Floats:
        tone = (
            0.5
            + 0.5 * smooth_noise(points, 60, 1)
            + 0.4 * smooth_noise(points, 12, 2)
            + 0.3 * smooth_noise(points, 3, 3)
        )
        return np.clip(mix(color("4f7f36"), color("8fae52"), tone), 0, 1)

    ground = plane((-half, -half, 0), (2 * half, 0, 0), (0, 2 * half, 0), 25)
    return plain("lawn", Piece("", ground, grass, 0.16))


def paving(radius: float) -> Thing:
    """Return a round of stone slabs, a little above the ground."""

    def slabs(points: Floats, normals: Floats) -> Floats:
        distance, angle = np.hypot(points[:, 0], points[:, 1]), np.arctan2(points[:, 1], points[:, 0])
        ring = np.floor(distance / 46)
        count = np.maximum(1, np.round(ring * 6 + 3))
        place = angle / (2 * np.pi) * count + 0.5 * (ring % 2)
        joint = np.minimum(
            np.abs(place - np.round(place)) / count * 2 * np.pi * distance,
            np.abs(distance / 46 - np.round(distance / 46)) * 46,
        )
        tone = 1 + 0.1 * np.sin(np.floor(place) * 3.7 + ring * 5) + 0.08 * smooth_noise(points, 6, 2)
        return np.clip(mix(color("c2b49c"), color("7f7c66"), (2.2 - joint) * 1.2) * tone[:, None], 0, 1)

    return plain("paving", Piece("", cylinder(radius, 3, 1, 72), slabs, 0.55))


def sky(radius: float) -> Thing:
    """Return a dome of sky seen from inside, down to a little below the ground."""
    tilt, turn = np.linspace(-0.04, 1, 24) * np.pi / 2, np.arange(48) * (2 * np.pi / 48)
    ring = np.stack([np.cos(turn), np.sin(turn)], 1)
    points = np.empty((48, 24, 3))
    points[..., :2] = ring[:, None] * np.cos(tilt)[None, :, None]
    points[..., 2] = np.sin(tilt)
    dome = sheet(points * radius, closed_rows=True).flipped()

    def air(points: Floats, normals: Floats) -> Floats:
        height = points[:, 2] / radius
        cloud = smooth_noise(points, (radius * 0.3, radius * 0.3, radius * 0.09), 5)
        cloud += 0.5 * smooth_noise(points, (radius * 0.1, radius * 0.1, radius * 0.04), 6)
        clear = mix(color("dcecf6"), color("6ba6e4"), height * 1.9)
        return mix(clear, color("ffffff"), (cloud - 0.25) * 1.6)

    return plain("sky", Piece("", dome, air, 0.025, glow=1.0))
