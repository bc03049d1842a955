"""Things in a large room besides furniture. All sizes in centimetres, the back at y = 0, facing -y."""

from __future__ import annotations

import numpy as np

from scoup_lab.synthetic.art.desk_things import landscape
from scoup_lab.synthetic.art.meshes import (
    Floats,
    Mesh,
    box,
    cylinder,
    ellipsoid,
    lathe,
    merged,
    rotation,
    sheet,
    smooth_curve,
    tube,
)
from scoup_lab.synthetic.art.paints import bands, color, gradient, mix, smooth_noise, solid, wood
from scoup_lab.synthetic.art.things import Piece, Thing


def floor_lamp() -> Thing:
    shade = lathe(
        [(26, 122), (17, 150), (17, 150), (16.6, 150), (16.6, 150), (25.6, 122), (25.6, 122), (26, 122)], 40
    )
    stem = cylinder(1.6, 140, segments=16)
    bulb = ellipsoid(4.5, (0, 0, 137), 16)
    return Thing(
        "floor lamp",
        (
            Piece("floor lamp base", cylinder(15, 3, 1), solid("3a3430"), 1.2, 0.7, gloss=0.4),
            Piece("floor lamp stem", stem, solid("b08a48"), 1.4, 0.5, gloss=0.7),
            Piece("floor lamp shade", shade, solid("f3dca6", 0.03), 1.0, 0.8, glow=0.45),
            Piece("floor lamp bulb", bulb, solid("fff2c0"), 1.2, 0.5, glow=1.0),
        ),
    )


def television(width: float) -> Thing:
    """Return a flat screen on a foot."""
    height = width * 0.58

    def shown(points: Floats, normals: Floats) -> Floats:
        return landscape(points[:, 0] / width + 0.5, (points[:, 2] - 8) / height)

    rim = box((width, 4, height), 0.8, (0, -14, height / 2 + 8))
    foot = merged([box((width * 0.4, 20, 1.6), 0.5, (0, -14, 0.8)), box((8, 3, 9), 0.5, (0, -13, 5))])
    return Thing(
        "television",
        (
            Piece(
                "television screen",
                box((width - 5, 1.6, height - 5), 0.2, (0, -17.0, height / 2 + 8)),
                shown,
                1.0,
                glow=0.85,
            ),
            Piece("television frame", merged([rim, foot]), solid("1c1d20", 0.02), 0.8, 0.7, gloss=0.5),
        ),
    )


def fireplace() -> Thing:
    def stone(points: Floats, normals: Floats) -> Floats:
        row = np.floor(points[:, 2] / 11)
        shifted = points[:, 0] / 24 + 0.5 * (row % 2)
        joint = np.minimum(
            np.abs(shifted - np.round(shifted)) * 24,
            np.abs(points[:, 2] / 11 - np.round(points[:, 2] / 11)) * 11,
        )
        tone = 1 + 0.12 * smooth_noise(points, 7, 3) + 0.1 * np.sin(np.floor(shifted) * 5 + row * 3)
        return np.clip(mix(color("a8553c"), color("d9cbb8"), (0.9 - joint) * 3) * tone[:, None], 0, 1)

    piers = [box((34, 34, 96), 0.8, (side * 55, -17, 48)) for side in (-1, 1)]
    lintel = box((144, 34, 26), 0.8, (0, -17, 108))
    inside = box((78, 5, 97), 0.3, (0, -3, 48))
    hearth = box((160, 50, 5), 0.8, (0, -25, 2.5))
    logs = [tube([(-24, -18 + 9 * k, 10), (24, -16 + 7 * k, 10 + k)], 4.2, 12) for k in range(2)] + [
        tube([(-18, -12, 17), (17, -18, 19)], 3.6, 12)
    ]
    flames = [
        lathe(smooth_curve([(0.01, 0), (4.5, 5), (3.4, 13), (0.01, size)], 14), 14).moved((x, -14, 16))
        for x, size in ((-14, 24), (-4, 34), (7, 29), (16, 20))
    ]

    def burning(points: Floats, normals: Floats) -> Floats:
        return mix(color("fff0a0"), color("ff7a1a"), (points[:, 2] - 18) / 24)

    return Thing(
        "fireplace",
        (
            Piece("fireplace bricks", merged([*piers, lintel]), stone, 0.8),
            Piece("hearth", hearth, solid("77716a", 0.1, 5), 0.7),
            Piece("fireplace bricks", inside, solid("2e2622", 0.2), 0.6),
            Piece("mantel", box((172, 42, 7), 1.2, (0, -20, 124.5)), wood("6d4528", 0, 5), 0.7),
            Piece("logs", merged(logs), wood("4f3420", 0, 3), 1.2, 0.8),
            Piece("fire", merged(flames), burning, 1.6, 0.7, glow=1.0),
        ),
    )


