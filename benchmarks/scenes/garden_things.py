"""Things in a garden. All sizes in centimetres, standing on z = 0."""

from __future__ import annotations

import numpy as np

from benchmarks.scenes.alterations import plain
from scoup_lab.synthetic.art.meshes import (
    Floats,
    Mesh,
    box,
    cylinder,
    ellipsoid,
    lathe,
    merged,
    rotation,
    smooth_curve,
    torus,
    tube,
    with_normals,
)
from scoup_lab.synthetic.art.paints import color, gradient, mix, smooth_noise, solid, spotted, wood
from scoup_lab.synthetic.art.things import Piece, Thing


def fountain() -> Thing:
    stone = spotted("bdb3a2", "8f8676", 5.0, 0.25)
    wall = lathe(
        [
            (80, 0), (80, 0), (76, 6), (74, 34), (80, 38), (80, 44), (80, 44), (66, 44), (66, 44), (66, 20), (66, 20),
            (0.01, 20),
        ],
        64,
    )  # fmt: skip
    column = lathe(
        [
            (0, 20),
            (20, 20),
            (20, 20),
            (18, 30),
            *smooth_curve([(10, 34), (8, 60), (13, 88), (16, 92)], 16),
            (0, 92),
        ]
    )
    shaft = lathe([(0, 104), *smooth_curve([(7, 104), (5, 120), (8, 134)], 12), (0, 134)])
    bowls = []
    for radius, height, low in ((46, 92, 10), (24, 134, 7)):
        outside = smooth_curve(
            [(6, 0), (radius * 0.6, low * 0.6), (radius * 0.94, low * 1.6), (radius, low * 1.9)], 14
        )
        inside = smooth_curve([(radius - 4, low * 1.9), (radius * 0.6, low * 1.1), (0.01, low * 0.9)], 12)
        bowls.append(lathe([(0, 0), (6, 0), *outside, *inside], 48).moved((0, 0, height)))
    tip = ellipsoid((6, 6, 9), (0, 0, 150), 20)

    def rippled(points: Floats, normals: Floats) -> Floats:
        radius = np.hypot(points[:, 0], points[:, 1])
        wave = np.sin(radius * 0.7) * 0.5 + smooth_noise(points, 6, 3)
        return np.clip(mix(color("2f7f96"), color("9fd4de"), 0.3 + 0.35 * wave), 0, 1)

    water = [
        cylinder(66, 3, segments=48).moved((0, 0, 33)),
        cylinder(40.5, 2, segments=40).moved((0, 0, 106)),
        cylinder(20.5, 1.5, segments=32).moved((0, 0, 144)),
    ]
    return Thing(
        "fountain",
        (
            Piece("fountain basin", wall, stone, 0.75),
            Piece("fountain column", merged([column, shaft, tip]), stone, 0.9, 1.4),
            Piece("fountain bowls", merged(bowls), spotted("cbbfa8", "9c917e", 4.0, 0.25), 0.9, 1.4),
            Piece("water", merged(water), rippled, 0.9, 1.6, gloss=0.7),
        ),
    )


def bench(length: float, code: str) -> Thing:
    """Return a garden bench, its back towards +y."""
    slats = [box((length, 8, 2.6), 0.7, (0, -32 + step * 9.4, 44)) for step in range(5)]
    lean = rotation(x=-12)
    rails = [box((length, 2.4, 8), 0.7, (0, 0, height)).moved((0, 12, 44), lean) for height in (14, 25, 36)]
    legs = []
    for x in (-length / 2 + 9, length / 2 - 9):
        legs += [
            box((5, 5, 43), 0.8, (x, -29, 21.5)),
            box((5, 5, 43), 0.8, (x, 8, 21.5)),
            box((5, 46, 5), 0.8, (x, -12, 40)),
        ]
        legs += [
            box((5, 3.4, 46), 0.8, (x, 2.4, 21)).moved((0, 12, 44), lean),
            box((6, 44, 3.6), 0.8, (x, -12, 64)),
        ]
        legs.append(box((5, 5, 20), 0.8, (x, -29, 53)))
    timber = wood(code, 0, 4)
    return Thing(
        "bench",
        (
            Piece("bench seat", merged(slats), timber, 0.9, 1.2),
            Piece("bench back", merged(rails), timber, 0.9, 1.2),
            Piece("bench legs", merged(legs), wood(code, 2, 4), 0.9, 1.1),
        ),
    )


