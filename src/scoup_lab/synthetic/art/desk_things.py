"""Things that lie on a desk, and toys. All sizes in centimetres, standing on z = 0."""

from __future__ import annotations

import numpy as np

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
from scoup_lab.synthetic.art.paints import Paint, bands, color, fur, gradient, mix, smooth_noise, solid
from scoup_lab.synthetic.art.things import Piece, Thing


def book(name: str, code: str, length: float = 24.0, width: float = 17.0, height: float = 3.4) -> Thing:
    """Return a closed book lying flat, its spine towards -y."""

    def paint(points: Floats, normals: Floats) -> Floats:
        x, y, z = points.T
        inside = (np.abs(z - height / 2) < height / 2 - 0.45) & (y > -width / 2 + 0.6)
        side = inside & (np.abs(normals[:, 2]) < 0.5)
        paper = color("efe6d0") * (0.93 + 0.07 * np.sin(z * 14))[:, None]
        cover = solid(code)(points, normals)
        gold = color("f0d890")
        frame = np.maximum(np.abs(x) - length / 2, np.abs(y) - width / 2)
        cover = mix(cover, gold, (0.22 - np.abs(frame + 1.6)) * 12 * (z > height / 2))
        title = (np.abs(x) < length * 0.28) & (np.abs(z - height / 2) < height * 0.2) & (y < -width / 2 + 0.6)
        title |= (np.abs(x) < length * 0.22) & (np.abs(y - 2.5) < 0.9) & (z > height / 2)
        cover = np.where(title[:, None], gold, cover)
        return np.where(side[:, None], paper, cover)

    return Thing(name, (Piece(name, box((length, width, height), 0.4, (0, 0, height / 2)), paint, 1.5, 0.5),))


def alarm_clock() -> Thing:
    upright = rotation(x=90)
    body = cylinder(5.6, 4.4, 0.8, 40).moved((0, 2.2, 7.0), upright)

    def dial(points: Floats, normals: Floats) -> Floats:
        x, z = points[:, 0], points[:, 2] - 7.0
        radius, angle = np.hypot(x, z), np.arctan2(x, z)
        shown = solid("faf6ea", 0.01)(points, normals)
        ticks = (np.abs(np.mod(angle * 6 / np.pi + 0.5, 1) - 0.5) < 0.11) & (radius > 3.5) & (radius < 4.5)
        hours = _hand(x, z, 300, 2.5, 0.42) | _hand(x, z, 55, 3.4, 0.3) | (radius < 0.5)
        return np.where((ticks | hours)[:, None], color("22262c"), shown)

    face = lathe([(0, 0), (4.9, 0)], 40).moved((0, -2.35, 7.0), rotation(x=-90))
    bells = merged([ellipsoid((2.0, 2.0, 1.5), (side * 3.4, 0, 13.2), 16) for side in (-1, 1)])
    feet = merged([tube([(side * 2.8, 0, 3), (side * 4.4, 0, 0.3)], 0.5, 8) for side in (-1, 1)])
    return Thing(
        "alarm clock",
        (
            Piece("clock case", body, solid("2f8fae"), 2.4, 0.4, gloss=0.7),
            Piece("clock face", face, dial, 4.5, 0.2),
            Piece("clock bells", bells, solid("e8b93a"), 2.8, 0.3, gloss=0.9),
            Piece("clock case", feet, solid("e8b93a"), 3, 0.25, gloss=0.8),
        ),
    )


def _hand(x: Floats, y: Floats, degrees: float, length: float, width: float) -> np.ndarray:
    direction = np.sin(np.radians(degrees)), np.cos(np.radians(degrees))
    along = x * direction[0] + y * direction[1]
    return (np.abs(x * direction[1] - y * direction[0]) < width) & (along > 0) & (along < length)


