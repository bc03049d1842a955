"""The shelves: a wall of shelves full of small things, seen from the front along a flat arc. Many names and fine
parts, little parallax; boards and neighbours hide one thing behind another.

z is up, metres; the foot of the shelves' back is the x axis, and they face -y.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from scoup_lab.synthetic.art.layout import Layout
from scoup_lab.synthetic.art.lighting import Light
from scoup_lab.synthetic.art.meshes import Floats


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
    Path(__file__).with_name("shelves.npz"),
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