def tall_clock() -> Thing:
    """Return a grandfather clock."""

    def dial(points: Floats, normals: Floats) -> Floats:
        x, z = points[:, 0], points[:, 2] - 178
        radius, angle = np.hypot(x, z), np.arctan2(x, z)
        ticks = (np.abs(np.mod(angle * 6 / np.pi + 0.5, 1) - 0.5) < 0.12) & (radius > 11) & (radius < 14.5)
        hand = (np.abs(x - 0.4 * z) < 1.0) & (z > 0) & (radius < 10) | (np.abs(z) < 0.9) & (x > 0) & (
            radius < 7.5
        )
        return np.where((ticks | hand)[:, None], color("22262c"), color("f6efdc"))

    case = merged(
        [
            box((50, 30, 42), 1, (0, -15, 21)),
            box((36, 24, 110), 1, (0, -13, 96)),
            box((48, 28, 50), 1, (0, -14, 176)),
            box((56, 32, 6), 1.6, (0, -15, 204)),
        ]
    )
    face = lathe([(0, 0), (16.5, 0)], 40).moved((0, -28.4, 178), rotation(x=-90))
    window = box((20, 1.2, 80), 0.2, (0, -25.2, 98))
    swing = merged(
        [box((1.6, 1.0, 54), 0.2, (2.4, -26.2, 102)), ellipsoid((7, 1.4, 7), (4.4, -26.4, 74), 20)]
    )
    return Thing(
        "grandfather clock",
        (
            Piece("clock cabinet", case, wood("74421f", 2, 5), 0.7),
            Piece("clock cabinet", window, solid("38302a", 0.05), 0.7),
            Piece("clock dial", face, dial, 2.0, 0.5),
            Piece("pendulum", swing, solid("e0b84a"), 2.0, 0.5, gloss=0.9),
        ),
    )


def curtains(width: float, height: float, spread: float, code: str) -> Thing:
    """Return two curtains ``width`` wide on a rod, left and right of a gap of ``spread``."""

    def wavy(middle: float) -> Mesh:
        across = np.linspace(-width / 2, width / 2, 60)
        front, rear = (
            np.stack([across + middle, -9 + side * 3.2 - 2.2 * np.sin(across * 0.75)], 1) for side in (-1, 1)
        )
        ring, rows = np.concatenate([front, rear[::-1]]), np.linspace(-height, -1, 24)
        points = np.empty((len(ring), len(rows), 3))
        points[..., :2], points[..., 2] = ring[:, None], rows
        middles = np.broadcast_to(points.mean(0), points.shape)  # where the two ends are closed
        return sheet(np.concatenate([middles[:, :1], points, middles[:, -1:]], 1), closed_rows=True)

    halves = [wavy(side * (spread + width) / 2) for side in (-1, 1)]
    rod = merged(
        [
            cylinder(1.6, spread + 2 * width + 16, 0.4, 16).moved(
                (-(spread + 2 * width + 16) / 2, -9, 1.5), rotation(y=90)
            ),
            *(ellipsoid(3.4, (side * ((spread + 2 * width) / 2 + 9), -9, 1.5), 16) for side in (-1, 1)),
        ]
    )
    cloth = gradient(code, code, 2, -height, 0, grain=0.08, size=9)
    return Thing(
        "curtains",
        (
            Piece("curtain cloth", merged(halves), cloth, 0.5),
            Piece("curtain rod", rod, solid("8a6a3a"), 1.0, 0.7, gloss=0.6),
        ),
    )


def tall_jar(name: str, code: str, other: str) -> Thing:
    """Return a large jar for the floor."""
    outline = smooth_curve([(9, 0.3), (17, 16), (19, 32), (11, 52), (8.5, 60), (12, 66)], 30)
    hull = lathe([(0, 0), (9, 0.3), (9, 0.3), *outline, (10.5, 65.5), (7, 60), (0, 56)], 40)
    return Thing(name, (Piece(name, hull, bands(code, other, 2, [10, 13, 30, 38, 55, 57]), 1.0, gloss=0.5),))
