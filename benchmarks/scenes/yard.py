"""The yard: a group of things round a fountain in the middle of a garden, seen from a ring of cameras at two heights.
Few things, each in many views, before large surfaces far behind: lawn, hedge, sky.

z is up, metres; the fountain stands on the origin.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from scoup_lab.synthetic.art.layout import Layout
from scoup_lab.synthetic.art.lighting import Light
from scoup_lab.synthetic.art.meshes import Floats

RADIUS = 3.5  # metres: of the ring of cameras
HEIGHTS = (1.05, 2.15)  # metres: of its two levels
TARGET = np.array([0.0, 0.0, 0.55])


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
    Path(__file__).with_name("yard.npz"),
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
