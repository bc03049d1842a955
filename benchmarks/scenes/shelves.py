"""The shelves: a wall of shelves full of small things, seen from the front along a flat arc. Many names and fine
parts, little parallax; boards and neighbours hide one thing behind another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.scenes import garden_things as garden
from benchmarks.scenes import large_furniture as large
from benchmarks.scenes import shelf_things as small
from benchmarks.scenes.alterations import broader, called, painted, several
from scoup_lab.synthetic.art import desk_things as desk
from scoup_lab.synthetic.art import furniture, tableware
from scoup_lab.synthetic.art.layout import Layout
from scoup_lab.synthetic.art.lighting import Light
from scoup_lab.synthetic.art.meshes import Floats, box, merged, plane
from scoup_lab.synthetic.art.paints import bands, checked, color, fur, gradient, smooth_noise, solid, wood
from scoup_lab.synthetic.art.things import Piece, Thing

WIDTH, TALL, DEPTH, COLUMNS, ROWS = 320.0, 215.0, 34.0, 5, 5  # centimetres
FRONT = -0.17  # metres: where things stand in the depth of a shelf, whose back is at y = 0
BROADER = 1.4  # how much further apart Gaussians lie than on the table


def make_shelves() -> tuple[Thing, ...]:
    """Return all things, placed; the foot of the shelves' back is the x axis, and they face -y."""
    rows = (_lowest(), _second(), _middle(), _fourth(), _highest())
    middles, boards = large.cells(WIDTH, TALL, COLUMNS, ROWS)
    placed = [
        _shifted(thing, middles[column] / 100, boards[row] / 100)
        for row, in_row in enumerate(rows)
        for column, in_cell in enumerate(in_row)
        for thing in in_cell
    ]
    unit = large.shelf_unit("shelves", WIDTH, TALL, DEPTH, COLUMNS, ROWS, "8f6844", 0.6).at(0, 0, 0)
    return tuple(broader(thing, BROADER) for thing in (*_shell(), unit, *placed))


def _shifted(thing: Thing, x: float, z: float) -> Thing:
    """Return a thing placed relative to a cell (the middle of its board, on the line ``FRONT``), placed in the room."""
    return replace(thing, place=thing.place + np.array([x, FRONT, z]))


def _shell() -> tuple[Thing, ...]:
    def plaster(points: Floats, normals: Floats) -> Floats:
        tone = 1 + 0.03 * smooth_noise(points, 50, 1) + 0.012 * smooth_noise(points, 8, 2)
        return np.clip(color("9fb0b4") * tone[:, None], 0, 1)

    wall = plane((-420, 0, 0), (840, 0, 0), (0, 0, 330), 15)
    skirting = box((840, 1.6, 9), 0.5, (0, -0.8, 4.5))
    floor = plane((-420, -420, 0), (840, 0, 0), (0, 420, 0), 15)
    return (
        Thing("floor", (Piece("floor", floor, wood("a98a64", 0, 8, planks=15, contrast=0.12), 0.15),)),
        Thing(
            "wall",
            (Piece("wall", wall, plaster, 0.12), Piece("wall", merged([skirting]), solid("f2eee4"), 0.3)),
        ),
    )


def _standing(group: str, start: float, specs: tuple[tuple[str, str, float, float], ...]) -> list[Thing]:
    """Return books side by side, spines to the front, of names, colours, thickness and height in centimetres."""
    row, along = [], start
    for name, code, thick, tall in specs:
        row.append(desk.book(name, code, tall, 18, thick).at(along, -0.02, tall / 200, 0, (0, 90), group))
        along += thick / 100 + 0.003
    return row


def _mug(name: str, code: str, stripe: str) -> Thing:
    return painted(
        called(tableware.mug(), name),
        {f"{name} body": bands(code, stripe, 2, [3.2, 6.2]), f"{name} handle": solid(code)},
    )


def _bottle(name: str, glass: str) -> Thing:
    return painted(called(tableware.bottle(), name), {f"{name} glass": solid(glass, 0.06)})


