"""The hall: a large room with plain walls and furniture along them, seen from inside. The cameras are on a small loop
in its middle and look outwards all the way round, so that any one thing is in few views."""

from __future__ import annotations

import numpy as np

from benchmarks.scenes import hall_things
from benchmarks.scenes import large_furniture as large
from benchmarks.scenes.alterations import broader, called, finer, painted, several
from scoup_lab.synthetic.art import desk_things as desk
from scoup_lab.synthetic.art import furniture, tableware
from scoup_lab.synthetic.art.layout import Layout
from scoup_lab.synthetic.art.lighting import Light
from scoup_lab.synthetic.art.meshes import Floats, box, merged, plane
from scoup_lab.synthetic.art.paints import checked, color, smooth_noise, solid, wood
from scoup_lab.synthetic.art.things import Piece, Thing

EAST, NORTH, HEIGHT = 4.4, 3.6, 2.9  # metres: walls at x = +-EAST and y = +-NORTH
LOOP = (1.15, 0.8)  # metres: half the axes of the loop of cameras
TO_NORTH, TO_WEST, TO_SOUTH, TO_EAST = 0, 90, 180, -90  # turns that put a thing's back to a wall
BROADER = 2.6  # how much further apart Gaussians lie than on the table
DESK = furniture.TABLE_HEIGHT / 100


def make_hall() -> tuple[Thing, ...]:
    """Return all things of the hall, placed; the middle of the floor is the origin."""
    things = (*_shell(), *_north(), *_west(), *_south(), *_east())
    return tuple(broader(thing, BROADER) for thing in things)


def _shell() -> tuple[Thing, ...]:
    x, y, z = EAST * 100, NORTH * 100, HEIGHT * 100

    def plaster(points: Floats, normals: Floats) -> Floats:
        tone = 1 + 0.03 * smooth_noise(points, 60, 1) + 0.012 * smooth_noise(points, 9, 2)
        return np.clip(color("cfc4b0") * tone[:, None], 0, 1)

    corners = ((-x, y), (-x, -y), (x, -y), (x, y))
    walls, strips = [], []
    for (x0, y0), (x1, y1) in zip(corners, (*corners[1:], corners[0]), strict=True):
        # Across and up make the normal point into the room.
        walls.append(plane((x1, y1, 0), (x0 - x1, y0 - y1, 0), (0, 0, z), 20))
        inwards = np.sign([-(x0 + x1), -(y0 + y1)]) * 0.8
        for middle, height in ((5.0, 10.0), (z - 4, 8.0)):
            size = (abs(x0 - x1) + 1.6, abs(y0 - y1) + 1.6, height)
            strips.append(box(size, 0.5, ((x0 + x1) / 2 + inwards[0], (y0 + y1) / 2 + inwards[1], middle)))
    floor = plane((-x, -y, 0), (2 * x, 0, 0), (0, 2 * y, 0), 20)
    ceiling = plane((-x, -y, z), (2 * x, 0, 0), (0, 2 * y, 0), 20).flipped()
    boards = wood("8f6a48", 0, 9, planks=18, contrast=0.12)
    return (
        Thing("floor", (Piece("floor", floor, boards, 0.2),)),
        Thing("ceiling", (Piece("ceiling", ceiling, solid("f2efe8", 0.015, 40), 0.08, glow=0.7),)),
        Thing(
            "wall",
            (Piece("wall", merged(walls), plaster, 0.1), Piece("wall", merged(strips), solid("f4f0e6"), 0.3)),
        ),
    )