def laptop() -> Thing:
    lean = rotation(x=-16)
    hinge = (0.0, 11.0, 1.6)

    def keys(points: Floats, normals: Floats) -> Floats:
        u, v = points[:, 0] / 1.9, (points[:, 1] - 2.0) / 1.9
        gaps = (np.abs(u - np.round(u)) > 0.38) | (np.abs(v - np.round(v)) > 0.38)
        return np.where(gaps[:, None], color("8f959c"), color("2b2f36"))

    def picture(points: Floats, normals: Floats) -> Floats:
        local = (points - hinge) @ lean  # the screen before it was tilted
        return landscape(local[:, 0] / 30.0 + 0.5, (local[:, 2] - 0.8) / 19.4)

    base = box((32, 22, 1.6), 0.5, (0, 0, 0.8))
    lid = box((32, 1.2, 21.5), 0.5, (0, 0, 10.75)).moved(hinge, lean)
    screen = box((29.6, 0.3, 18.8), 0.1, (0, -0.6, 10.9)).moved(hinge, lean)
    return Thing(
        "laptop",
        (
            Piece("laptop base", base, solid("b9bec4", 0.015), 1.3, 0.5, gloss=0.4),
            Piece("keyboard", box((27.4, 10.4, 0.3), 0.1, (0, 4.0, 1.6)), keys, 2.4, 0.3),
            Piece("laptop base", box((8, 5.4, 0.2), 0.1, (0, -6.6, 1.6)), solid("9da3aa", 0.01), 1.5, 0.4),
            Piece("laptop screen", lid, solid("aeb4ba", 0.015), 1.2, 0.5, gloss=0.4),
            Piece("laptop screen", screen, picture, 2.4, 0.35, glow=0.75),
        ),
    )


def landscape(u: Floats, v: Floats) -> Floats:
    """Return [n, 3]: a picture of hills under an evening sky; u runs right and v up, both 0..1."""
    shown = mix(color("fbd08a"), color("4f86c6"), (v - 0.35) * 1.9)
    shown = mix(shown, color("fff3c4"), (0.085 - np.hypot((u - 0.68) * 1.5, v - 0.66)) * 60)
    for height, swing, rate, code in (
        (0.46, 0.14, 7, "7d7fb0"),
        (0.34, 0.09, 11, "4d6f8a"),
        (0.2, 0.06, 8, "2f6a4c"),
    ):
        ridge = height + swing * np.sin(rate * u + rate) * np.cos(rate * 0.6 * u)
        shown = mix(shown, color(code), (ridge - v) * 60)
    return mix(shown, color("e8f0f4"), (0.012 - np.abs(v - 0.1 - 0.01 * np.sin(u * 30))) * 60)


def desk_lamp() -> Thing:
    stem = tube(smooth_curve([(0, 0, 1.5), (-1.5, 0, 14), (-2, 0, 28), (2, 0, 37), (9, 0, 39)], 32), 0.7)
    profile = [
        (2.4, 0.0),
        (2.4, 0.0),
        (7.8, -9.0),
        (7.8, -9.0),
        (7.5, -9.0),
        (2.2, -0.3),
        (2.2, -0.3),
        (0, -0.2),
    ]
    shade = lathe(profile[::-1]).flipped().moved((10.5, 0, 40.5), rotation(y=-14))
    bulb = ellipsoid(2.3, (10.3, 0, 35.4), 16)
    return Thing(
        "desk lamp",
        (
            Piece("lamp base", cylinder(7.2, 1.8, 0.6), solid("2c3038"), 1.4, 0.5, gloss=0.5),
            Piece("lamp stem", stem, solid("c9a24a"), 2.2, 0.25, gloss=0.8),
            Piece("lamp shade", shade, solid("f2b632"), 2.0, 0.4, gloss=0.3, glow=0.25),
            Piece("light bulb", bulb, solid("fff2c0"), 2.0, 0.4, glow=1.0),
        ),
    )