def wheelbarrow() -> Thing:
    """Return a wheelbarrow, its wheel towards +x."""
    floor = box((56, 40, 1.6), 0.5, (0, 0, 34))
    sides = [
        box((64, 1.6, 24), 0.5, (2, 0, 11)).moved((0, side * 20, 34), rotation(x=-side * 24))
        for side in (-1, 1)
    ] + [
        box((1.6, 58 - 4 * (side < 0), 24), 0.5, (0, 0, 11)).moved((side * 28, 0, 34), rotation(y=side * 24))
        for side in (-1, 1)
    ]
    wheel = torus(15, 4.2, 40).moved((56, 0, 19), rotation(x=90))
    hub = merged([
        cylinder(4, 12, 0.5, 20).moved((56, 6, 19), rotation(x=90)),
        *(tube([(56, 0, 19), (56 + 14 * np.cos(a), 0, 19 + 14 * np.sin(a))], 1.0, 8) for a in np.arange(6) * np.pi / 3),
    ])  # fmt: skip
    bars = [
        tube(
            smooth_curve(
                [(56, side * 7, 19), (20, side * 15, 29), (-30, side * 20, 32), (-92, side * 27, 52)], 24
            ),
            1.9,
            12,
        )
        for side in (-1, 1)
    ]
    feet = [
        tube(smooth_curve([(-14, side * 17, 31), (-24, side * 20, 14), (-32, side * 21, 1.5)], 12), 1.7, 10)
        for side in (-1, 1)
    ]
    grips = [tube([(-78, side * 25.2, 47), (-93, side * 27.1, 52.4)], 2.7, 12) for side in (-1, 1)]
    return Thing(
        "wheelbarrow",
        (
            Piece("wheelbarrow tray", merged([floor, *sides]), solid("3f7d4a", 0.06, 6), 1.0, 1.1, gloss=0.3),
            Piece("wheelbarrow wheel", wheel, solid("26262a", 0.08), 1.3, 0.9),
            Piece("wheelbarrow wheel", hub, solid("c9342c"), 1.4, 0.8),
            Piece("wheelbarrow handles", merged([*bars, *feet]), solid("8a8f94"), 1.3, 0.8, gloss=0.6),
            Piece("wheelbarrow handles", merged(grips), solid("1f1f24"), 1.4, 0.8),
        ),
    )


def pumpkin() -> Thing:
    ball = ellipsoid((15, 15, 11), (0, 0, 10.5), 64)
    angle = np.arctan2(ball.vertices[:, 1], ball.vertices[:, 0])
    ribs = 1 - 0.1 * np.abs(np.cos(5 * angle)) ** 6
    dent = 1 - 0.25 * np.exp(-((np.hypot(ball.vertices[:, 0], ball.vertices[:, 1]) / 5) ** 2))
    bent = (ball.vertices - [0, 0, 10.5]) * np.stack([ribs, ribs, dent], 1) + [0, 0, 10.5]
    stem = tube(smooth_curve([(0, 0, 17), (0.4, 0, 21), (3, 0.5, 25)], 10), [2.4] * 4 + [1.6] * 6, 10)
    skin = gradient("d86a14", "f2932a", 2, 0, 20, grain=0.1, size=3)
    return plain(
        "pumpkin",
        Piece("", with_normals(bent, ball.faces), skin, 1.5, 0.8, gloss=0.3),
        Piece("", stem, solid("6f7a3a", 0.1), 2.0, 0.5),
    )


