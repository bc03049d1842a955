"""The hall: a large room with plain walls and furniture along them, seen from inside. The cameras are on a small loop
in its middle and look outwards all the way round, so that any one thing is in few views.

z is up, metres; the middle of the floor is the origin.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from scoup_lab.synthetic.art.layout import Layout
from scoup_lab.synthetic.art.lighting import Light
from scoup_lab.synthetic.art.meshes import Floats

NORTH = 3.6  # metres: the wall behind the fireplace is y = NORTH, the one across y = -NORTH
LOOP = (1.15, 0.8)  # metres: half the axes of the loop of cameras


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
    Path(__file__).with_name("hall.npz"),
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