def _highest() -> list[list[Thing]]:
    clay = "vase with sunflowers"
    return [
        [
            *_standing(
                "novels",
                -0.28,
                (
                    ("red book", "b03434", 4.2, 25),
                    ("blue book", "2c4a86", 3.6, 28),
                    ("green book", "3a7a4c", 5.0, 24),
                ),
            ),
            furniture.globe().at(0.12, 0, 0, 30),
        ],
        [
            furniture.vase().at(-0.12, 0, 0, 0, group=clay, grow=0.8),
            furniture.sunflowers().at(-0.12, 0, 0, 30, group=clay, grow=0.8),
            desk.candle().at(0.16, -0.03, 0, 40),
        ],
        [small.radio().at(-0.1, 0.02, 0, 6), small.hourglass().at(0.2, -0.02, 0, 20)],
        [
            tableware.teapot().at(-0.13, 0, 0, -15, group="tea set"),
            _mug("green mug", "3f9a5a", "f4f0dc").at(0.1, -0.05, 0, -40, group="tea set"),
            _mug("blue mug", "2f62a8", "e8d48a").at(0.22, 0.04, 0, -20, group="tea set"),
        ],
        [furniture.potted_plant().at(-0.1, 0, 0, 60, grow=0.95), desk.alarm_clock().at(0.19, -0.03, 0, -12)],
    ]


def _fourth() -> list[list[Thing]]:
    jars = several(
        *(
            small.jar("jar", "b5622c", "3f7a4a").at(x, y, 0, turn, group="jars")
            for x, y, turn in ((-0.2, 0.0, 0), (-0.06, 0.03, 14), (0.07, -0.03, -9))
        )
    )
    return [
        [*jars, small.jar("honey jar", "e0a020", "c9342c").at(0.21, 0.0, 0, 5, group="jars")],
        [
            desk.laptop().at(-0.08, 0.02, 0, 8, grow=0.95),
            small.yarn("red yarn", "b8303a", "e0606a").at(0.23, -0.04, 0),
        ],
        [
            *_standing(
                "cook books",
                -0.28,
                (
                    ("orange book", "d8782c", 4.6, 27),
                    ("white book", "e6e0d2", 3.4, 25),
                    ("black book", "2c2c32", 4.0, 30),
                ),
            ),
            desk.photo_camera().at(0.13, -0.02, 0, 10),
        ],
        [
            tableware.kettle().at(-0.12, 0, 0, 18),
            tableware.plate().at(0.16, 0.1, 0.112, 0, (70, 0), group="plate"),
        ],
        [small.robot().at(-0.13, 0, 0, 12, grow=1.1), small.rocket().at(0.12, 0.01, 0, 10, grow=1.1)],
    ]


def _middle() -> list[list[Thing]]:
    fruit, low = "fruit bowl", 0.03
    return [
        [
            tableware.bowl().at(-0.02, 0, 0, group=fruit, grow=1.05),
            tableware.apple().at(-0.07, -0.05, low + 0.012, 40, group=fruit),
            tableware.orange().at(0.03, -0.06, low + 0.012, group=fruit),
            tableware.pear().at(-0.06, 0.05, low + 0.012, 10, (-20, 8), fruit),
            tableware.grapes().at(0.06, 0.03, low + 0.022, 60, group=fruit),
        ],
        [
            _bottle("green bottle", "1f5a38").at(-0.2, 0.02, 0, 250, group="bottles"),
            _bottle("brown bottle", "6a3a1c").at(-0.07, -0.03, 0, 280, group="bottles", grow=0.9),
            _bottle("blue bottle", "244f9a").at(0.06, 0.03, 0, 265, group="bottles", grow=1.05),
            small.yarn("yellow yarn", "d8a82c", "f4dc80").at(0.21, -0.03, 0, grow=1.1),
        ],
        [
            desk.desk_lamp().at(-0.13, 0.02, 0, -30, grow=0.85),
            desk.book("thin book", "3f7f8a", 24, 17, 2.6).at(0.14, -0.01, 0, 10, group="lying books"),
            desk.book("thick book", "7a3a56", 21, 15, 4.8).at(0.13, 0.0, 0.026, -14, group="lying books"),
            desk.rubber_duck().at(0.13, -0.01, 0.074, -70, group="rubber duck"),
        ],
        [
            desk.toy_car().at(-0.13, -0.01, 0, 18, group="toy cars", grow=1.1),
            painted(
                called(desk.toy_car(), "red car"),
                {"red car body": solid("c42f2c"), "windows of the red car": solid("d8e8ee")},
            ).at(0.14, 0.0, 0, -160, group="toy cars", grow=1.1),
        ],
        [
            *_standing(
                "atlases",
                -0.29,
                (
                    ("yellow book", "d8b02c", 3.4, 29),
                    ("purple book", "6a3f86", 4.8, 32),
                    ("grey book", "7f8488", 3.8, 27),
                    ("pink book", "d8809c", 3.0, 25),
                ),
            ),
            small.drum().at(0.16, -0.01, 0, 20),
        ],
    ]


