"""A layout: the things of a scene, its light, and its cameras."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scoup.scene import Camera, Cameras
from scoup_lab.synthetic.art.baked import read_things
from scoup_lab.synthetic.art.lighting import Light
from scoup_lab.synthetic.art.meshes import Floats
from scoup_lab.synthetic.art.things import Thing

CameraPath = Callable[[int, int, bool, np.random.Generator], tuple[Floats, Floats]]
"""``path(step, count, held_out, rng)``: eye [3] and aim [3] of one of ``count`` cameras, z up, metres."""


@dataclass(frozen=True, eq=False)
class Layout:
    """A kind of scene."""

    name: str  # of scenes of this layout
    title: str  # what it shows, in words that follow "A"
    file: Path  # its things (``baked``)
    path: CameraPath  # no held-out camera has the position of a building camera
    light: Light
    favourites: tuple[str, ...]  # names worth showing in pictures, the best known first
    field_of_view: float = 58.0  # degrees, horizontal

    def things(self) -> tuple[Thing, ...]:
        """Return all things, placed; z is up, metres."""
        return read_things(self.file)

    def cameras(
        self, n_building: int, n_held_out: int, width: int, height: int, rng: np.random.Generator
    ) -> tuple[Cameras, Cameras]:
        """Return building cameras and held-out cameras along the path."""
        focal = width / 2 / np.tan(np.radians(self.field_of_view) / 2)

        def along(name: str, count: int, held_out: bool) -> Cameras:
            ends = (self.path(step, count, held_out, rng) for step in range(count))
            return Cameras(
                Camera.look_at(eye, aim, f"{name}_{step:02d}.png", width, height, focal)
                for step, (eye, aim) in enumerate(ends)
            )

        return along("view", n_building, False), along("held_out", n_held_out, True)
