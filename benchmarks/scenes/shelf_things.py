"""Small things for shelves. All sizes in centimetres, standing on z = 0, facing -y."""

from __future__ import annotations

import numpy as np

from benchmarks.scenes.alterations import plain
from scoup_lab.synthetic.art.meshes import (
    Floats,
    box,
    cylinder,
    ellipsoid,
    lathe,
    merged,
    rotation,
    smooth_curve,
    torus,
    tube,
)
from scoup_lab.synthetic.art.paints import (
    bands,
    checked,
    color,
    gradient,
    mix,
    smooth_noise,
    solid,
    spotted,
    wood,
)
from scoup_lab.synthetic.art.things import Piece, Thing


def jar(name: str, fill: str, lid: str) -> Thing:
    """Return a jar of something grainy, with a lid and a paper label."""
    outline = smooth_curve([(5.2, 0.3), (5.8, 2), (5.8, 12), (4.6, 15)], 20)
    hull = lathe([(0, 0), (5.2, 0.3), (5.2, 0.3), *outline, (4.6, 15.4), (0, 15.4)])

    def labelled(points: Floats, normals: Floats) -> Floats:
        shown = spotted(fill, "f6ecd8", 0.8, 0.3)(points, normals)
        paper = (np.abs(points[:, 2] - 7.5) < 2.8) & (points[:, 1] < -3.4)
        line = paper & (np.abs(points[:, 2] - 7.5) < 0.6)
        return np.where(line[:, None], color("5a4a3a"), np.where(paper[:, None], color("f4ead2"), shown))

    return Thing(
        name,
        (
            Piece(f"{name} glass", hull, labelled, 2.0, 0.4, gloss=0.8),
            Piece(
                f"{name} lid", cylinder(5.0, 2.6, 0.5, 28).moved((0, 0, 15)), solid(lid), 2.4, 0.4, gloss=0.5
            ),
        ),
    )


def storage_box(name: str, code: str, other: str, width: float = 30, height: float = 20) -> Thing:
    """Return a box with a lid, a label holder in front."""
    body = box((width, 25, height - 3), 0.6, (0, 0, (height - 3) / 2))
    lid = box((width + 1.6, 26.6, 5), 0.6, (0, 0, height - 2.5))
    plate = box((8, 0.8, 4.4), 0.2, (0, -12.7, height * 0.42))
    return Thing(
        name,
        (
            Piece(
                f"{name} body", body, bands(code, other, 0, np.arange(-2 * width, 2 * width, 4.0)), 1.3, 0.5
            ),
            Piece(f"{name} lid", lid, solid(other), 1.5, 0.5),
            Piece(f"{name} body", plate, solid("e9e2cc"), 2.2, 0.4),
        ),
    )


def robot() -> Thing:
    head = merged(
        [
            box((9, 8, 7), 0.8, (0, 0, 24)),
            cylinder(0.5, 4).moved((0, 0, 27.5)),
            ellipsoid(1.2, (0, 0, 32), 12),
        ]
    )

    def face(points: Floats, normals: Floats) -> Floats:
        x, z = np.abs(points[:, 0]), points[:, 2]
        eyes = (np.hypot(x - 2.1, z - 25) < 1.2) & (points[:, 1] < -3.5)
        mouth = (x < 2.6) & (np.abs(z - 21.9) < 0.5) & (points[:, 1] < -3.5)
        shown = solid("b9c4cc", 0.02)(points, normals)
        return np.where((eyes | mouth)[:, None], color("d8342c"), shown)

    def buttons(points: Floats, normals: Floats) -> Floats:
        x, z, front = points[:, 0], points[:, 2], points[:, 1] < -4
        shown = solid("8fa6b8", 0.02)(points, normals)
        for place, code in ((-3, "e2b93a"), (0, "3f9a5a"), (3, "d8342c")):
            shown = np.where((front & (np.hypot(x - place, z - 16.4) < 1.1))[:, None], color(code), shown)
        return np.where((front & (np.abs(x) < 3.6) & (np.abs(z - 12) < 1.8))[:, None], color("26343a"), shown)

    arms = [
        tube(smooth_curve([(s * 6, 0, 17.5), (s * 8.6, 0, 14), (s * 8.2, -3, 9.6)], 10), 1.3, 12)
        for s in (-1, 1)
    ]
    hands = [torus(1.4, 0.6, 18).moved((s * 8.2, -3.6, 8.4), rotation(x=60)) for s in (-1, 1)]
    legs = [box((3.8, 4, 8), 0.6, (s * 3, 0, 5)) for s in (-1, 1)]
    feet = [box((5, 7, 2.4), 0.6, (s * 3.2, -1, 1.2)) for s in (-1, 1)]
    return Thing(
        "robot",
        (
            Piece("robot head", head, face, 2.4, 0.35, gloss=0.5),
            Piece("robot body", box((12, 8.6, 12), 0.8, (0, 0, 14.6)), buttons, 2.4, 0.4, gloss=0.5),
            Piece("robot arms", merged([*arms, *hands]), solid("d8802c"), 2.6, 0.35, gloss=0.5),
            Piece("robot legs", merged([*legs, *feet]), solid("55636e"), 2.2, 0.4, gloss=0.5),
        ),
    )