def candle() -> Thing:
    dish = [
        (0, 0),
        (4.6, 0),
        (5.8, 1.2),
        (5.5, 1.4),
        (4.4, 0.7),
        (2.4, 0.8),
        (2.4, 0.8),
        (2.4, 2.4),
        (0, 2.4),
    ]
    flame = lathe(smooth_curve([(0.01, 14.2), (0.75, 15.2), (0.6, 16.6), (0.01, 18.8)], 14), 14)

    ring = torus(1.8, 0.4, 20).moved((6.6, 0, 1.6), rotation(x=90))
    wax = cylinder(1.9, 11.6, 0.4, 24).moved((0, 0, 2.2))

    def burning(points: Floats, normals: Floats) -> Floats:
        return mix(color("ff9a2a"), color("fff6c8"), (points[:, 2] - 14.4) / 2.2)

    return Thing(
        "candle",
        (
            Piece("candle holder", merged([lathe(dish), ring]), solid("c9963a"), 2.4, 0.35, gloss=0.9),
            Piece("candle wax", wax, solid("f6ecd8", 0.04), 2.4, 0.4),
            Piece("flame", flame, burning, 6, 0.22, glow=1.0),
        ),
    )


def photo_camera() -> Thing:
    leather = bands("2b2b30", "c4c7cb", 2, [6.6, 10.0])
    lens = lathe([(3.3, 0), (3.1, 4.2), (2.9, 4.8), (2.5, 4.8), (1.8, 4.4), (0, 4.6)]).moved(
        (0.6, -2.2, 4.2), rotation(x=90)
    )

    def glass(points: Floats, normals: Floats) -> Floats:
        radius = np.hypot(points[:, 0] - 0.6, points[:, 2] - 4.2)
        return mix(solid("1f2126")(points, normals), color("4a7fd0"), (1.7 - radius) * 3)

    top = merged(
        [box((4.2, 3.4, 2.2), 0.4, (0.6, 0, 9.0)), cylinder(1.0, 1.1, 0.2, 16).moved((-4.6, 0, 8.2))]
    )
    return Thing(
        "camera",
        (
            Piece(
                "camera body",
                merged([box((13.5, 4.6, 8.4), 0.7, (0, 0, 4.2)), top]),
                leather,
                2.4,
                0.35,
                gloss=0.3,
            ),
            Piece("camera lens", lens, glass, 3.2, 0.3, gloss=0.9),
        ),
    )


def toy_car() -> Thing:
    wheels = [
        cylinder(2.3, 1.8, 0.4, 20).moved((x, y, 2.3), rotation(x=90))
        for x in (-5.4, 5.4)
        for y in (-3.1, 4.9)
    ]

    def tyre(points: Floats, normals: Floats) -> Floats:
        radius = np.hypot(np.abs(points[:, 0]) - 5.4, points[:, 2] - 2.3)
        return mix(color("24242a"), color("e8e8ea"), (1.15 - radius) * 6)

    def cabin(points: Floats, normals: Floats) -> Floats:
        posts = (points[:, 2] > 10.0) | (np.abs(points[:, 0] + 0.8) < 0.45)
        return np.where(posts[:, None], color("2a6fd0"), color("c6e6f4"))

    body = merged([box((18, 8.4, 4.2), 1.6, (0, 0, 4.6)), box((1.2, 7.6, 1.0), 0.4, (9.2, 0, 3.4))])

    def shell(points: Floats, normals: Floats) -> Floats:
        shown = solid("2a6fd0")(points, normals)
        lights = (points[:, 0] > 8.2) & (np.hypot(np.abs(points[:, 1]) - 2.8, points[:, 2] - 5.2) < 1.0)
        return np.where(lights[:, None], color("fff2b0"), shown)

    return Thing(
        "toy car",
        (
            Piece("car body", body, shell, 2.2, 0.4, gloss=0.8),
            Piece("car windows", box((9.5, 7.2, 4.4), 1.4, (-0.8, 0, 8.4)), cabin, 2.6, 0.35, gloss=0.8),
            Piece("wheels", merged(wheels), tyre, 2.8, 0.3),
        ),
    )


