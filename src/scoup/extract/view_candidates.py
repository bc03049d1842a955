"""Cameras that may be chosen for a bare splat: around it, and in the free space within."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from scoup.base import InputError
from scoup.extract import constants
from scoup.raster import raster_preset
from scoup.scene import Camera, Gaussians


@dataclass(frozen=True, eq=False)
class Matter:
    """The Gaussians that views are to show, and the frame in which they are looked at."""

    rows: Tensor  # [M] int64, the Gaussians that count: opaque, of sensible size and with neighbours
    means: Tensor  # [M, 3] float64, their centres
    axes: Tensor  # [3, 3] float64, rows: two horizontal directions and up
    low: Tensor  # [3] float64, the lower corner of the box of nearly all of them, along ``axes``
    high: Tensor  # [3] float64, its upper corner

    @property
    def radius(self) -> float:
        """Half the diagonal of the box."""
        return float((self.high - self.low).norm()) / 2

    @property
    def preset(self) -> str:
        """Inria's constants, with a nearer plane where theirs, in world units, lies deep in the scene."""
        near = constants.NEAR_PLANE * self.radius
        return f"inria:{near:g}" if near < raster_preset("inria").near else "inria"


def find_matter(gaussians: Gaussians) -> Tensor:
    """Return [M] int64: the Gaussians that are opaque, no larger than things are, and near others.

    Raises:
        InputError: none is.
    """
    usable = gaussians.finite() & (gaussians.opacities > 1 / 255)
    if not len(gaussians) or not bool(usable.any()):
        raise InputError("gaussians: nothing can be seen (no Gaussian is finite and opaque)")
    level = min(
        constants.MATTER_OPACITY,
        float(np.quantile(gaussians.opacities[usable].numpy(), 1 - constants.LEAST_MATTER)),
    )
    rows = (usable & (gaussians.opacities >= level)).nonzero().flatten()
    means, largest = gaussians.means[rows].double(), gaussians.scales[rows].amax(1).double()
    middle = means.median(0).values
    away = (means - middle).norm(dim=1)
    extent = float(away[:: max(1, len(away) // 1_000_000)].quantile(0.8))
    matter = rows[(largest <= 0.5 * extent) & (away <= 4 * extent)]
    matter = matter[_with_neighbours(gaussians.means[matter].double(), extent / 12)]
    if len(matter) < 2 or not extent > 0:
        raise InputError(f"gaussians: nothing to look at ({len(rows)} opaque Gaussians at one place)")
    return matter


def _with_neighbours(means: Tensor, side: float) -> Tensor:
    """Return [M] bool: whether the cubes of a grid around a point contain a fair number of the others."""
    if not len(means) or not side > 0:
        return torch.ones(len(means), dtype=torch.bool)
    cells = ((means - means.amin(0)) / side).floor().long()
    cells = cells.clamp(max=2**20)
    keys = (cells[:, 0] << 42) | (cells[:, 1] << 21) | cells[:, 2]
    _, number, counts = torch.unique(keys, return_inverse=True, return_counts=True)
    return counts[number] >= min(4, max(1, len(means) // 200))


def measure_matter(gaussians: Gaussians, rows: Tensor, up: Tensor) -> Matter:
    """Return the matter of ``rows`` in the frame in which ``up`` [3] is up."""
    axis = torch.eye(3, dtype=torch.float64)[int(up.abs().argmin())]
    first = torch.linalg.cross(up, axis)
    first = first / first.norm()
    axes = torch.stack([first, torch.linalg.cross(up, first), up])
    means = gaussians.means[rows].double()
    along = means[:: max(1, len(means) // 200_000)] @ axes.T
    ends = torch.quantile(along, torch.tensor([0.02, 0.98], dtype=torch.float64), dim=0)
    return Matter(rows, means, axes, ends[0], ends[1])


def candidate_cameras(matter: Matter, width: int, height: int) -> list[Camera]:
    """Return cameras on circles around the matter, and in all directions from places in its free space."""
    focal = width / (2 * math.tan(constants.ANGLE_OF_VIEW / 2))
    opening = min(width, height) / focal
    poses = [*_around(matter, opening), *_around_parts(matter, opening), *_within(matter)]
    return [
        camera
        for number, (eye, aim) in enumerate(poses)
        if (camera := look(eye, aim, matter, f"{number}", width, height, focal)) is not None
    ]


def nearby_cameras(cameras: Sequence[Camera], matter: Matter, draws: Tensor) -> list[Camera]:
    """Return cameras that stand a little beside each of some, and look a little beside what these look at: ``draws``
    [D, 5] in -1..1 are shares of the furthest move along each axis of the matter, and of the furthest turns aside and
    up."""
    nearby = []
    for camera in cameras:
        eye, forward = matter.axes @ camera.position, matter.axes @ camera.viewmat[2, :3]
        heading = math.atan2(float(forward[1]), float(forward[0]))
        pitch = math.asin(float(forward[2].clamp(-1, 1)))
        for draw in draws:
            position = eye + constants.MOVE * matter.radius * draw[:3]
            angle = heading + math.radians(constants.TURN) * float(draw[3])
            level = pitch + math.radians(constants.TURN) * float(draw[4])
            level = min(max(level, constants.LOWEST), constants.HIGHEST)
            aim = position + _way(angle, level)
            if (near := look(position, aim, matter, "", camera.width, camera.height, camera.fx)) is not None:
                nearby.append(near)
    return nearby


def _way(angle: float, level: float) -> Tensor:
    """Return the unit vector of a heading and a pitch in radians, along the axes of the matter."""
    flat = math.cos(level)
    return torch.tensor(
        (math.cos(angle) * flat, math.sin(angle) * flat, math.sin(level)), dtype=torch.float64
    )


def look(
    eye: Tensor, aim: Tensor, matter: Matter, name: str, width: int, height: int, focal: float
) -> Camera | None:
    """Return the camera at ``eye`` that shows ``aim``, both along the axes of the matter; None if it looks straight
    up or down.
    """
    way = aim - eye
    if float(way[:2].norm()) < 0.05 * float(way.norm()):
        return None
    places = (matter.axes.T @ eye, matter.axes.T @ aim)
    return Camera.look_at(places[0], places[1], name, width, height, focal, matter.axes[2])


def _around(matter: Matter, opening: float) -> list[tuple[Tensor, Tensor]]:
    along = matter.means[:: max(1, len(matter.means) // 50_000)] @ matter.axes.T
    centre = (along.clamp(matter.low, matter.high)).mean(0)
    full = matter.radius / (opening / 2) * 0.9
    poses = []
    for row, elevation in enumerate(constants.ELEVATIONS):
        for distance in constants.DISTANCES:
            for step in range(constants.AZIMUTHS):
                angle = 2 * math.pi * (step + 0.5 * (row % 2)) / constants.AZIMUTHS
                level = math.radians(elevation)
                poses.append((centre + distance * full * _way(angle, level), centre))
    return poses


def _around_parts(matter: Matter, opening: float) -> list[tuple[Tensor, Tensor]]:
    """Return poses at which one part of the matter each fills the image: where it is dense, parts are small."""
    along = matter.means[:: -(-len(matter.means) // 20_000)] @ matter.axes.T
    count = min(constants.PARTS, len(along))
    centres = along[torch.arange(count) * len(along) // count].clone()
    for _ in range(12):
        nearest = torch.cdist(along, centres).argmin(1)
        for index in range(count):
            if bool((nearest == index).any()):
                centres[index] = along[nearest == index].mean(0)
    nearest = torch.cdist(along, centres).argmin(1)
    poses = []
    for index, centre in enumerate(centres):
        members = along[nearest == index]
        size = float((members - centre).norm(dim=1).quantile(0.9)) if len(members) else 0.0
        if size < 1e-9 * matter.radius:  # all at one place
            continue
        for step in range(constants.AROUND_PART):
            angle = 2 * math.pi * (step + 0.37 * index) / constants.AROUND_PART
            level = math.radians(constants.ELEVATIONS[(step + index) % len(constants.ELEVATIONS)])
            poses.append((centre + 1.3 * size / (opening / 2) * _way(angle, level), centre))
    return poses


def _within(matter: Matter) -> list[tuple[Tensor, Tensor]]:
    """Return poses at places that are spread over the free space in and around the box."""
    from scipy import ndimage
    from scipy.stats import qmc

    margin = 0.25 * (matter.high - matter.low) + 0.05 * matter.radius
    low, high = matter.low - margin, matter.high + margin
    side = float((high - low).max()) / constants.CELLS
    shape = ((high - low) / side).ceil().long().clamp(min=1)
    cells = ((matter.means @ matter.axes.T - low) / side).floor().long()
    inside = ((cells >= 0) & (cells < shape)).all(1)
    counts = np.zeros(tuple(shape.tolist()), np.int64)
    np.add.at(counts, tuple(cells[inside].T.numpy()), 1)
    room = np.asarray(ndimage.distance_transform_edt(counts < 2)) * side
    drawn = torch.from_numpy(qmc.Halton(3, scramble=False).random(2000)[1:]) * (high - low) + low
    drawn_cells = ((drawn - low) / side).floor().long().clamp(min=0)
    drawn_cells = torch.minimum(drawn_cells, shape - 1)
    free = torch.from_numpy(room[tuple(drawn_cells.T.numpy())]) >= 0.1 * matter.radius
    poses = []
    for number, position in enumerate(drawn[free][: constants.PLACES]):
        for step in range(constants.HEADINGS):
            angle = 2 * math.pi * (step + 0.37 * number) / constants.HEADINGS
            level = math.radians(constants.PITCHES[(step + number) % 2])
            poses.append((position, position + _way(angle, level)))
    return poses
