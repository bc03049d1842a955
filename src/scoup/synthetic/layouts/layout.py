"""What a layout of the demo is: the things of a scene, its light, and where it is seen from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from scoup.scene.cameras import Cameras
from scoup.synthetic.lighting import Light
from scoup.synthetic.things import Thing

CameraMaker = Callable[[int, int, int, int, np.random.Generator], tuple[Cameras, Cameras]]
"""``cameras(n_building, n_held_out, width, height, rng)``: cameras to build from, and others to judge by."""


@dataclass(frozen=True, eq=False)
class Layout:
    """A kind of scene.

    Attributes:
        name: what it is asked for by.
        title: what it shows, in words that follow "A".
        things: makes all things, placed; z is up, metres.
        cameras: makes the cameras; no held-out camera stands where a building camera does.
        light: the light of the scene.
        favourites: names worth showing in pictures, the best known first.
    """

    name: str
    title: str
    things: Callable[[], tuple[Thing, ...]]
    cameras: CameraMaker
    light: Light
    favourites: tuple[str, ...]