def _second() -> list[list[Thing]]:
    white = painted(
        called(desk.teddy_bear(), "white bear"),
        {f"white bear {part}": fur("d8d4ca", "f4f2ec") for part in ("head", "body", "arms", "legs")},
    )
    ducks = several(
        *(
            called(desk.rubber_duck(), "bath duck").at(x, y, 0, turn, group="bath ducks", grow=0.75)
            for x, y, turn in ((0.08, -0.04, -100), (0.2, -0.02, -70))
        )
    )
    return [
        [
            small.blocks().at(-0.12, -0.01, 0, 5, grow=1.25),
            desk.ball().at(0.16, 0, 0, 20, (30, 10), grow=0.95),
        ],
        [desk.teddy_bear().at(-0.13, 0.05, 0, 10, group="teddy bear", grow=1.15), *ducks],
        [
            small.basket("basket").at(-0.05, 0, 0, 15, group="basket with yarn"),
            small.yarn("green yarn", "3f8a4f", "8fcf8a").at(
                -0.1, -0.01, 0.03, 20, group="basket with yarn", grow=1.1
            ),
            small.yarn("purple yarn", "6f3f9a", "b08ad0").at(
                0.02, 0.0, 0.03, 50, group="basket with yarn", grow=1.1
            ),
            garden.pumpkin().at(0.23, 0.0, 0, 20, group="pumpkin", grow=0.5),
        ],
        [white.at(0.12, 0.05, 0, -14, grow=1.15), garden.gnome().at(-0.16, 0.0, 0, 14, grow=0.55)],
        [
            painted(
                called(furniture.cushion(), "green cushion"),
                {"green cushion": checked("3f7f5a", "e0e8d0", (0, 1), 3.4)},
            ).at(-0.07, 0.05, 0.175, 4, (74, 0), grow=1.05),
            _mug("yellow mug", "e0b030", "7a5a20").at(0.23, -0.04, 0, -150),
        ],
    ]


def _lowest() -> list[list[Thing]]:
    return [
        [
            small.storage_box("blue box", "3f6fa0", "2a4a70").at(
                -0.13, 0.02, 0, 0, group="storage boxes", grow=0.98
            ),
            small.storage_box("red box", "b8483f", "7a2c28").at(
                0.16, 0.01, 0, 3, group="storage boxes", grow=0.9
            ),
        ],
        [garden.watering_can().at(0.02, 0, 0, 200, grow=0.9)],
        [small.storage_box("wooden chest", "9a6a3a", "6a4522", 44, 27).at(-0.02, 0.02, 0, 0)],
        [
            painted(
                called(furniture.vase(), "tall vase"), {"tall vase": gradient("2f5a56", "8fc4b0", 2, 0, 20)}
            ).at(-0.2, 0, 0, grow=1.5),
            small.storage_box("cream box", "e4d8bc", "b89a6a").at(0.11, 0.02, 0, 0),
        ],
        [
            small.storage_box("green box", "5f8f5a", "3a6038", 34, 16).at(
                -0.05, 0.02, 0, 0, group="green box"
            ),
            desk.book("brown book", "6f4a2c", 26, 18, 4.4).at(-0.06, 0.0, 0.163, 8, group="brown book"),
            tableware.donut().at(0.21, -0.05, 0, 0, group="donut", grow=1.0),
        ],
    ]


def look(step: int, count: int, held_out: bool, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Move along a flat arc before the shelves at changing heights; each camera looks at its own part of the wall."""
    along, phase = (step + 0.5) / count, 0.37 * held_out
    swing = np.radians(-32 + 64 * along + rng.uniform(-2, 2))
    rise = np.sin(2 * np.pi * (along * 4 + phase))
    away = 2.15 + 0.25 * np.cos(2 * np.pi * (along * 3 + phase))
    aim = np.array([1.05 * np.sin(swing * 1.6), -0.1, 1.08 + 0.36 * rise])
    aim += rng.uniform(-1, 1, 3) * [0.1, 0.0, 0.06]
    return np.array([2.1 * np.sin(swing), -0.1 - away * np.cos(swing), 1.3 + 0.3 * rise]), aim


SHELVES = Layout(
    "shelves",
    "wall of shelves",
    make_shelves,
    look,
    Light(
        np.array([-0.02, -0.25, 1.2]),
        frozenset({"wall", "floor"}),
        sun=np.array([-0.4, -0.78, 0.48]),
        eye=np.array([0.0, -1.0, 0.15]),
        shadow_size=768,
    ),
    ("teapot", "robot", "fruit bowl", "toy rocket", "red book"),
)
