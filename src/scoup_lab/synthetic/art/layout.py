"""A layout: the things of a scene, its light, and its cameras."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from scoup.scene.cameras import Camera, Cameras
from scoup_lab.synthetic.art.lighting import Light
from scoup_lab.synthetic.art.meshes import Floats
from scoup_lab.synthetic.art.things import Thing

FIELD_OF_VIEW = 58.0  # degrees, horizontal

CameraMaker = Callable[[int, int, int, int, np.random.Generator], tuple[Cameras, Cameras]]
"""``cameras(n_building, n_held_out, width, height, rng)``: building cameras, and held-out cameras."""


@dataclass(frozen=True, eq=False)
class Layout:
    """A kind of scene."""

    name: str  # of scenes of this layout
    title: str  # what it shows, in words that follow "A"
    things: Callable[[], tuple[Thing, ...]]  # makes all things, placed; z is up, metres
    cameras: CameraMaker  # makes the cameras; no held-out camera has the position of a building camera
    light: Light  # the light of the scene
    favourites: tuple[str, ...]  # names worth showing in pictures, the best known first


def aimed_camera(
    eye: Floats, target: Floats, name: str, width: int, height: int, field_of_view: float = FIELD_OF_VIEW
) -> Camera:
    """Return a camera at ``eye`` [3] that looks at ``target`` [3], z up; ``field_of_view`` is horizontal, in
    degrees."""
    focal = width / 2 / np.tan(np.radians(field_of_view) / 2)
    return Camera.look_at(eye, target, name, width, height, focal)