def _north() -> tuple[Thing, ...]:
    """Return the fireplace, with an armchair on either side."""
    fire, chairs = "fireplace with mantel things", "reading corner"
    mantel = 1.28
    return (
        hall_things.fireplace().at(0, NORTH, 0, TO_NORTH, group=fire),
        desk.alarm_clock().at(0.02, NORTH - 0.2, mantel, 4, group=fire, grow=1.6),
        desk.candle().at(-0.55, NORTH - 0.2, mantel, 30, group=fire, grow=1.4),
        finer(furniture.vase(), 0.9).at(0.55, NORTH - 0.2, mantel, 0, group=fire, grow=1.3),
        furniture.picture(120, 84).at(0, NORTH, 2.15),
        large.sofa("armchair", 96, 1, "3f6f5a").at(-1.75, NORTH - 0.35, 0, 28, group=chairs),
        desk.teddy_bear().at(-1.53, NORTH - 0.77, 0.505, 25, group=chairs, grow=1.5),
        large.side_table("side table", 28, 55, "6a4a30").at(-2.62, NORTH - 0.5, 0, group=chairs),
        desk.desk_lamp().at(-2.65, NORTH - 0.42, 0.55, -50, group=chairs, grow=1.25),
        hall_things.tall_clock().at(1.75, NORTH, 0, TO_NORTH),
        large.wardrobe(140, 215).at(3.2, NORTH, 0, TO_NORTH),
        called(finer(furniture.potted_plant(), 0.45), "palm").at(
            -3.75, NORTH - 0.62, 0, group="palm", grow=4.6
        ),
    )


def _west() -> tuple[Thing, ...]:
    """Return a dining table before the window."""
    group, x, y = "dining table set", -EAST + 1.0, -0.2
    top = DESK
    chairs = several(
        *(
            called(finer(furniture.chair(), 1.5), "dining chair").at(x + dx, y + dy, 0, turn, group=group)
            for dx, dy, turn in ((0.62, -0.45, -84), (0.64, 0.42, -97), (0.02, -1.16, 176), (0.0, 1.17, 5))
        )
    )
    return (
        called(furniture.table(170, 90), "dining table").at(x, y, 0, 90, group=group),
        *chairs,
        tableware.bowl().at(x + 0.06, y + 0.02, top, group="fruit bowl", grow=1.25),
        tableware.apple().at(x, y - 0.02, top + 0.045, 30, group="fruit bowl", grow=1.3),
        tableware.orange().at(x + 0.12, y - 0.04, top + 0.045, 0, group="fruit bowl", grow=1.3),
        tableware.banana().at(x + 0.07, y + 0.09, top + 0.075, 70, (8, 0), "fruit bowl", 1.3),
        tableware.teapot().at(x + 0.1, y - 0.48, top, 100, group="tea set", grow=1.3),
        tableware.mug().at(x + 0.2, y - 0.26, top, 70, group="tea set", grow=1.2),
        tableware.plate().at(x + 0.12, y + 0.5, top, group="tea set", grow=1.2),
        tableware.donut().at(x + 0.12, y + 0.5, top + 0.009, 20, group="tea set", grow=1.3),
        furniture.window(170, 130).at(-EAST, y, 1.65, TO_WEST, group="window with curtains"),
        hall_things.curtains(48, 210, 190, "a83f3a").at(-EAST, y, 2.5, TO_WEST, group="window with curtains"),
    )


def _south() -> tuple[Thing, ...]:
    """Return the sofa, a lamp and a chest."""
    group = "sofa with cushions"
    red = called(furniture.cushion(), "red cushion")
    blue = painted(
        called(furniture.cushion(), "blue cushion"),
        {"blue cushion": checked("2f5f9c", "d8e4ee", (0, 1), 3.4)},
    )
    return (
        large.sofa("sofa", 225, 3, "c79a4c").at(-0.5, -NORTH + 0.06, 0, TO_SOUTH, group=group),
        red.at(-1.22, -NORTH + 0.5, 0.62, 170, (64, 0), group, 1.15),
        blue.at(0.2, -NORTH + 0.5, 0.62, 195, (64, 0), group, 1.15),
        hall_things.floor_lamp().at(-2.15, -NORTH + 0.42, 0),
        furniture.shelf(130).at(-0.5, -NORTH, 1.75, TO_SOUTH, group="shelf with things"),
        furniture.globe().at(-0.1, -NORTH + 0.12, 1.75, 20, group="shelf with things", grow=1.25),
        *(
            desk.book(name, code, 26, 19, thick).at(
                -0.98 + along, -NORTH + 0.12, 1.88, 180, (0, 90), "shelf with things"
            )
            for name, code, thick, along in (
                ("red book", "b03434", 4.6, 0.0),
                ("green book", "3a7a4c", 3.8, 0.045),
                ("blue book", "2c4a86", 5.0, 0.085),
                ("yellow book", "d0a02c", 4.2, 0.135),
            )
        ),
        large.cabinet("chest", 120, 84, "7f5a38").at(1.95, -NORTH, 0, TO_SOUTH, group="chest with plant"),
        furniture.potted_plant().at(1.7, -NORTH + 0.22, 0.84, group="chest with plant", grow=1.7),
        desk.photo_camera().at(2.28, -NORTH + 0.24, 0.84, 165, group="chest with plant", grow=1.4),
        hall_things.tall_jar("floor vase", "2f5f78", "e0d4b8").at(3.7, -NORTH + 0.55, 0),
        desk.ball().at(0.98, -NORTH + 0.75, 0, 30, (20, 10), grow=1.3),
        hall_things.tall_jar("clay jar", "b5673c", "7c3f26").at(-3.6, -NORTH + 0.55, 0, grow=0.9),
    )


