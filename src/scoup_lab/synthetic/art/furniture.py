"""Furniture, plants and the room itself. All sizes in centimetres."""

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
    plane,
    rotation,
    smooth_curve,
    tube,
)
from scoup_lab.synthetic.art.paints import (
    Paint,
    bands,
    checked,
    color,
    gradient,
    mix,
    smooth_noise,
    solid,
    wood,
)
from scoup_lab.synthetic.art.things import Piece, Thing

TABLE_HEIGHT = 75.0


def table(length: float, width: float) -> Thing:
    top = box((length, width, 3.2), 0.9, (0, 0, TABLE_HEIGHT - 1.6))
    rail = box((length - 16, width - 16, 7), 0.4, (0, 0, TABLE_HEIGHT - 6.7))
    legs = [
        cylinder(2.2, TABLE_HEIGHT - 3.2, 0.3, 20, top=3.2).moved(
            (x * (length / 2 - 9), y * (width / 2 - 9), 0)
        )
        for x in (-1, 1)
        for y in (-1, 1)
    ]
    oak = wood("b9824e", 0, 4.5, planks=14.2)
    return Thing(
        "table",
        (
            Piece("table top", top, oak, 0.72, gloss=0.2),
            Piece("table legs", rail, wood("8f5f36", 0), 0.3),
            Piece("table legs", merged(legs), wood("8f5f36", 2), 0.5),
        ),
    )


def chair() -> Thing:
    legs = [tube([(x * 17, y * 16, 43), (x * 19, y * 18, 0)], 1.7, 10) for x in (-1, 1) for y in (-1, 1)]
    posts = [
        tube(smooth_curve([(x * 16.5, 17, 44), (x * 17, 19, 65), (x * 17.5, 23, 88)], 12), 1.5, 10)
        for x in (-1, 1)
    ]
    slats = [box((33, 1.6, 6), 0.7, (0, y, z)) for y, z in ((18.6, 62), (20.2, 72), (22, 82))]
    paint = wood("d9cdb4", 2, 5, contrast=0.07)
    return Thing(
        "chair",
        (
            Piece(
                "chair seat",
                box((40, 38, 3.2), 1.2, (0, 0, 43.4)),
                wood("d9cdb4", 0, 5, contrast=0.07),
                0.6,
                0.9,
            ),
            Piece("chair legs", merged(legs), paint, 0.7, 0.6),
            Piece("chair back", merged([*posts, *slats]), paint, 0.7, 0.6),
        ),
    )


def cushion() -> Thing:
    pillow = ellipsoid((17, 17, 5.5), (0, 0, 5), 36, power=0.55)
    return Thing("cushion", (Piece("cushion", pillow, checked("c8413f", "f2d7b8", (0, 1), 4.2), 0.9, 0.8),))


def vase() -> Thing:
    outline = smooth_curve([(4.4, 0.3), (6.6, 5), (6.8, 9), (4.0, 15), (2.9, 18.5), (4.2, 21.5)], 28)
    pattern = bands("efeae0", "2c4f86", 2, [2.4, 3.2, 8.0, 10.8, 15.6, 16.4])
    hull = lathe([(0, 0), (4.4, 0.3), (4.4, 0.3), *outline, (3.7, 21.3), (2.4, 18.5), (0, 17)])
    return Thing("vase", (Piece("vase", hull, pattern, 1.8, 0.45, gloss=0.7),))


def sunflowers() -> Thing:
    rng = np.random.default_rng(5)
    stems, petals, hearts, leaves = [], [], [], []
    for angle, lean, height in ((10, 9.0, 38), (130, 8.0, 34), (250, 8.5, 36), (70, 2.0, 43), (310, 3.5, 31)):
        out = np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle)), 0])
        tip = out * lean + np.array([0, 0, height])
        stems.append(
            tube(
                smooth_curve([np.array([0, 0, 17]), out * lean * 0.35 + np.array([0, 0, 25]), tip], 12),
                0.45,
                8,
            )
        )
        facing = rotation(y=35 + rng.uniform(-8, 8), z=angle)
        for step in range(13):
            petal = ellipsoid((2.2, 0.95, 0.22), (4.0, 0, 0.3), 12).moved(
                (0, 0, 0), rotation(y=-12, z=step * 360 / 13)
            )
            petals.append(petal.moved(tip, facing))
        hearts.append(ellipsoid((2.3, 2.3, 0.95), segments=16).moved(tip + facing @ [0, 0, 0.2], facing))
        leaf = ellipsoid((4.0, 1.7, 0.25), (3.6, 0, 0), 14).moved((0, 0, 0), rotation(y=-25, z=angle + 60))
        leaves.append(leaf.moved(out * lean * 0.4 + np.array([0, 0, 25])))
    return Thing(
        "sunflowers",
        (
            Piece("flower stems", merged(stems), solid("4f7f36"), 2.2, 0.25),
            Piece("flower stems", merged(leaves), solid("5a9440", 0.1), 2.0, 0.4),
            Piece("petals", merged(petals), gradient("f0a818", "fcd430", 2, 25, 45, size=1), 2.0, 0.22),
            Piece("flower hearts", merged(hearts), solid("4a2c14", 0.25, 0.5), 2.6, 0.35),
        ),
    )


