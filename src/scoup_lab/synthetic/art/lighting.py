"""Light baked into the colours: soft sun, sky light with its occlusion, a lamp and highlights.

The z-buffer finds what blocks the light: it draws the scene once from each of many directions.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from scoup_lab.synthetic.art.meshes import Floats, Mesh
from scoup_lab.synthetic.art.zbuffer import draw

SUN = np.array([-0.52, -0.42, 0.74])  # towards the sun
SUN_COLOR = np.array([1.0, 0.94, 0.83]) * 1.75
SKY_COLOR = np.array([0.86, 0.93, 1.0]) * 0.46
FLOOR_COLOR = np.array([1.0, 0.88, 0.76]) * 0.2  # light thrown back up by the floor and the table
LAMP_COLOR = np.array([1.0, 0.78, 0.45])
EYE = np.array([0.28, -0.75, 0.6])  # where highlights are seen from: the middle of the cameras
SHADOW_SIZE = 512  # pixels on each side of a picture taken from a light's direction
SHADOW_GAP = 0.012  # metres: how far behind a blocker a point must lie to be in its shadow


@dataclass(frozen=True, eq=False)
class Light:
    """The light of a scene."""

    lamp: Floats  # [3] position of a small warm light, metres
    # names of things that throw no shadow, because light has to come in through them
    shell: frozenset[str] = frozenset()
    sun: Floats = field(default_factory=SUN.copy)  # [3] unit vector towards the sun
    # [3] direction that highlights are seen from: the middle of the cameras
    eye: Floats = field(default_factory=EYE.copy)
    lamp_strength: float = 0.022  # of the lamp; the light of one at a metre's distance
    shadow_size: int = SHADOW_SIZE  # pixels on each side of a picture taken from a light's direction
    # metres that a point must lie behind a blocker to be in its shadow: about two of those pixels, or
    # surfaces at an angle to the light would shade themselves
    shadow_gap: float = SHADOW_GAP


def lit(
    points: Floats,
    normals: Floats,
    albedo: Floats,
    gloss: Floats,
    glow: Floats,
    blockers: Mesh,
    light: Light,
    n_directions: int = 30,
) -> Floats:
    """Return shaded colours of points on surfaces.

    ``points``, ``normals``: [n, 3] in metres; unit normals; ``albedo``: [n, 3] sRGB, 0..1; ``gloss``,
    ``glow``: [n] 0..1. Returns [n, 3] sRGB, 0..1.
    """
    normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    received = (0.5 - 0.5 * normals[:, 2:3]) * FLOOR_COLOR
    n_sun = max(1, n_directions // 3)
    n_sky = max(1, n_directions - n_sun)
    spread = _hemisphere(n_sun, np.sqrt(0.02)) @ _frame(light.sun)
    sky = _hemisphere(n_sky, 0.98)
    sun_seen = np.zeros(len(points))
    for directions, strength in ((spread, SUN_COLOR / n_sun), (sky, SKY_COLOR * 2.6 / n_sky)):
        for direction in directions:
            facing = (normals @ direction).clip(0) * visible(points, normals, direction, blockers, light)
            received += facing[:, None] * strength
            if directions is spread:
                sun_seen += (facing > 0) / n_sun
    to_lamp = light.lamp - points
    distance = np.linalg.norm(to_lamp, axis=1)
    facing = np.einsum("nd,nd->n", normals, to_lamp).clip(0) / np.maximum(distance, 1e-6)
    received += (facing * light.lamp_strength / (distance**2 + 0.02))[:, None] * LAMP_COLOR

    half = light.sun / np.linalg.norm(light.sun) + light.eye / np.linalg.norm(light.eye)
    aligned = (normals @ (half / np.linalg.norm(half))).clip(0)
    shine = gloss * (0.15 + 0.85 * sun_seen) * (0.9 * aligned**90 + 0.16 * aligned**14)
    linear = np.asarray(albedo, float) ** 2.2
    shown = linear * received * (1 - glow[:, None]) + linear * glow[:, None] * 1.05 + shine[:, None]
    # A gentle shoulder keeps bright places coloured instead of clipping them.
    shown = np.where(shown > 0.7, 0.7 + 0.3 * np.tanh((shown - 0.7) / 0.3 * 0.8), shown)
    return shown.clip(0, 1) ** (1 / 2.2)


def visible(points: Floats, normals: Floats, direction: Floats, blockers: Mesh, light: Light) -> Floats:
    """Return [n] share 0..1 of the light from ``direction`` (unit, towards the light) that reaches each
    point [n, 3]."""
    size, gap = light.shadow_size, light.shadow_gap
    frame = _frame(direction)
    flat = blockers.vertices @ frame.T
    low, high = flat.min(0), flat.max(0)
    scale = size / (high[:2] - low[:2]).max()
    _, seen = draw((flat[:, :2] - low[:2]) * scale, flat[:, 2] - low[2] + 1.0, blockers.faces, size, size)
    # Points are lifted off their surface, so that a surface seen at an angle does not shade itself.
    spot = (points + normals * gap * 0.5) @ frame.T
    position, height = (spot[:, :2] - low[:2]) * scale - 0.5, spot[:, 2] - low[2] + 1.0
    corner = np.floor(position).astype(int)
    share = position - corner
    total = np.zeros(len(points))
    for step_x in (0, 1):
        for step_y in (0, 1):
            x, y = corner[:, 0] + step_x, corner[:, 1] + step_y
            inside = (x >= 0) & (x < size) & (y >= 0) & (y < size)
            blocker = np.where(inside, seen[y.clip(0, size - 1), x.clip(0, size - 1)], 0)
            weight = np.abs(1 - step_x - share[:, 0]) * np.abs(1 - step_y - share[:, 1])
            total += weight * (height > blocker - gap)
    return total


def _hemisphere(count: int, widest: float) -> Floats:
    """Return [count, 3] directions evenly over the cap about +z whose rim has sine ``widest``."""
    step = np.arange(count)
    height = 1 - (step + 0.5) / count * (1 - np.sqrt(1 - widest**2))
    turn = step * np.pi * (3 - np.sqrt(5))
    level = np.sqrt(1 - height**2)
    return np.stack([level * np.cos(turn), level * np.sin(turn), height], 1)


def _frame(direction: Floats) -> Floats:
    """Return [3, 3] rows: two directions across, and ``direction`` made unit."""
    along = direction / np.linalg.norm(direction)
    side = np.cross(along, np.eye(3)[np.abs(along).argmin()])
    side /= np.linalg.norm(side)
    return np.asarray(np.stack([side, np.cross(along, side), along]), np.float64)
