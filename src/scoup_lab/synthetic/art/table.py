"""The table: a table-top in the corner of a room with everything on and around it, seen from its open sides.

z is up, metres; the table's centre is above the origin.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from scoup_lab.synthetic.art.layout import Layout
from scoup_lab.synthetic.art.lighting import Light
from scoup_lab.synthetic.art.meshes import Floats

TARGET = np.array([0.0, 0.02, 0.86])  # metres: just above the middle of the table
LAMP = np.array([0.5, 0.26, 1.1])  # metres: the light bulb, just below the shade


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
    Path(__file__).with_name("table.npz"),
    look,
    Light(LAMP, frozenset({"wall", "floor"})),
    ("teapot", "rubber duck", "fruit bowl", "alarm clock", "sunflowers"),
)
