"""Things to eat and drink from, and things to eat. All sizes in centimetres, standing on z = 0."""

from __future__ import annotations

import numpy as np

from scoup_lab.synthetic.art.meshes import (
    Floats,
    cylinder,
    ellipsoid,
    lathe,
    merged,
    rotation,
    smooth_curve,
    torus,
    tube,
)
from scoup_lab.synthetic.art.paints import Paint, bands, color, gradient, mix, smooth_noise, solid, spotted
from scoup_lab.synthetic.art.things import Piece, Thing


def flowered(base: str, flowers: str, centre: str, size: float) -> Paint:
    """Return painted china: a grid of round flowers with a dot in the middle, over the angle and height."""

    def paint(points: Floats, normals: Floats) -> Floats:
        angle = np.arctan2(points[:, 1], points[:, 0])
        across = angle * 6 / np.pi + 0.5 * (np.floor(points[:, 2] / size) % 2)
        u = (across - np.floor(across) - 0.5) * 1.1
        v = points[:, 2] / size - np.floor(points[:, 2] / size) - 0.5
        radius, petals = np.hypot(u, v), 0.26 + 0.08 * np.cos(5 * np.arctan2(v, u))
        shown = mix(solid(base)(points, normals), color(flowers), (petals - radius) * 25)
        return mix(shown, color(centre), (0.1 - radius) * 30)

    return paint


def teapot() -> Thing:
    body = smooth_curve([(4.5, 0.6), (7.6, 3.0), (8.6, 6.0), (7.4, 9.6), (4.3, 12.0)], 20)
    hull = lathe([(0, 0), (4.6, 0), (4.6, 0), *body, (4.3, 12.0), (0, 12.0)])
    top = smooth_curve([(4.5, 12.0), (4.0, 13.0), (2.2, 13.9), (0.01, 14.2)], 10)
    lid = merged([lathe([(0, 12), (4.5, 12), *top]), ellipsoid(1.25, (0, 0, 15.1), 16)])
    spout = tube(
        smooth_curve([(6.5, 0, 4.0), (10.2, 0, 5.6), (11.8, 0, 9.0), (14.2, 0, 11.8)]),
        np.linspace(2.3, 1.1, 24),
    )
    arc = [(-6.5, 0, 10.0), (-10.8, 0, 10.8), (-12.6, 0, 7.8), (-10.6, 0, 4.6), (-7.2, 0, 3.6)]
    handle = tube(smooth_curve(arc), 0.95)
    china = flowered("f3ead7", "2f62a8", "e0a63a", 4.4)
    return Thing(
        "teapot",
        (
            Piece("teapot body", hull, china, 2.0, gloss=0.6),
            Piece("teapot lid", lid, solid("2f62a8"), 2.4, 0.45, gloss=0.6),
            Piece("teapot spout", spout, solid("f3ead7"), 2.4, 0.4, gloss=0.6),
            Piece("teapot handle", handle, solid("2f62a8"), 2.6, 0.35, gloss=0.5),
        ),
    )


def mug() -> Thing:
    outside = [
        (0, 0),
        (3.7, 0),
        (4.1, 0.5),
        (4.2, 5),
        (4.3, 9.3),
        (4.1, 9.6),
        (3.8, 9.3),
        (3.7, 5),
        (3.6, 1),
        (0, 1),
    ]
    arc = smooth_curve([(3.9, 0, 7.8), (6.4, 0, 7.6), (7.2, 0, 5.0), (6.1, 0, 2.6), (3.8, 0, 2.1)])
    coffee = cylinder(3.7, 0.3).moved((0, 0, 7.8))
    return Thing(
        "mug",
        (
            Piece("mug body", lathe(outside), bands("d8412f", "fbf3e4", 2, [3.2, 6.2]), 2.4, 0.4, gloss=0.5),
            Piece("mug handle", tube(arc, 0.65), solid("d8412f"), 2.8, 0.28, gloss=0.5),
            Piece("coffee", coffee, solid("3b2012", 0.1), 2.0, 0.4, gloss=0.7),
        ),
    )


