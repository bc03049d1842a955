"""The table: a table-top in the corner of a room with everything on and around it, seen from its open sides."""

from __future__ import annotations

import numpy as np

from scoup_lab.synthetic.art import desk_things as desk
from scoup_lab.synthetic.art import furniture, tableware
from scoup_lab.synthetic.art.layout import Layout
from scoup_lab.synthetic.art.lighting import Light
from scoup_lab.synthetic.art.meshes import Floats
from scoup_lab.synthetic.art.things import Thing

LEFT, BACK, REACH, HEIGHT = -1.55, 1.3, 5.4, 2.3  # metres: the walls x = LEFT and y = BACK
TOP = furniture.TABLE_HEIGHT / 100
TARGET = np.array([0.0, 0.02, 0.86])  # metres: just above the middle of the table
LAMP = np.array([0.5, 0.26, 1.1])  # metres: the light bulb, just below the shade


def table_things() -> tuple[Thing, ...]:
    """Return all things, placed. z is up, metres; the table's centre is above the origin."""
    floor, wall = furniture.room_shell(LEFT * 100, BACK * 100, REACH * 100, HEIGHT * 100)
    return (
        floor,
        wall,
        furniture.rug(92).at(0.15, -0.2, 0.0),
        furniture.table(150, 92).at(0, 0, 0),
        *_tea_things(),
        *_fruit(),
        *_books(),
        *_desk_things(),
        *_toys(),
        furniture.vase().at(-0.1, 0.29, TOP, 20, group="vase with flowers"),
        furniture.sunflowers().at(-0.1, 0.29, TOP, 200, group="vase with flowers"),
        tableware.bottle().at(0.62, 0.02, TOP, 140),
        desk.candle().at(0.07, 0.08, TOP, -70, grow=0.95),
        furniture.chair().at(-1.02, -0.42, 0, 70, group="chair with cushion"),
        furniture.cushion().at(-1.02, -0.42, 0.445, 85, group="chair with cushion"),
        furniture.picture(74, 52).at(0.78, BACK, 1.52),
        furniture.window(96, 92).at(LEFT, -0.25, 1.5, 90),
        furniture.shelf(92).at(-0.42, BACK, 1.34, group="shelf with things"),
        furniture.globe().at(-0.66, BACK - 0.11, 1.34, 200, group="shelf with things"),
        furniture.potted_plant().at(-0.22, BACK - 0.11, 1.34, group="shelf with things", grow=1.05),
    )


def _tea_things() -> tuple[Thing, ...]:
    group = "tea set"
    return (
        tableware.teapot().at(-0.33, -0.21, TOP, 25, group=group, grow=1.1),
        tableware.mug().at(-0.14, -0.33, TOP, -60, group=group, grow=1.05),
        tableware.plate().at(-0.53, -0.31, TOP, group=group),
        tableware.donut().at(-0.53, -0.31, TOP + 0.008, 30, group=group, grow=1.1),
        tableware.kettle().at(-0.58, 0.12, TOP, -35, group=group, grow=1.05),
    )


def _fruit() -> tuple[Thing, ...]:
    group, x, y, rest = "fruit bowl", 0.3, -0.2, TOP + 0.028
    return (
        tableware.bowl().at(x, y, TOP, group=group, grow=1.1),
        tableware.apple().at(x - 0.065, y - 0.04, rest + 0.012, 40, (0, 0), group, 1.05),
        tableware.orange().at(x + 0.04, y - 0.065, rest + 0.012, 0, group=group, grow=1.05),
        tableware.pear().at(x - 0.02, y + 0.07, rest + 0.012, 10, (-22, 8), group, 1.05),
        tableware.banana().at(x + 0.01, y + 0.005, rest + 0.062, -35, (8, 0), group, 1.1),
        tableware.grapes().at(x + 0.085, y + 0.035, rest + 0.022, 60, group=group),
    )


def _books() -> tuple[Thing, ...]:
    group, x, y = "stack of books", -0.3, 0.2
    return (
        desk.book("blue book", "2c4a86", 26, 19, 3.6).at(x - 0.02, y + 0.05, TOP, 12, group=group),
        desk.book("green book", "3a7a4c", 24, 17, 3.0).at(x - 0.01, y + 0.05, TOP + 0.036, -4, group=group),
        desk.book("red book", "b03434", 21, 15, 3.4).at(x - 0.02, y + 0.05, TOP + 0.066, 24, group=group),
        desk.alarm_clock().at(x - 0.02, y + 0.05, TOP + 0.1, 18, group="alarm clock"),
    )


def _desk_things() -> tuple[Thing, ...]:
    group = "laptop and lamp"
    return (
        desk.laptop().at(0.3, 0.2, TOP, -22, group=group),
        desk.desk_lamp().at(0.6, 0.3, TOP, 200, group=group, grow=1.05),
        desk.photo_camera().at(0.56, -0.16, TOP, -12, group="camera", grow=1.05),
    )


def _toys() -> tuple[Thing, ...]:
    group = "toys"
    return (
        desk.teddy_bear().at(0.64, -0.33, TOP, 30, group=group, grow=1.0),
        desk.toy_car().at(0.02, -0.38, TOP, 20, group=group, grow=0.8),
        desk.rubber_duck().at(0.08, -0.17, TOP, -50, group=group, grow=0.95),
        desk.ball().at(0.98, -0.62, 0, 20, (30, 10), group=group),
    )


def look(step: int, count: int, held_out: bool, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Swing around the table's open sides at changing heights and distances; each camera has an aim of its own."""
    along, phase = (step + 0.5) / count, 0.37 * held_out
    azimuth = np.radians(-122 + 132 * along + rng.uniform(-2, 2))
    rise = np.sin(2 * np.pi * (along * 3 + phase))
    distance = 1.42 + 0.2 * np.cos(2 * np.pi * (along * 2 + phase)) + 0.25 * along
    eye = np.array([distance * np.cos(azimuth), distance * np.sin(azimuth), 1.44 + 0.24 * rise])
    return eye, TARGET + rng.uniform(-1, 1, 3) * [0.1, 0.08, 0.04]


TABLE = Layout(
    "table",
    "table-top",
    table_things,
    look,
    Light(LAMP, frozenset({"wall", "floor"})),
    ("teapot", "rubber duck", "fruit bowl", "alarm clock", "sunflowers"),
)