def rocket() -> Thing:
    hull = lathe(
        [(0, 5), (3.6, 5), (3.6, 5), *smooth_curve([(4.2, 7), (5.2, 14), (4.2, 23)], 16), (4.2, 23), (0, 23)]
    )
    nose = lathe([(0, 23), (4.2, 23), *smooth_curve([(4.2, 23), (3.0, 27.5), (0.01, 32)], 12)])
    fins = [
        box((7, 1.0, 11), 0.4, (0, 0, 0))
        .moved((0, 0, 0), rotation(y=14))
        .moved((6.2, 0, 5.6))
        .moved(rotation=rotation(z=turn))
        for turn in (30, 150, 270)
    ]

    def portholes(points: Floats, normals: Floats) -> Floats:
        angle = np.arctan2(points[:, 1], points[:, 0])
        across = (angle / (np.pi / 2) - np.round(angle / (np.pi / 2))) * np.pi / 2 * 5
        radius = np.hypot(across, points[:, 2] - 17)
        shown = np.where((radius < 2.2)[:, None], color("c9342c"), solid("f2efe8")(points, normals))
        return np.where((radius < 1.5)[:, None], color("6fb6d8"), shown)

    return Thing(
        "toy rocket",
        (
            Piece("rocket hull", hull, portholes, 2.4, 0.4, gloss=0.5),
            Piece("rocket nose", nose, solid("c9342c"), 2.4, 0.4, gloss=0.5),
            Piece("rocket fins", merged(fins), solid("2f5fae"), 2.4, 0.35, gloss=0.5),
        ),
    )


def radio() -> Thing:
    def grille(points: Floats, normals: Floats) -> Floats:
        u, v = points[:, 0] / 1.2, points[:, 2] / 1.2
        holes = np.hypot(u - np.round(u), v - np.round(v)) < 0.3
        return np.where(holes[:, None], color("3a2c20"), color("e3d3ac"))

    def scale(points: Floats, normals: Floats) -> Floats:
        ticks = (np.abs(points[:, 0] - np.round(points[:, 0])) < 0.15) & (points[:, 2] > 13.4)
        needle = np.abs(points[:, 0] - 7.2) < 0.2
        shown = np.where(ticks[:, None], color("3a3a3a"), color("f4ecd0"))
        return np.where(needle[:, None], color("c9342c"), shown)

    knobs = [cylinder(1.7, 1.8, 0.3, 20).moved((x, -5.2, 5), rotation(x=90)) for x in (4.6, 9.8)]
    aerial = tube([(10, 3, 17), (15, 3, 33)], 0.35, 8)
    return Thing(
        "radio",
        (
            Piece("radio case", box((28, 11, 18), 1.6, (0, 0, 9)), wood("7a4526", 0, 3), 1.8, 0.5, gloss=0.4),
            Piece("radio speaker", box((12.5, 0.8, 13), 0.3, (-6, -5.5, 9)), grille, 2.4, 0.35),
            Piece("radio dial", box((11, 0.8, 4), 0.2, (7.2, -5.5, 13.2)), scale, 2.8, 0.3),
            Piece("radio knobs", merged(knobs), solid("2c2622"), 2.6, 0.35, gloss=0.6),
            Piece("radio aerial", aerial, solid("c4c8cc"), 3.0, 0.2, gloss=0.9),
        ),
    )


