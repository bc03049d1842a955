"""A city of blocks with a building each, as large as wanted: its splat, written part by part, cameras in its streets,
and the regions that they see, by rays against the buildings.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from scoup.base.atomic import atomic_file
from scoup.io import save_regions, write_inria_cameras
from scoup.io.splats.ply import table_from_gaussians
from scoup.io.splats.ply_header import format_header
from scoup.scene.cameras import Camera, Cameras
from scoup.scene.gaussians import Gaussians
from scoup.scene.regions import LEVELS, RegionMap, Regions

PITCH, WALL = 60.0, 10.0  # metres: from block to block, and from the edge of a block to its building
A_BLOCK = 100_000  # Gaussians
EYE = 2.5  # metres above the street
FAR = 250.0  # metres beyond which nothing has a region
PANEL = 4.0  # metres: edge of a region of the finest level
KINDS = 40  # of buildings
LABEL_WIDTH = 160  # pixels of a label map
PROCESSES = 4  # that make regions
NOISE = 0.03  # of an embedding's numbers; a unit vector of 512 has 0.04


@dataclass(frozen=True)
class City:
    """A square of blocks, row after row."""

    n_blocks: int  # of them, each of ``A_BLOCK`` Gaussians
    seed: int = 0  # of heights, colours and cameras

    @property
    def columns(self) -> int:
        return int(np.ceil(np.sqrt(self.n_blocks)))

    @functools.cached_property
    def boxes(self) -> NDArray[np.float64]:
        """[blocks, 2, 3] lowest and highest corner of each building."""
        heights = np.random.default_rng(self.seed).uniform(10, 40, self.n_blocks)
        row, column = np.divmod(np.arange(self.n_blocks), self.columns)
        low = np.stack([column * PITCH + WALL, row * PITCH + WALL, np.zeros(self.n_blocks)], 1)
        size = np.stack([np.full(self.n_blocks, PITCH - 2 * WALL)] * 2 + [heights], 1)
        return np.stack([low, low + size], 1)


def write_city(city: City, cameras: Cameras, folder: Path) -> None:
    """Write the folder that ``scoup build`` takes: splat, cameras and region features."""
    folder.mkdir(parents=True)
    with atomic_file(folder / "point_cloud.ply") as stream:
        for block, gaussians in enumerate(blocks(city)):
            rows = table_from_gaussians(gaussians).rows
            if not block:
                stream.write(format_header(rows.dtype, city.n_blocks * A_BLOCK))
            stream.write(rows.tobytes())
    write_inria_cameras(cameras, folder / "cameras.json")
    (folder / "language_features").mkdir()
    parts = [Cameras(list(cameras)[first::PROCESSES]) for first in range(PROCESSES)]
    with ProcessPoolExecutor(PROCESSES, mp_context=get_context("spawn")) as pool:
        list(pool.map(partial(_write_regions, city, folder / "language_features"), parts))


def _write_regions(city: City, folder: Path, cameras: Cameras) -> None:
    if not len(cameras):
        return
    own = folder / cameras[0].name
    save_regions(regions_of(city, cameras), own)
    for path in own.iterdir():
        path.rename(folder / path.name)
    own.rmdir()


def blocks(city: City) -> Iterator[Gaussians]:
    """Yield the Gaussians of one block after the other: flat ones on walls, roof and street, of SH degree 3."""
    for block, (low, high) in enumerate(city.boxes):
        numbers = np.random.default_rng([city.seed, 1, block])
        size = high - low
        # Axis and side of each face; the street is the whole block at height 0.
        faces = [(0, 0), (0, 1), (1, 0), (1, 1), (2, 1), (2, 0)]
        areas = np.array([size[1] * size[2]] * 2 + [size[0] * size[2]] * 2 + [size[0] * size[1], PITCH**2])
        face = numbers.choice(6, A_BLOCK, p=areas / areas.sum())
        corner, edge = np.tile(low, (6, 1)), np.tile(size, (6, 1))
        corner[5], edge[5] = [low[0] - WALL, low[1] - WALL, 0], [PITCH, PITCH, 0]
        means = corner[face] + edge[face] * numbers.uniform(0, 1, (A_BLOCK, 3))
        axes, sides = (np.array(part)[face] for part in zip(*faces, strict=True))
        rows = np.arange(A_BLOCK)
        means[rows, axes] = (corner[face] + edge[face] * sides[:, None])[rows, axes]
        scales = np.sqrt(areas.sum() / A_BLOCK) * np.exp(numbers.normal(-0.5, 0.3, (A_BLOCK, 3)))
        scales[rows, axes] = 0.02
        quats = numbers.normal(0, 0.03, (A_BLOCK, 4))
        quats[:, 0] = 1
        sh = numbers.normal(0, 0.05, (A_BLOCK, 16, 3))
        sh[:, 0] += np.where(face[:, None] == 5, 0.0, numbers.uniform(-1.5, 1.5, 3))
        values: Any = (means, quats, scales, numbers.uniform(0.6, 1, A_BLOCK), sh)
        yield Gaussians(*values)


def street_cameras(city: City, count: int, width: int = 640, height: int = 360) -> Cameras:
    """Return cameras anywhere in the streets, that look along them or at the houses."""
    numbers = np.random.default_rng([city.seed, 2])
    length = city.columns * PITCH
    found = []
    for number in range(count):
        along, street = numbers.uniform(0, length), PITCH * numbers.integers(0, city.columns + 1)
        turn = numbers.normal(0, 0.5) + np.pi * numbers.integers(0, 2)
        eye, forward = [along, street + numbers.uniform(-5, 5), EYE], [np.cos(turn), np.sin(turn), 0.1]
        if numbers.uniform() < 0.5:
            eye[0], eye[1], forward[0], forward[1] = eye[1], eye[0], forward[1], forward[0]
        name = f"view_{number:05d}.png"
        found.append(Camera.look_at(eye, np.add(eye, forward), name, width, height, 0.7 * width))
    return Cameras(found)


def regions_of(city: City, cameras: Cameras) -> Regions:
    """Return what each camera sees: panels of a wall (s), walls (m), buildings (l); embeddings by the kind
    of building."""
    by_name = {camera.name: camera for camera in cameras}

    @functools.lru_cache(maxsize=2)
    def view(name: str) -> dict[str, RegionMap]:
        return _regions_of_view(city, by_name[name])

    return Regions(LEVELS, cameras.names, lambda name, level: view(name)[level])


def _regions_of_view(city: City, camera: Camera) -> dict[str, RegionMap]:
    building, axis, place = _hit(
        city, camera.resized(LABEL_WIDTH, LABEL_WIDTH * camera.height // camera.width)
    )
    panel = np.floor(place / PANEL).astype(np.int64)
    panel[np.arange(len(panel)), axis] = 0
    kinds = np.random.default_rng([city.seed, 3]).integers(0, KINDS, city.n_blocks)
    whole = building
    wall = whole * 4 + axis
    part = ((wall * 4096 + panel[:, 0]) * 4096 + panel[:, 1]) * 16 + panel[:, 2]
    numbers = np.random.default_rng([city.seed, 4, int(camera.name[5:-4])])
    maps = {}
    for level, ids in zip(LEVELS, (part, wall, whole), strict=True):
        there = building >= 0
        _, first, regions = np.unique(ids[there], return_index=True, return_inverse=True)
        labels = np.full(len(ids), -1, np.int32)
        labels[there] = regions
        kind = kinds[building[there][first]] * 8 + {"s": axis[there][first], "m": 4, "l": 5}[level]
        basis = _basis(level)[kind]
        embeddings = basis + numbers.normal(0, NOISE, basis.shape)
        maps[level] = RegionMap(
            torch.from_numpy(labels.reshape(-1, LABEL_WIDTH)), torch.from_numpy(embeddings.astype(np.float32))
        )
    return maps


@functools.cache
def _basis(level: str) -> NDArray[np.float64]:
    vectors = np.random.default_rng(LEVELS.index(level)).normal(size=(KINDS * 8, 512))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def _hit(city: City, camera: Camera) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Return for each pixel the block that its ray hits (-1: sky), the axis of the face, the place [P, 3]."""
    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    rays = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones_like(x)], -1).reshape(
        -1, 3
    )
    rays = rays @ camera.viewmat[:3, :3].numpy()
    eye = camera.position.numpy()
    near = np.flatnonzero(np.abs(city.boxes[:, :, :2].mean(1) - eye[:2]).max(1) < FAR)
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = (city.boxes[near][None] - eye) / rays[:, None, None]  # [P, boxes, 2, 3]
        enter, leave = ends.min(2), ends.max(2)
        distance: NDArray[np.float64] = enter.max(2)
        distance = np.where((distance > 0) & (distance <= leave.min(2)) & (distance < FAR), distance, np.inf)
        street = np.where(rays[:, 2] < 0, -eye[2] / rays[:, 2], np.inf)
    best = distance.argmin(1) if len(near) else np.zeros(len(rays), np.int64)
    rows = np.arange(len(rays))
    nearest = distance[rows, best] if len(near) else np.full(len(rays), np.inf)
    hits = np.minimum(nearest, street)
    place = eye + rays * np.where(np.isfinite(hits), hits, 0)[:, None]
    column, row = (np.floor(place[:, axis] / PITCH).astype(np.int64) for axis in (0, 1))
    paved = (
        (column >= 0) & (column < city.columns) & (row >= 0) & (row * city.columns + column < city.n_blocks)
    )
    on_street = street < nearest
    block = np.where(
        on_street, np.where(paved, row * city.columns + column, -1), near[best] if len(near) else -1
    )
    axis = np.where(on_street, 2, enter[rows, best].argmax(1) if len(near) else 2)
    return np.where(hits < FAR, block, -1), axis, place.astype(np.float64)
