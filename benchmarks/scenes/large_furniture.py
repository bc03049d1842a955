"""Furniture of a large room. All sizes in centimetres, standing on z = 0 with the back at y = 0, facing -y."""

from __future__ import annotations

import numpy as np

from scoup_lab.synthetic.art.meshes import Floats, box, cylinder, ellipsoid, merged
from scoup_lab.synthetic.art.paints import solid, wood
from scoup_lab.synthetic.art.things import Piece, Thing


def sofa(name: str, width: float, seats: int, code: str) -> Thing:
    """Return a sofa, or with one seat an armchair, in a cloth of one colour."""
    cloth = solid(code, 0.07, 2.0)
    inside = width - 44
    base = box((width - 4, 84, 22), 4, (0, -44, 23))
    cushions = [
        box((inside / seats - 1, 62, 17), 6, ((step + 0.5) * inside / seats - inside / 2, -54, 42))
        for step in range(seats)
    ]
    backs = [
        box((inside / seats - 1, 20, 46), 8, ((step + 0.5) * inside / seats - inside / 2, -21, 68))
        for step in range(seats)
    ]
    frame = box((width - 6, 12, 56), 5, (0, -7, 58))
    arms = [box((22, 88, 56), 8, (side * (width / 2 - 11), -44, 34)) for side in (-1, 1)]
    legs = [
        cylinder(2.4, 12, top=3.2, segments=12).moved((x * (width / 2 - 12), y, 0))
        for x in (-1, 1)
        for y in (-12, -76)
    ]
    return Thing(
        name,
        (
            Piece(f"{name} seat", merged([base, *cushions]), cloth, 0.6),
            Piece(f"{name} back", merged([frame, *backs]), cloth, 0.6),
            Piece(f"{name} arms", merged(arms), cloth, 0.6),
            Piece(f"{name} legs", merged(legs), wood("5a3a22", 2), 1.0, 1.0),
        ),
    )


def shelf_unit(
    name: str,
    width: float,
    height: float,
    depth: float,
    columns: int,
    rows: int,
    code: str,
    detail: float = 0.6,
) -> Thing:
    """Return shelves with a back, open to the front; ``cells`` says where things stand in them."""
    timber = wood(code, 0, 5, contrast=0.12)
    upright = wood(code, 2, 5, contrast=0.12)
    boards = [
        box((width - 2, depth - 0.6, 2.4), 0.4, (0, -depth / 2, 1.2 + row * (height - 2.4) / rows))
        for row in range(rows + 1)
    ]
    sides = [
        box(
            (2.4, depth, height),
            0.4,
            (-width / 2 + 1.2 + column * (width - 2.4) / columns, -depth / 2, height / 2),
        )
        for column in range(columns + 1)
    ]
    back = box((width - 3, 1.2, height - 3), 0.2, (0, -0.6, height / 2))
    # The front edges are pieces of their own with more detail: they show against everything behind them.
    rails = [
        box((width, 1.2, 2.8), 0.4, (0, -depth - 0.2, 1.2 + row * (height - 2.4) / rows))
        for row in range(rows + 1)
    ]
    posts = [
        box(
            (2.8, 1.2, height),
            0.4,
            (-width / 2 + 1.2 + column * (width - 2.4) / columns, -depth - 0.4, height / 2),
        )
        for column in range(columns + 1)
    ]
    return Thing(
        name,
        (
            Piece(f"{name} boards", merged(rails), timber, 2.6 * detail, 0.5),
            Piece(f"{name} sides", merged(posts), upright, 2.6 * detail, 0.5),
            Piece(f"{name} boards", merged(boards), timber, detail, 0.8),
            Piece(f"{name} sides", merged(sides), upright, detail, 0.8),
            Piece(f"{name} back", back, wood(code, 2, 8, planks=11, contrast=0.1), detail * 0.7),
        ),
    )


def cells(width: float, height: float, columns: int, rows: int) -> tuple[Floats, Floats]:
    """Return middles [columns] and heights of the boards [rows] of a ``shelf_unit``, the lowest first."""
    middles = (np.arange(columns) + 0.5) * (width - 2.4) / columns - (width - 2.4) / 2
    return middles, 2.4 + np.arange(rows) * (height - 2.4) / rows


def wardrobe(width: float, height: float) -> Thing:
    body = merged(
        [
            box((width, 58, height - 8), 0.8, (0, -29, height / 2)),
            box((width + 8, 64, 6), 1.5, (0, -30, height - 3)),
        ]
    )
    doors, panels, knobs = [], [], []
    for side in (-1, 1):
        doors.append(box((width / 2 - 3, 2.4, height - 30), 0.6, (side * width / 4, -59, height / 2 + 2)))
        for low, high in ((0.12, 0.46), (0.54, 0.88)):
            middle = 16 + (height - 30) * (low + high) / 2
            size = (width / 2 - 18, 1.8, (height - 30) * (high - low))
            panels.append(box(size, 0.8, (side * width / 4, -60.4, middle)))
        knobs.append(ellipsoid(2.2, (side * 5, -62, height * 0.5), 14))
    dark = wood("7d5533", 2, 6, contrast=0.14)
    return Thing(
        "wardrobe",
        (
            Piece("wardrobe body", body, dark, 0.45),
            Piece("wardrobe doors", merged(doors), wood("946a42", 2, 6, contrast=0.14), 0.55),
            Piece("wardrobe doors", merged(panels), wood("83592f", 2, 6, contrast=0.14), 0.55),
            Piece("wardrobe knobs", merged(knobs), solid("d8b45a"), 2.0, 0.5, gloss=0.8),
        ),
    )


def cabinet(name: str, width: float, height: float, code: str) -> Thing:
    """Return a low cabinet with drawers side by side."""
    count = max(2, round(width / 55))
    step = (width - 6) / count
    fronts = [
        box((step - 2, 2, height - 14), 0.5, (-width / 2 + 3 + (k + 0.5) * step, -42.6, height / 2 + 3))
        for k in range(count)
    ]
    knobs = [
        ellipsoid(1.8, (-width / 2 + 3 + (k + 0.5) * step, -45, height / 2 + 8), 12) for k in range(count)
    ]
    body = box((width, 42, height - 6), 0.8, (0, -21, height / 2 + 3))
    feet = [box((4, 4, 6.5), 0.4, (x * (width / 2 - 5), y, 3.2)) for x in (-1, 1) for y in (-5, -37)]
    return Thing(
        name,
        (
            Piece(f"{name} body", merged([body, *feet]), wood(code, 0, 6), 0.6),
            Piece(f"{name} drawers", merged(fronts), wood(code, 0, 4, contrast=0.24), 0.8),
            Piece(f"{name} knobs", merged(knobs), solid("d8b45a"), 2.0, 0.5, gloss=0.8),
        ),
    )


def side_table(name: str, radius: float, height: float, code: str) -> Thing:
    """Return a round table on one leg."""
    leg = merged([cylinder(3.0, height - 3, 0.4, 20).moved((0, 0, 1)), cylinder(radius * 0.6, 2.4, 0.8)])
    return Thing(
        name,
        (
            Piece(
                f"{name} top", cylinder(radius, 3, 0.8, 40).moved((0, 0, height - 3)), wood(code, 0, 4.5), 0.8
            ),
            Piece(f"{name} leg", leg, wood(code, 2, 3), 0.9, 0.8),
        ),
    )
