"""The random scene: Gaussians, cameras, regions and codes in any number, made in seconds from a seed.

It costs what a trained scene costs: flat Gaussians on the surfaces of a furnished room, denser on things than on walls,
log-normal sizes with a tail, half of them nearly transparent, 4 % haze, and no order of the rows. It is for measuring
time; queries have no meaningful answers on it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from scoup.base import InputError
from scoup.scene import LEVELS, SH_C0, Camera, Cameras, Gaussians, RegionMap, Regions, index_dtype
from scoup_lab.synthetic.words import unit

Array: TypeAlias = NDArray[np.float64]

SIZE = np.array([6.0, 5.0, 2.8])  # metres: the room along x, y, z; one corner is the origin
WIDTH, HEIGHT, FOCAL = 988, 731, 700.0  # pixels: a LERF view
REGIONS = (160, 100, 40)  # in one view, at levels s, m, l
CELLS = (400, 120, 40)  # things of one code, at levels s, m, l

_BOXES, _BALLS = 12, 14
_HAZE = 0.04  # share of Gaussians that float in the air


def random_scene_gaussians(n_gaussians: int, seed: int = 0) -> Gaussians:
    """Return N Gaussians of spherical-harmonics degree 0 on the surfaces of a furnished room, in random order as in
    trained scenes."""
    if n_gaussians < 1:
        raise InputError(f"a random scene needs at least one Gaussian, got {n_gaussians}")
    rng = np.random.default_rng(seed)
    corners, edges, balls = _surfaces(rng)
    normals_of = np.cross(edges[:, 0], edges[:, 1])
    areas = np.linalg.norm(normals_of, axis=1)
    normals_of /= areas[:, None]
    areas = np.concatenate([areas, 4 * np.pi * balls[:, 3] ** 2])
    density = np.repeat([1.0, 3.0, 4.0], [6, len(corners) - 6, len(balls)])
    share = areas * density / np.sum(areas * density)

    on_surfaces = n_gaussians - int(_HAZE * n_gaussians)
    counts = np.bincount(np.sort(rng.choice(len(share), on_surfaces, p=share)), minlength=len(share))
    means, normals = np.empty((n_gaussians, 3)), np.empty((n_gaussians, 3))
    spacing, surface = np.empty(n_gaussians), np.empty(n_gaussians, np.int64)
    start = 0
    for number, count in enumerate(counts.tolist()):
        rows = slice(start, start := start + count)
        surface[rows] = number
        spacing[rows] = np.sqrt(areas[number] / max(count, 1))
        if number < len(corners):
            u, v = edges[number]
            means[rows] = corners[number] + rng.random((count, 1)) * u + rng.random((count, 1)) * v
            normals[rows] = normals_of[number]
        else:
            ball = balls[number - len(corners)]
            normals[rows] = unit(rng.normal(size=(count, 3)))
            means[rows] = ball[:3] + ball[3] * normals[rows]
    haze = slice(on_surfaces, n_gaussians)
    means[haze] = rng.random((n_gaussians - on_surfaces, 3)) * SIZE
    normals[haze] = unit(rng.normal(size=(n_gaussians - on_surfaces, 3)))
    spacing[haze] = np.median(spacing[:on_surfaces]) * 1.5
    surface[haze] = len(share)
    means += normals * rng.normal(0, 0.004, (n_gaussians, 1))

    size = spacing * 0.62 * np.exp(rng.normal(0, 0.6, n_gaussians))
    stretch = np.exp(rng.normal(0, 0.45, n_gaussians))
    scales = np.stack([size * stretch, size / stretch, size * 0.12], 1)
    scales[rng.random(n_gaussians) < 0.01] *= 4
    quats = _turned_to(normals, rng)
    opacities = 1 / (1 + np.exp(-rng.normal(0.3, 2.0, n_gaussians)))
    paint = rng.uniform(0.15, 0.9, (len(share) + 1, 3))[surface] + rng.normal(0, 0.05, (n_gaussians, 3))

    order = rng.permutation(n_gaussians)
    parts = (means, quats, scales, opacities, ((paint - 0.5) / SH_C0)[:, None])
    return Gaussians(*(torch.from_numpy(values[order].astype(np.float32)) for values in parts))


def _surfaces(rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Return rectangles, corners [F, 3] and both edges [F, 2, 3], the six walls first; balls [B, 4] (centre,
    radius)."""
    x, y, _ = SIZE
    across, along, up = np.diag(SIZE)
    faces: list[tuple[Array, Array, Array]] = []

    def add_box(corner: Array, a: Array, b: Array, c: Array) -> None:
        faces.extend([(corner, a, b), (corner + c, a, b), (corner, a, c), (corner + b, a, c)])
        faces.extend([(corner, b, c), (corner + a, b, c)])

    add_box(np.zeros(3), across, along, up)
    for _ in range(_BOXES):
        sides = np.diag(rng.uniform(0.2, 0.9, 3))
        corner = np.array([rng.uniform(1.2, x - 1), rng.uniform(0.8, y - 1), 0.0])
        add_box(corner, sides[0], sides[1], sides[2])
    balls = []
    for _ in range(_BALLS):
        radius = rng.uniform(0.08, 0.4)
        balls.append((rng.uniform(1.2, x - 0.6), rng.uniform(0.6, y - 0.6), rng.uniform(radius, 1.6), radius))
    return (
        np.stack([corner for corner, _, _ in faces]),
        np.stack([(u, v) for _, u, v in faces]),
        np.array(balls),
    )