def kettle() -> Thing:
    body = smooth_curve([(8.6, 0.4), (9.4, 3.0), (8.6, 8.0), (6.2, 12.4), (4.4, 13.6)], 20)
    hull = lathe([(0, 0), (8.6, 0.4), (8.6, 0.4), *body, (4.4, 13.6), (0, 13.6)])
    lid = merged(
        [
            lathe([(0, 13.5), (4.6, 13.5), (4.2, 14.4), (2.0, 14.9), (0, 15.0)]),
            cylinder(0.6, 1).moved((0, 0, 15)),
        ]
    )
    spout = tube(smooth_curve([(7.4, 0, 5.5), (11.0, 0, 8.6), (13.6, 0, 13.0)]), np.linspace(2.3, 1.2, 24))
    arch = tube(
        smooth_curve([(-6.8, 0, 11.8), (-6.2, 0, 18), (0, 0, 21.5), (6.2, 0, 18), (6.8, 0, 11.8)]), 0.85
    )
    knob = ellipsoid((1.3, 1.3, 0.9), (0, 0, 16.4), 16)
    steel = gradient("3f8f8a", "7cc4b8", 2, 0, 14, grain=0.04, size=5)
    return Thing(
        "kettle",
        (
            Piece("kettle body", hull, steel, 1.8, gloss=0.9),
            Piece("kettle lid", merged([lid, knob]), solid("26343a"), 2.2, 0.4, gloss=0.8),
            Piece("kettle spout", spout, solid("5fb0a6"), 2.2, 0.4, gloss=0.9),
            Piece("kettle handle", arch, solid("26343a"), 2.6, 0.32, gloss=0.4),
        ),
    )


def plate() -> Thing:
    rim = [
        (0, 0),
        (6.5, 0),
        (8.0, 0.6),
        (11.4, 1.8),
        (11.6, 2.0),
        (11.3, 2.2),
        (8.0, 1.3),
        (6.5, 0.8),
        (0, 0.8),
    ]

    def paint(points: Floats, normals: Floats) -> Floats:
        radius = np.hypot(points[:, 0], points[:, 1])
        shown = mix(solid("f7f3ea")(points, normals), color("3c7f5a"), (0.45 - np.abs(radius - 10.3)) * 8)
        return mix(shown, color("3c7f5a"), (0.2 - np.abs(radius - 8.2)) * 8)

    return Thing("plate", (Piece("plate", lathe(rim, 48), paint, 1.6, 0.5, gloss=0.5),))


def donut() -> Thing:
    def sprinkled(points: Floats, normals: Floats) -> Floats:
        shown = solid("f08cb4", 0.02)(points, normals)
        for seed, code in enumerate(("fff4d0", "6ad0e0", "f4d03a", "7a4ad0")):
            shown = mix(shown, color(code), (smooth_noise(points, (0.7, 0.45, 0.6), 40 + seed) - 0.52) * 9)
        return shown

    ring = torus(3.6, 2.0, 40, 0.85)
    angle = np.arctan2(ring.vertices[:, 1], ring.vertices[:, 0])
    wave = 0.25 + 0.3 * np.sin(5 * angle) + 0.2 * np.sin(3 * angle + 1)
    upper = (ring.vertices[:, 2] > wave)[ring.faces].any(1)
    icing = type(ring)(ring.vertices + ring.normals * 0.12, ring.normals, ring.faces[upper])
    return Thing(
        "donut",
        (
            Piece("donut dough", ring.moved((0, 0, 1.7)), solid("c98a4b", 0.08), 2.6, 0.35),
            Piece("icing", icing.moved((0, 0, 1.7)), sprinkled, 3.6, 0.3, gloss=0.4),
        ),
    )


def bowl() -> Thing:
    outside = smooth_curve([(4.5, 0.4), (9.0, 2.4), (12.4, 5.4), (13.8, 8.4)], 16)
    inside = smooth_curve([(13.2, 8.5), (11.6, 5.8), (8.2, 3.2), (0.01, 2.2)], 16)
    pattern = bands("4a6fb0", "f2efe6", 2, [1.0, 1.6, 6.2, 7.4])
    return Thing(
        "bowl",
        (Piece("bowl", lathe([(0, 0), (4.5, 0), *outside, *inside], 48), pattern, 1.5, 0.5, gloss=0.4),),
    )


def apple() -> Thing:
    outline = smooth_curve(
        [(0.01, 0.6), (1.6, 0.1), (3.6, 1.6), (4.2, 4.2), (3.2, 6.6), (1.5, 7.1), (0.01, 6.1)], 30
    )
    skin = gradient("d0202a", "e2462f", 2, 0, 9, grain=0.1, size=1.6)
    stem = tube(smooth_curve([(0, 0, 6.2), (0.1, 0, 7.2), (0.5, 0, 8.2)], 8), 0.28, 8)
    leaf = ellipsoid((1.5, 0.8, 0.18), segments=12).moved((1.6, 0.2, 7.7), rotation(y=-20))
    return Thing(
        "apple",
        (
            Piece("apple", lathe(outline), skin, 2.2, 0.5, gloss=0.7),
            Piece("apple", stem, solid("5a3a1c"), 3, 0.15),
            Piece("apple", leaf, solid("4f8f3a"), 3, 0.2),
        ),
    )


