"""The yard: a group of things round a fountain in the middle of a garden, seen from a ring of cameras at two heights.
Few things, each in many views, before large surfaces far behind: lawn, hedge, sky."""

from __future__ import annotations

import numpy as np

from benchmarks.scenes import garden_grounds as grounds
from benchmarks.scenes import garden_things as garden
from benchmarks.scenes.alterations import broader, called, finer, several
from scoup_lab.synthetic.art import desk_things as desk
from scoup_lab.synthetic.art import furniture
from scoup_lab.synthetic.art.layout import Layout
from scoup_lab.synthetic.art.lighting import Light
from scoup_lab.synthetic.art.meshes import Floats
from scoup_lab.synthetic.art.things import Thing

HALF = 7.0  # metres: half the width of the garden inside its hedge
RADIUS = 3.5  # metres: of the ring of cameras
HEIGHTS = (1.05, 2.15)  # metres: of its two levels
TARGET = np.array([0.0, 0.0, 0.55])
BROADER = 1.8  # how much further apart Gaussians lie than on the table


def make_yard() -> tuple[Thing, ...]:
    """Return all things of the yard, placed; the fountain stands on the origin."""
    return tuple(broader(thing, BROADER) for thing in (*_garden(), *_middle()))


def _garden() -> tuple[Thing, ...]:
    trees = several(
        *(
            grounds.tree(seed, tall).at(x, y, 0, 40 * seed)
            for seed, x, y, tall in (
                (1, -9.2, 4.5, 560),
                (2, -8.6, -6.8, 480),
                (3, 9.5, 6.4, 600),
                (4, 8.8, -4.2, 500),
                (5, 2.4, -9.6, 540),
                (6, -2.8, 10.4, 620),
            )
        )
    )
    return (
        grounds.sky(1700).at(0, 0, 0),
        grounds.lawn(1400).at(0, 0, 0),
        grounds.hedge(HALF * 100, 170, 70, 620).at(0, 0, 0),
        grounds.shed(340, 240, 210).at(0.3, HALF + 0.3, 0),
        *trees,
    )


def _middle() -> tuple[Thing, ...]:
    barrow, seat, tubs = "wheelbarrow with pumpkins", "bench with teddy bear", "flower pots"
    top = 0.03
    pumpkins = several(
        garden.pumpkin().at(0.98, -1.08, 0.375, 20, (6, 0), barrow, 0.95),
        garden.pumpkin().at(1.2, -0.88, 0.385, 70, (-10, 5), barrow, 0.85),
        garden.pumpkin().at(1.62, -0.42, top, 130, group=barrow, grow=1.25),
    )
    plants = several(
        *(
            finer(called(furniture.potted_plant(), "fern"), 0.7).at(x, y, top, turn, group=tubs, grow=grow)
            for x, y, turn, grow in (
                (-0.95, -0.95, 0, 2.2),
                (-1.35, -0.62, 100, 1.7),
                (0.12, -1.42, 200, 1.5),
            )
        )
    )
    return (
        grounds.paving(225).at(0, 0, 0),
        garden.fountain().at(0, 0, top),
        garden.wheelbarrow().at(1.1, -0.98, top, -142, group=barrow),
        *pumpkins,
        garden.bench(150, "9c6b40").at(0.25, 1.45, top, 8, group=seat),
        desk.teddy_bear().at(0.58, 1.4, top + 0.456, 6, group=seat, grow=1.7),
        furniture.cushion().at(-0.14, 1.42, top + 0.6, 10, (62, 0), seat, 1.15),
        garden.watering_can().at(-0.55, -1.35, top, 210),
        garden.gnome().at(-1.5, 0.35, top, -70),
        garden.bird_house().at(1.65, 0.75, top, 130),
        furniture.vase().at(-1.2, 1.05, top, 20, group="vase with sunflowers", grow=2.3),
        finer(furniture.sunflowers(), 0.7).at(-1.2, 1.05, top, 80, group="vase with sunflowers", grow=2.3),
        desk.ball().at(1.35, 0.05, top, 20, (30, 10), grow=1.3),
        desk.rubber_duck().at(0.42, -0.34, top + 0.345, 70, grow=1.9),
        *plants,
    )


def look(step: int, count: int, held_out: bool, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Turn once around at two heights in turn; held-out cameras stand between them and between the heights."""
    heights, phase = ((1.5,), 0.31) if held_out else (HEIGHTS, 0.0)
    turn = 2 * np.pi * (step + phase + rng.uniform(-0.15, 0.15)) / count
    away = RADIUS + rng.uniform(-0.15, 0.15)
    level = heights[step % len(heights)] + rng.uniform(-0.08, 0.08)
    eye = np.array([away * np.cos(turn), away * np.sin(turn), level])
    return eye, TARGET + rng.uniform(-1, 1, 3) * [0.15, 0.15, 0.08]


YARD = Layout(
    "yard",
    "fountain in a garden",
    make_yard,
    look,
    Light(
        np.array([0.3, 6.6, 1.4]),  # by the door of the shed, where it lights nothing that matters
        frozenset({"sky", "lawn", "hedge", "tree", "garden shed"}),
        eye=np.array([0.0, 0.0, 1.0]),
        shadow_size=768,
        shadow_gap=0.018,
    ),
    ("fountain", "gnome", "wheelbarrow with pumpkins", "watering can", "teddy bear"),
)