def _turned_to(normals: Array, rng: np.random.Generator) -> Array:
    """Return [N, 4] unit quaternions (w, x, y, z) that turn z to the normals [N, 3], with a random spin."""
    from scipy.spatial.transform import Rotation

    tangent = rng.normal(size=normals.shape)
    tangent = unit(tangent - normals * (tangent * normals).sum(1, keepdims=True))
    axes = np.stack([tangent, np.cross(normals, tangent), normals], -1)
    return np.asarray(Rotation.from_matrix(axes).as_quat())[:, [3, 0, 1, 2]]


def random_scene_cameras(n_views: int, width: int = WIDTH, height: int = HEIGHT) -> Cameras:
    """Return cameras inside the room: the first in a corner, the others on a loop along the walls above the furniture.
    Each looks down across the middle, with the field of view of a LERF view (700 pixels at a width of 988)."""
    focal = FOCAL * width / WIDTH
    cameras = []
    for number in range(n_views):
        eye, target = (0.35, 0.4, 1.7), (4.2, 3.6, 0.7)
        if number:
            angle = 1.25 * math.pi + 2 * math.pi * number / n_views
            c, s = math.cos(angle), math.sin(angle)
            out = (c**4 + s**4) ** -0.25  # a circle pressed against the walls
            eye = (3 + 2.6 * c * out, 2.5 + 2.1 * s * out, 2.2 + 0.12 * math.sin(3 * angle))
            target = (3 - 0.9 * c, 2.5 - 0.8 * s, 0.7 + 0.3 * math.sin(2 * angle))
        cameras.append(Camera.look_at(eye, target, f"room_{number:04d}.png", width, height, focal))
    return Cameras(cameras)


def voronoi_labels(counts: Sequence[int], width: int, height: int, seed: int = 0) -> Tensor:
    """Return [S, height, width] int32: at each level, which of ``counts[level]`` random pixels is nearest (of
    all pixels, if the image has fewer)."""
    from scipy.ndimage import distance_transform_edt

    rng = np.random.default_rng(seed)
    labels = np.empty((len(counts), height, width), np.int32)
    for level, count in enumerate(counts):
        seeds = rng.choice(height * width, min(count, height * width), replace=False)
        elsewhere, names = np.ones(height * width, bool), np.zeros(height * width, np.int32)
        elsewhere[seeds], names[seeds] = False, np.arange(len(seeds))
        at = distance_transform_edt(
            elsewhere.reshape(height, width), return_distances=False, return_indices=True
        )
        rows, columns = np.asarray(at)
        labels[level] = names.reshape(height, width)[rows, columns]
    return torch.from_numpy(labels)