def potted_plant() -> Thing:
    pot = lathe(
        [
            (0, 0),
            (5.2, 0),
            (5.2, 0),
            (6.6, 9.5),
            (6.6, 9.5),
            (7.4, 9.5),
            (7.4, 12),
            (7.4, 12),
            (6.6, 12),
            (6.3, 10.4),
            (0, 10.4),
        ]
    )
    rng = np.random.default_rng(8)
    leaves = []
    for step in range(26):
        angle, rise = step * 137.5, 75 - 62 * (step / 25)
        length = rng.uniform(6.5, 9.0)
        leaf = ellipsoid((length, 2.3, 0.25), (length, 0, 0), 16)
        bent = leaf.vertices.copy()
        bent[:, 2] -= 0.035 * bent[:, 0] ** 2
        leaves.append(Mesh(bent, leaf.normals, leaf.faces).moved((0, 0, 11), rotation(y=-rise, z=angle)))

    def green(points: Floats, normals: Floats) -> Floats:
        return np.clip(mix(color("2f6f38"), color("6fb04a"), 0.5 + 0.6 * smooth_noise(points, 3, 2)), 0, 1)

    return Thing(
        "potted plant",
        (
            Piece("flower pot", pot, solid("c06a42", 0.06), 1.8, 0.5),
            Piece("leaves", merged(leaves), green, 1.5, 0.26, gloss=0.3),
        ),
    )


def globe() -> Thing:
    lean = rotation(y=23)

    def world(points: Floats, normals: Floats) -> Floats:
        local = (points - [0, 0, 16.5]) @ lean
        height = smooth_noise(local, 6.5, 21) + 0.45 * smooth_noise(local, 2.6, 22)
        shown = mix(color("3a86c8"), color("6aa84a"), (height - 0.08) * 14)
        shown = mix(shown, color("d8b878"), (height - 0.45) * 8)
        return mix(shown, color("f4f6f8"), (np.abs(local[:, 2]) - 8.2) * 4)

    arc = np.radians(np.linspace(-100, 100, 24))
    bracket = np.stack([11.2 * np.cos(arc), 0 * arc, 11.2 * np.sin(arc)], 1) @ lean.T + [0, 0, 16.5]
    foot = merged([cylinder(6.4, 1.6, 0.5), cylinder(1.0, 4.4).moved((0, 0, 1.4))])
    return Thing(
        "globe",
        (
            Piece("globe sphere", ellipsoid(9.6, (0, 0, 16.5), 36), world, 1.6, 0.5, gloss=0.5),
            Piece(
                "globe stand", merged([tube(bracket, 0.6, 8), foot]), solid("a87a3a"), 1.8, 0.35, gloss=0.6
            ),
        ),
    )


def shelf(length: float) -> Thing:
    board = box((length, 22, 2.6), 0.6, (0, -11, -1.3))
    brackets = [box((2.4, 16, 12), 0.5, (x * length * 0.36, -8, -8)) for x in (-1, 1)]
    return Thing("shelf", (Piece("shelf", merged([board, *brackets]), wood("7a4f30", 0, 4), 0.6, 0.8),))


def picture(width: float, height: float) -> Thing:
    """Return a framed painting in the x, z plane, facing -y, centred on the origin."""

    def painted(points: Floats, normals: Floats) -> Floats:
        u, v = points[:, 0] / (width - 8) + 0.5, points[:, 2] / (height - 8) + 0.5
        return landscape(u, v) * (1 + 0.08 * smooth_noise(points, (2.5, 5, 0.8), 12))[:, None]

    rails = [box((width, 3.2, 4.5), 0.9, (0, -1.6, side * (height / 2 - 2.2))) for side in (-1, 1)]
    stiles = [box((4.5, 3.2, height), 0.9, (side * (width / 2 - 2.2), -1.6, 0)) for side in (-1, 1)]
    canvas = box((width - 6, 1.2, height - 6), 0.2, (0, -1.2, 0))
    return Thing(
        "picture",
        (
            Piece("picture frame", merged([*rails, *stiles]), wood("c79a4a", 0, 3), 0.7, 0.7, gloss=0.4),
            Piece("painting", canvas, painted, 0.9, 0.8),
        ),
    )