def _east() -> tuple[Thing, ...]:
    """Return the television, and a bookcase."""
    group = "television with cabinet"
    case, wide, tall, rows = "bookcase with books", 1.2, 2.1, 5
    _, boards = large.cells(wide * 100, tall * 100, 1, rows)
    x, y = EAST - 0.06, 2.05  # clear of the wall, whose large Gaussians would show through the back
    specs = (
        ("b03434", "crimson"),
        ("2c4a86", "navy"),
        ("3a7a4c", "emerald"),
        ("c98a2c", "amber"),
        ("6a3f78", "purple"),
    )
    rng = np.random.default_rng(3)
    books: list[Thing] = []
    for shelf, (code, word) in zip(boards[::-1], specs, strict=True):
        along = -wide / 2 + 0.06
        row: list[Thing] = []
        while along < wide / 2 - 0.3 - 0.2 * rng.random():
            thick, length = 3.0 + 2.4 * rng.random(), 23 + 5 * rng.random()
            volume = desk.book(f"{word} books", code, length, 19, thick)
            row.append(volume.at(x - 0.15, y - along, shelf / 100 + length / 200, TO_EAST, (0, 90), case))
            along += thick / 100 + 0.002
        books += several(*row)
    return (
        large.cabinet("television cabinet", 190, 52, "4f3a2a").at(EAST, -0.75, 0, TO_EAST, group=group),
        hall_things.television(135).at(EAST - 0.06, -0.75, 0.52, TO_EAST, group=group),
        large.shelf_unit("bookcase", wide * 100, tall * 100, 30, 1, rows, "9c7448", 0.5).at(
            x, y, 0, TO_EAST, group=case
        ),
        *books,
        desk.toy_car().at(EAST - 0.75, -2.0, 0, -60, group="toys", grow=2.2),
        desk.rubber_duck().at(EAST - 0.62, -2.62, 0, 200, group="toys", grow=1.7),
        called(furniture.picture(96, 70), "small picture").at(EAST, -2.35, 1.6, TO_EAST),
    )


def look(step: int, count: int, held_out: bool, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Turn once around, looking outwards from the loop; held-out cameras look between the others."""
    phase = 0.37 * held_out
    turn = 2 * np.pi * (step + phase + rng.uniform(-0.1, 0.1)) / count
    rise = 0.22 * np.sin(5 * turn + 2 * np.pi * phase)
    eye = np.array([LOOP[0] * np.cos(turn), LOOP[1] * np.sin(turn), 1.45 + rise])
    away = turn + np.radians(rng.uniform(-8, 8))
    return eye, eye + np.array([3 * np.cos(away), 3 * np.sin(away), -0.42 - rise + rng.uniform(-0.12, 0.12)])


HALL = Layout(
    "hall",
    "hall seen from its middle",
    make_hall,
    look,
    Light(
        np.array([-2.15, -NORTH + 0.42, 1.3]),
        frozenset({"wall", "floor", "ceiling"}),
        sun=np.array([-0.62, -0.22, 0.62]) / np.linalg.norm([-0.62, -0.22, 0.62]),
        eye=np.array([0.0, 0.0, 1.0]),
        lamp_strength=0.3,
        shadow_size=1024,
        shadow_gap=0.025,
    ),
    ("sofa", "television", "dining table set", "fireplace", "globe"),
    field_of_view=66,
)