def clip_like(count: int, dim: int = 512, seed: int = 0, n_objects: int = 300) -> Tensor:
    """Return [count, dim] unit rows: cosine about 0.5 between objects, 0.87 within one, and few objects are
    frequent."""
    fixed = torch.Generator().manual_seed(0)  # the same common mean and objects whatever the seed
    common = torch.randn(dim, generator=fixed)
    objects = torch.nn.functional.normalize(torch.randn(n_objects, dim, generator=fixed), dim=1) * dim**0.5
    generator = torch.Generator().manual_seed(seed)
    frequency = 1.0 / torch.arange(1, n_objects + 1)
    which = torch.multinomial(frequency, count, replacement=True, generator=generator)
    rows = (
        torch.randn(count, dim, generator=generator).mul_(0.5).add_(common).add_(objects[which], alpha=0.85)
    )
    return torch.nn.functional.normalize(rows, dim=1)


def random_scene_regions(
    cameras: Cameras, counts: Sequence[int] = REGIONS, dim: int = 512, seed: int = 0, distinct: int = 12
) -> Regions:
    """Return regions of every camera, all of one image size: Voronoi maps, with ``counts`` regions in a view at one to
    three levels, and CLIP-like embeddings.

    Memory: the embeddings of all views (views x sum of counts x dim x 4 bytes: 123 MB for 200 views) and ``distinct``
    sets of label maps (8.7 MB each at 988 x 731 and three levels), which views share in turn.
    """
    if not 1 <= len(counts) <= len(LEVELS) or not len(cameras):
        raise InputError(f"regions need views and 1 to {len(LEVELS)} counts, got {len(counts)} counts")
    levels = LEVELS[: len(counts)]
    width, height = cameras[0].width, cameras[0].height
    maps = [
        voronoi_labels(counts, width, height, seed * 1009 + number)
        for number in range(min(distinct, len(cameras)))
    ]
    rows = {
        level: clip_like(count * len(cameras), dim, seed * 1009 + s).split(count)
        for s, (level, count) in enumerate(zip(levels, counts, strict=True))
    }
    position = {name: number for number, name in enumerate(cameras.names)}

    def load(view_name: str, level: str) -> RegionMap:
        labels = maps[position[view_name] % len(maps)][levels.index(level)]
        return RegionMap(labels, load_embeddings(view_name, level))

    def load_embeddings(view_name: str, level: str) -> Tensor:
        return rows[level][position[view_name]]

    def load_labels(view_name: str) -> Tensor:
        return maps[position[view_name] % len(maps)]

    return Regions(levels, cameras.names, load, load_embeddings, load_labels)


def random_scene_codes(
    means: Tensor, n_levels: int = 3, n_atoms: int = 64, k: int = 4
) -> tuple[Tensor, Tensor]:
    """Return codes of Gaussians with ``means`` [N, 3] as an uplift leaves them: neighbours share atoms, and
    weights differ.

    Returns indices [N, S, K] uint8 (uint16 beyond 256 atoms) and weights [N, S, K] float32, each code summing
    to 1.
    """
    from scipy.spatial import KDTree

    rng = np.random.default_rng(0)
    points = means.cpu().double().numpy()
    low, high = np.percentile(points, [1, 99], axis=0)
    indices = np.empty((len(points), n_levels, k), np.int32)
    for level in range(n_levels):
        count = CELLS[min(level, len(CELLS) - 1)]
        cell = np.asarray(KDTree(low + rng.random((count, 3)) * (high - low)).query(points)[1])
        atoms = np.stack([rng.choice(n_atoms, k, replace=False) for _ in range(count)])
        indices[:, level] = atoms[cell]
    weights = rng.random((len(points), n_levels, k), dtype=np.float32) + np.float32(1e-3)
    weights /= weights.sum(-1, keepdims=True)
    return torch.from_numpy(indices).to(index_dtype(n_atoms)), torch.from_numpy(weights)