def window(width: float, height: float) -> Thing:
    """Return a window in the x, z plane, facing -y, centred on the origin."""

    def outside(points: Floats, normals: Floats) -> Floats:
        v = points[:, 2] / height + 0.5
        cloud = smooth_noise(points, (26, 10, 11), 31) + 0.5 * smooth_noise(points, (9, 10, 4), 32)
        shown = mix(mix(color("d4ecfa"), color("6fb2ee"), v * 1.1), color("ffffff"), (cloud - 0.05) * 2.2)
        trees = 0.24 + 0.07 * smooth_noise(points * [1, 0, 0], 12, 33) + 0.03 * smooth_noise(points, 3, 34)
        return mix(shown, color("5d8f55"), (trees - v) * 40)

    rails = [box((width, 5, 5), 0.8, (0, -2.5, z)) for z in (-height / 2, 0, height / 2)]
    stiles = [box((5, 5, height), 0.8, (x, -2.5, 0)) for x in (-width / 2, 0, width / 2)]
    sill = box((width + 16, 13, 3), 0.8, (0, -6, -height / 2 - 3))
    panes = box((width, 1.0, height), 0.2, (0, -0.6, 0))
    return Thing(
        "window",
        (
            Piece("window frame", merged([*rails, *stiles, sill]), solid("f4f2ec", 0.015), 0.5, 0.9),
            Piece("window panes", panes, outside, 0.55, 1.2, glow=0.9),
        ),
    )


def rug(radius: float) -> Thing:
    def rings(points: Floats, normals: Floats) -> Floats:
        distance, angle = (
            np.hypot(points[:, 0], points[:, 1]) / radius,
            np.arctan2(points[:, 1], points[:, 0]),
        )
        shown = np.broadcast_to(color("d9cdb6"), points.shape)
        for inner, outer, code in ((0.9, 0.95, "4a6478"), (0.82, 0.85, "a8574a"), (0.3, 0.33, "4a6478")):
            inside = (distance > inner) & (distance < outer)
            shown = np.where(inside[:, None], color(code), shown)
        petals = 0.56 + 0.2 * np.abs(np.cos(6 * angle))
        shown = mix(shown, color("6f8796"), (0.035 - np.abs(distance - petals)) * 60)
        return shown * (1 + 0.12 * smooth_noise(points, 1.8, 3))[:, None]

    return Thing("rug", (Piece("rug", cylinder(radius, 1.2, 0.5, 64), rings, 0.32),))


def room_shell(left: float, back: float, reach: float, height: float) -> tuple[Thing, Thing]:
    """Return the floor, and the two walls x = ``left`` and y = ``back``, running ``reach`` away from the corner."""

    def plaster(points: Floats, normals: Floats) -> Floats:
        tone = 1 + 0.035 * smooth_noise(points, 40, 1) + 0.015 * smooth_noise(points, 7, 2)
        return mix(color("8fb09c"), color("efe6d2"), (points[:, 2] - rail_height) * 0.8) * tone[:, None]

    rail_height = 62.0
    boards: Paint = wood("a97c55", 0, 7, planks=13, contrast=0.12)
    floor = plane((left, back - reach, 0), (reach, 0, 0), (0, reach, 0), 6)
    walls, strips = [], []
    for low, high in ((0.0, rail_height), (rail_height, height)):
        walls.append(plane((left, back, low), (reach, 0, 0), (0, 0, high - low), 6))
        walls.append(plane((left, back - reach, low), (0, reach, 0), (0, 0, high - low), 6))
    for middle, width in ((4.5, 9.0), (rail_height, 5.5)):
        strips.append(box((reach, 1.6, width), 0.5, (left + reach / 2, back - 0.8, middle)))
        strips.append(box((1.6, reach, width), 0.5, (left + 0.8, back - reach / 2, middle)))
    return (
        Thing("floor", (Piece("floor", floor, boards, 0.14),)),
        Thing(
            "wall",
            (
                Piece("wall", merged(walls), plaster, 0.09),
                Piece("wall", merged(strips), solid("f2eee4"), 0.3),
            ),
        ),
    )