def blocks() -> Thing:
    """Return six building blocks in a heap."""
    codes = ("d8423a", "2f6fc0", "f0c02e", "3f9a5a", "e0802c", "7a4fb0")
    places = (
        (-7, 0, 0, 8),
        (0.6, 0.5, 0, -6),
        (8, 0, 0, 14),
        (-3.6, 0.2, 6.1, 20),
        (4.2, 0.3, 6.1, -12),
        (0.4, 0.2, 12.2, 33),
    )
    return plain(
        "building blocks",
        *(
            Piece(
                "",
                box((6, 6, 6), 0.5, (0, 0, 3)).moved((x, y, z), rotation(z=turn)),
                solid(code, 0.05),
                2.2,
                0.4,
                gloss=0.3,
            )
            for code, (x, y, z, turn) in zip(codes, places, strict=True)
        ),
    )


def basket(name: str) -> Thing:
    outside = smooth_curve([(11, 0.4), (13.4, 6), (14.6, 14)], 14)
    hull = lathe([(0, 0), (11, 0.4), (11, 0.4), *outside, (13.8, 14.2), (12.4, 6), (10, 2.0), (0, 2.0)], 40)

    def woven(points: Floats, normals: Floats) -> Floats:
        angle = np.arctan2(points[:, 1], points[:, 0])
        weave = np.sin(angle * 26) * np.sin(points[:, 2] * 2.6) + 0.4 * smooth_noise(points, 1.2, 4)
        return mix(color("8a6234"), color("d0a462"), 0.5 + 0.6 * weave)

    arch = tube(
        smooth_curve([(-13.8, 0, 13), (-11, 0, 24), (0, 0, 29), (11, 0, 24), (13.8, 0, 13)], 24), 0.9, 10
    )
    return Thing(
        name,
        (
            Piece(f"{name} weave", hull, woven, 1.8, 0.45),
            Piece(f"{name} handle", arch, solid("9a7040", 0.1), 2.2, 0.35),
        ),
    )


def yarn(name: str, code: str, tint: str) -> Thing:
    """Return a ball of yarn."""

    def wound(points: Floats, normals: Floats) -> Floats:
        turn = np.sin(points @ np.array([2.0, 1.2, 2.6]) + 2.5 * smooth_noise(points, 4, 2))
        return mix(color(code), color(tint), 0.5 + 0.5 * turn)

    return plain(name, Piece("", ellipsoid(5.2, (0, 0, 5.2), 28), wound, 2.2, 0.45))


def hourglass() -> Thing:
    outline = smooth_curve([(4.2, 2.2), (4.6, 5), (0.8, 10), (4.6, 15), (4.2, 17.8)], 28)
    ends = [cylinder(6, 2, 0.5, 28).moved((0, 0, z)) for z in (0, 18)]
    posts = [
        cylinder(0.5, 17, segments=10).moved((5 * np.cos(a), 5 * np.sin(a), 1.5)) for a in (0.5, 2.6, 4.7)
    ]
    sand = gradient("e0b060", "cfe4ea", 2, 4.4, 5.4, grain=0.04, size=0.4)
    return Thing(
        "hourglass",
        (
            Piece("hourglass frame", merged([*ends, *posts]), wood("8a4f28", 0, 2), 2.2, 0.35),
            Piece("hourglass sand", lathe([(0, 2.2), *outline, (0, 17.8)]), sand, 2.4, 0.35, gloss=0.7),
        ),
    )


def drum() -> Thing:
    rims = [torus(9.4, 0.7, 40).moved((0, 0, z)) for z in (1, 13)]
    return Thing(
        "drum",
        (
            Piece(
                "drum shell",
                cylinder(9.2, 13.4, 0.3, 40),
                checked("c9342c", "f0d8a0", (0, 2), 3.2),
                1.8,
                0.45,
            ),
            Piece("drum rims", merged(rims), solid("e0b84a"), 2.4, 0.4, gloss=0.7),
        ),
    )