def watering_can() -> Thing:
    hull = lathe(
        [
            (0, 0),
            (13, 0),
            (13, 0),
            (13, 2),
            (12, 24),
            (10, 27),
            (10, 27),
            (8.5, 27),
            (8.5, 27),
            (8.5, 22),
            (0, 22),
        ]
    )
    spout = tube(smooth_curve([(10, 0, 6), (20, 0, 14), (31, 0, 30)], 16), np.linspace(3.0, 1.7, 16))
    rose = cylinder(2.0, 4, 0.3, 20, top=5).moved((30, 0, 29), rotation(y=38))
    arch = tube(
        smooth_curve([(-11, 0, 5), (-23, 0, 14), (-20, 0, 28), (-4, 0, 38), (7, 0, 34), (8.5, 0, 26)], 30),
        1.3,
    )
    return Thing(
        "watering can",
        (
            Piece("can body", hull, solid("d84f3a", 0.04), 1.6, 0.7, gloss=0.6),
            Piece("can spout", merged([spout, rose]), solid("e8b93a"), 1.9, 0.6, gloss=0.6),
            Piece("can handle", arch, solid("e8b93a"), 1.9, 0.5, gloss=0.6),
        ),
    )


def gnome() -> Thing:
    hat = lathe(smooth_curve([(8.8, 36), (7.4, 44), (3.4, 56), (0.01, 64)], 24))
    brim = lathe([(0, 36), (9.4, 36), (9.4, 36), (8.6, 38), (0, 38)])
    face = merged([ellipsoid((7.4, 7, 7), (0, -0.5, 33)), ellipsoid(2.0, (0, -7.4, 33), 14)])
    beard = ellipsoid((6.6, 3.6, 9.5), (0, -6.2, 25.5), 24)
    coat = lathe(smooth_curve([(0.01, 5), (12, 6), (12.4, 12), (9, 24), (6, 30), (0.01, 32)], 30))
    arms = [
        tube(smooth_curve([(side * 8, 0, 27), (side * 13.5, -2, 21), (side * 10, -9, 16)], 14), 2.8, 12)
        for side in (-1, 1)
    ]
    belt = torus(11.9, 1.1, 36).moved((0, 0, 14))
    boots = [ellipsoid((4.6, 7.4, 4.4), (side * 5.6, -3.4, 4.2), 18) for side in (-1, 1)]
    return Thing(
        "gnome",
        (
            Piece("gnome hat", merged([hat, brim]), solid("cc2f2c"), 1.8, 0.7),
            Piece("gnome face", face, solid("f0bd9a"), 2.2, 0.5),
            Piece("gnome beard", beard, spotted("f4f1ea", "d8d4cc", 1.6, 0.2), 2.0, 0.6),
            Piece("gnome coat", merged([coat, *arms]), solid("2f5fae", 0.05), 1.7, 0.7),
            Piece("gnome coat", belt, solid("3a2a1c"), 2.2, 0.5),
            Piece("gnome boots", merged(boots), solid("4a3020", 0.06), 2.0, 0.6, gloss=0.4),
        ),
    )


def bird_house() -> Thing:
    """Return a bird house on a post, its hole towards -y."""
    post = merged([cylinder(3.4, 130, 0.4, 20), cylinder(11, 3, 0.6, 24)])
    body = box((26, 24, 28), 0.8, (0, 0, 143))
    lean = [
        box((24, 34, 2.2), 0.5, (side * 10, 0, 0)).moved((side * 2.2, 0, 165), rotation(y=side * 38))
        for side in (-1, 1)
    ]
    gable = [
        Mesh(
            np.array([(-13.0, y, 157.0), (13.0, y, 157.0), (0.0, y, 166.5)]),
            np.tile([0.0, np.sign(y), 0.0], (3, 1)),
            np.array([[0, 1, 2] if y < 0 else [0, 2, 1]]),
        )
        for y in (-11.9, 11.9)
    ]

    def front(points: Floats, normals: Floats) -> Floats:
        hole = (points[:, 1] < -11.5) & (np.hypot(points[:, 0], points[:, 2] - 146) < 4.6)
        return np.where(hole[:, None], color("1c1814"), wood("e9e2d0", 2, 4, planks=6.5)(points, normals))

    return Thing(
        "bird house",
        (
            Piece("bird house post", post, wood("7a5a3c", 2, 4), 1.1, 0.8),
            Piece("bird house box", merged([body, *gable]), front, 1.5, 0.8),
            Piece("bird house roof", merged(lean), solid("b5423a", 0.1, 2), 1.4, 0.8),
        ),
    )