def teddy_bear() -> Thing:
    plush, belly = fur("9a6232", "bd8246"), fur("d8b382", "e6c89c")
    head = merged([ellipsoid((5.4, 5.0, 4.8), (0, 0, 19.5)), *(
        ellipsoid((2.1, 1.2, 2.1), (side * 4.2, 0.3, 23.6), 16) for side in (-1, 1))])  # fmt: skip
    arms = [
        ellipsoid((2.1, 2.1, 4.8), segments=16).moved((side * 6.4, -1.2, 11.6), rotation(x=-25, y=side * -35))
        for side in (-1, 1)
    ]
    legs = [ellipsoid((2.5, 5.2, 2.5), (side * 4.0, -4.8, 2.6), 16) for side in (-1, 1)]
    soles = [ellipsoid((1.7, 0.6, 1.7), (side * 4.0, -9.7, 2.6), 14) for side in (-1, 1)]
    dots = [ellipsoid(0.75, (side * 2.1, -4.5, 20.8), 12) for side in (-1, 1)] + [
        ellipsoid((1.0, 0.7, 0.7), (0, -6.6, 19.0), 12)
    ]
    bow = [
        ellipsoid((2.2, 0.9, 1.4), segments=14).moved((side * 2.1, -4.6, 14.9), rotation(y=side * 15))
        for side in (-1, 1)
    ]
    return Thing(
        "teddy bear",
        (
            Piece("bear head", head, plush, 1.9, 0.45),
            Piece("bear head", ellipsoid((2.6, 2.2, 2.1), (0, -4.6, 18.3), 16), belly, 2.2, 0.4),
            Piece("bear head", merged(dots), solid("1c1614"), 4, 0.2, gloss=1.0),
            Piece("bear body", ellipsoid((6.0, 5.2, 7.2), (0, 0, 8.6)), plush, 1.7, 0.5),
            Piece("bear body", ellipsoid((3.8, 2.2, 4.8), (0, -3.7, 8.2), 16), belly, 2.0, 0.45),
            Piece("bear arms", merged(arms), plush, 2.0, 0.4),
            Piece("bear legs", merged(legs), plush, 2.0, 0.45),
            Piece("bear legs", merged(soles), belly, 2.4, 0.35),
            Piece("bow tie", merged([*bow, ellipsoid(0.9, (0, -5.2, 14.9), 12)]), solid("d83a4a"), 3, 0.3),
        ),
    )


def rubber_duck() -> Thing:
    body = ellipsoid((5.6, 4.3, 3.6), (0, 0, 3.4), 28)
    tail = ellipsoid((2.2, 2.0, 1.6), segments=16).moved((-5.0, 0, 5.2), rotation(y=35))
    wings = [
        ellipsoid((3.0, 0.9, 1.8), segments=16).moved((-0.8, side * 4.0, 4.2), rotation(y=12))
        for side in (-1, 1)
    ]
    eyes = [ellipsoid(0.55, (5.4, side * 1.5, 9.6), 10) for side in (-1, 1)]
    beak = ellipsoid((1.9, 1.5, 0.75), (6.7, 0, 8.4), 14)
    yellow: Paint = gradient("f4b81c", "ffd83c", 2, 0, 8, grain=0.02)
    return Thing(
        "rubber duck",
        (
            Piece("duck body", merged([body, tail, *wings]), yellow, 2.4, 0.4, gloss=0.6),
            Piece("duck head", ellipsoid(3.2, (3.2, 0, 8.9), 24), yellow, 2.6, 0.35, gloss=0.6),
            Piece("duck head", merged(eyes), solid("1a1a1e"), 5, 0.14, gloss=0.8),
            Piece("duck beak", beak, solid("ee6a1e"), 3.4, 0.25, gloss=0.4),
        ),
    )


def ball() -> Thing:
    codes = ("e23b3b", "f6f2e8", "2f6fd0", "f6f2e8", "f0c02e", "f6f2e8")

    def panels(points: Floats, normals: Floats) -> Floats:
        wedge = np.floor((np.arctan2(points[:, 1], points[:, 0]) / np.pi + 1) * 2.999).astype(int)
        shown = np.stack([color(code) for code in codes])[wedge]
        ends = np.abs(points[:, 2] - 11) > 10.3
        return (
            np.where(ends[:, None], color("f6f2e8"), shown) * (1 + 0.03 * smooth_noise(points, 3, 1))[:, None]
        )

    return Thing("ball", (Piece("ball", ellipsoid(11, (0, 0, 11), 32), panels, 1.0, gloss=0.5),))