def pear() -> Thing:
    outline = smooth_curve(
        [(0.01, 0.2), (2.6, 0.6), (3.8, 3.2), (2.9, 6.2), (1.7, 8.6), (1.2, 9.8), (0.01, 10.3)], 30
    )
    skin = gradient("a8b83a", "d6cf52", 2, 1, 9, grain=0.1, size=1.4)
    stem = tube(smooth_curve([(0, 0, 10.1), (0.2, 0, 11.2), (0.7, 0, 12.0)], 8), 0.26, 8)
    return Thing(
        "pear",
        (
            Piece("pear", lathe(outline), skin, 2.2, 0.5, gloss=0.4),
            Piece("pear", stem, solid("5a3a1c"), 3, 0.15),
        ),
    )


def banana() -> Thing:
    line = smooth_curve(
        [(-8.6, 0, 5.4), (-7.6, 0, 4.0), (-3.6, 0, 1.9), (2, 0, 1.7), (6.4, 0, 3.9), (8.4, 0, 6.8)], 32
    )
    width = smooth_curve([(0.5,), (0.8,), (1.75,), (1.85,), (1.4,), (0.45,)], 32)[:, 0]

    def paint(points: Floats, normals: Floats) -> Floats:
        shown = spotted("f2cf3a", "7a5420", 0.9, 0.62)(points, normals)
        return mix(shown, color("5a3f1a"), (np.abs(points[:, 0]) - 7.9) * 2)

    return Thing("banana", (Piece("banana", tube(line, width, 10), paint, 2.4, 0.4, gloss=0.2),))


def orange() -> Thing:
    ball = ellipsoid((3.9, 3.9, 3.7), (0, 0, 3.7))
    return Thing(
        "orange", (Piece("orange", ball, spotted("f08a1e", "e07410", 0.35, 0.1), 2.2, 0.5, gloss=0.4),)
    )


def grapes() -> Thing:
    rng = np.random.default_rng(11)
    balls = []
    for layer, (count, ring) in enumerate(((9, 3.2), (7, 2.5), (4, 1.4), (1, 0.0))):
        for step in range(count):
            angle = step * 2 * np.pi / count + layer
            centre = (
                ring * 1.25 * np.cos(angle),
                ring * np.sin(angle),
                1.3 + layer * 1.5 + 0.2 * rng.normal(),
            )
            balls.append(ellipsoid(1.35, centre, 14))
    stem = tube(smooth_curve([(0, 0, 6.5), (0.3, 0, 8.4), (1.4, 0, 9.2)], 8), 0.25, 8)
    skin = gradient("4a1f66", "7a3f96", 2, 0, 7, grain=0.15, size=1.2)
    return Thing(
        "grapes",
        (
            Piece("grapes", merged(balls), skin, 1.8, 0.3, gloss=0.7),
            Piece("grapes", stem, solid("6a7a34"), 3, 0.15),
        ),
    )


def bottle() -> Thing:
    shoulder = smooth_curve([(3.9, 16.0), (3.6, 18.4), (1.9, 21.0), (1.5, 23.0)], 12)
    glass = lathe(
        [(0, 0), (3.6, 0), (3.9, 0.6), (3.9, 16.0), *shoulder, (1.5, 23), (1.5, 27), (1.5, 27), (0, 27)]
    )
    label = lathe([(3.98, 4.5), (3.98, 12.5)])

    def printed(points: Floats, normals: Floats) -> Floats:
        height = points[:, 2]
        shown = solid("efe2c0")(points, normals)
        shown = mix(shown, color("8c2a2a"), (1.0 - np.abs(height - 10.6)) * 8)
        lines = np.abs(height - 7.2) < 1.6
        return np.where((lines & (np.sin(height * 6) > 0.2))[:, None], color("6a5a48"), shown)

    return Thing(
        "bottle",
        (
            Piece("bottle glass", glass, solid("1f5a38", 0.06), 1.8, 0.45, gloss=0.9),
            Piece("bottle label", label, printed, 2.2, 0.4),
            Piece("bottle cork", cylinder(1.75, 3.6, 0.3).moved((0, 0, 25.4)), solid("b5413a"), 3.0, 0.3),
        ),
    )
