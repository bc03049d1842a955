"""From painted meshes to Gaussians: flat discs that cover the surfaces, as in a trained splat."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from scoup.scene import SH_C0, Gaussians
from scoup_lab.synthetic.art.lighting import Light, lit
from scoup_lab.synthetic.art.meshes import Floats, Ints, Mesh, merged
from scoup_lab.synthetic.art.things import Parts, Piece, Thing

DISTANCES = (0.8, 0.65, 0.5)  # least distance of discs, as a share of the mean: tried in this order
OVERSAMPLING = 6  # candidates for each Gaussian kept
SPREAD = 0.68  # standard deviation of a disc, as a share of the mean distance between discs
COARSE_SPREAD = 0.85  # the same on large coarse pieces, which have few sharp edges and show every hole
COARSE = 0.6  # detail below which a piece is coarse
FLATNESS = 0.12  # thickness of a disc, as a share of its width
RIM_NEIGHBOURS = 12  # discs that decide whether a disc lies on the rim of its surface
INSET = 0.45  # depth of discs under the surface, in standard deviations: offsets the blur on the screen
RIM_SHRINKAGE = 0.65  # a disc on the rim is narrower by this share across it, so that it does not stick out
SMALL_FACE = 0.012  # metres: faces smaller than its square may be seen without covering a pixel centre
HAZE_SHARE = 0.03  # of all Gaussians: floaters and haze, as training leaves them behind


@dataclass(frozen=True, eq=False)
class Splat:
    """Gaussians and where they came from."""

    gaussians: Gaussians  # the scene, SH degree 0
    part_of_gaussian: Ints  # [N] int64 part number; -1 for floaters and haze


@dataclass(frozen=True, eq=False)
class _Samples:
    points: Floats  # [n, 3] metres
    normals: Floats  # [n, 3]
    albedo: Floats  # [n, 3]
    sigma: Floats  # [n] metres
    rim: Floats  # [n, 3] direction out of the surface along it, shorter inside than on the rim (length 0..1)
    gloss: Floats  # [n]
    glow: Floats  # [n]
    part: Ints  # [n]


def make_splat(
    things: tuple[Thing, ...],
    parts: Parts,
    n_gaussians: int,
    rng: np.random.Generator,
    light: Light,
    seen: np.ndarray,
    n_directions: int = 30,
) -> Splat:
    """Cover all things with exactly ``n_gaussians`` Gaussians.

    ``seen``: [F] boolean, the faces of ``Surface.of(things, parts)`` that some view shows. Faces far from
    these get no Gaussians, because training puts none where no view shows anything;
    ``n_directions``: light directions, see ``lighting.lit``.
    """
    n_haze = int(n_gaussians * HAZE_SHARE)
    samples = _cover(things, parts, n_gaussians - n_haze, seen, rng)
    blockers = merged(
        [thing.mesh(piece) for thing in things if thing.name not in light.shell for piece in thing.pieces]
    )
    colors = lit(
        samples.points,
        samples.normals,
        samples.albedo,
        samples.gloss,
        samples.glow,
        blockers,
        light,
        n_directions,
    )
    count = len(samples.points)
    colors = (colors + rng.normal(0, 0.012, colors.shape)).clip(0.005, 0.995)
    height = rng.normal(0, 0.06, count) - INSET
    means = samples.points + samples.normals * (height * samples.sigma)[:, None]
    stretch = np.exp(rng.normal(0, 0.16, (count, 2)))
    on_rim = np.linalg.norm(samples.rim, axis=1)
    stretch[:, 0] *= 1 - RIM_SHRINKAGE * on_rim
    scales = np.concatenate([stretch, np.full((count, 1), FLATNESS)], 1) * samples.sigma[:, None]
    opacities = 0.6 + 0.39 * rng.beta(4.0, 1.2, count)
    quats = _quats(samples.normals, np.where(on_rim[:, None] > 0, samples.rim, rng.normal(size=(count, 3))))
    haze = _haze(samples, colors, n_haze, rng)
    stacked = [
        np.concatenate(pair) for pair in zip((means, quats, scales, opacities, colors), haze, strict=True)
    ]
    part = np.concatenate([samples.part, np.full(n_haze, -1)])
    # A trained splat is not ordered by object: nothing may rely on an order here.
    order = rng.permutation(n_gaussians)
    means, quats, scales, opacities, colors = (torch.from_numpy(values[order]).float() for values in stacked)
    return Splat(
        Gaussians(means, quats, scales, opacities, ((colors - 0.5) / SH_C0)[:, None, :]), part[order]
    )


def _cover(
    things: tuple[Thing, ...], parts: Parts, count: int, seen: np.ndarray, rng: np.random.Generator
) -> _Samples:
    pieces = [(thing, piece) for thing in things for piece in thing.pieces]
    ends = np.cumsum([len(piece.mesh.faces) for _, piece in pieces])[:-1]
    meshes = [
        _around(piece.mesh, chosen, thing.size)
        for (thing, piece), chosen in zip(pieces, np.split(seen, ends), strict=True)
    ]
    areas = np.array(
        [mesh.face_areas().sum() * thing.size**2 for mesh, (thing, _) in zip(meshes, pieces, strict=True)]
    )
    shares = areas * np.array([piece.detail for _, piece in pieces]) ** 1.6
    counts = np.where(areas > 0, np.maximum(6, np.floor(shares / shares.sum() * count)), 0).astype(int)
    counts[counts.argmax()] += count - counts.sum()
    blocks = [
        _cover_piece(thing, piece, mesh, parts.parts.index(piece.part), number, rng)
        for (thing, piece), mesh, number in zip(pieces, meshes, counts, strict=True)
        if number
    ]
    return _Samples(*(np.concatenate(values) for values in zip(*blocks, strict=True)))


def _around(mesh: Mesh, seen: np.ndarray, size: float) -> Mesh:
    """Return the faces seen, and small faces within two steps of them, which may lie between all pixel centres.

    ``size``: metres per unit of the mesh.
    """
    small = mesh.face_areas() * size**2 < SMALL_FACE**2
    chosen = seen.copy()
    for _ in range(2):
        touched = np.zeros(len(mesh.vertices), bool)
        touched[mesh.faces[chosen]] = True
        chosen |= small & touched[mesh.faces].any(1)
    return replace(mesh, faces=mesh.faces[chosen])


def _cover_piece(
    thing: Thing, piece: Piece, mesh: Mesh, part: int, count: int, rng: np.random.Generator
) -> tuple[np.ndarray, ...]:
    spacing = np.sqrt(mesh.face_areas().sum() / count)
    points, normals = evenly(mesh, count, spacing, rng)
    spread = COARSE_SPREAD if piece.detail < COARSE else SPREAD
    sigma = np.full(count, min(spread * spacing, piece.thin) * thing.size)
    albedo = piece.paint(points, normals)
    return (
        points * thing.size @ thing.turn.T + thing.place,
        normals @ thing.turn.T,
        albedo,
        sigma * np.exp(rng.normal(0, 0.08, count)),
        _rim(points, normals, spacing) @ thing.turn.T,
        np.full(count, piece.gloss),
        np.full(count, piece.glow),
        np.full(count, part),
    )


def evenly(mesh: Mesh, count: int, spacing: float, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return ``count`` points spread evenly over a mesh, and their normals, both [count, 3].

    Candidates are thinned until (almost) none has a near neighbour: random points would leave holes.
    """
    areas = mesh.face_areas()
    drawn = (np.arange(count * OVERSAMPLING) + rng.random(count * OVERSAMPLING)) / (count * OVERSAMPLING)
    face = np.searchsorted(np.cumsum(areas) / areas.sum(), drawn).clip(0, len(areas) - 1)
    root, share = np.sqrt(rng.random(len(face)))[:, None], rng.random(len(face))[:, None]
    weights = 1 - root, root * (1 - share), root * share
    corners = mesh.faces[face]
    points = sum(
        (mesh.vertices[corners[:, c]] * weights[c] for c in range(3)), start=np.zeros((len(face), 3))
    )
    normals = sum(
        (mesh.normals[corners[:, c]] * weights[c] for c in range(3)), start=np.zeros((len(face), 3))
    )
    shuffled = rng.permutation(len(face))
    points, normals = points[shuffled], normals[shuffled]
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    for distance in DISTANCES:
        # Points that were apart so far stay: the order decides, and they are now first.
        apart = _thinned(points, distance * spacing)
        order = np.concatenate([np.flatnonzero(apart), np.flatnonzero(~apart)])
        points, normals = points[order], normals[order]
        if apart.sum() >= count:
            break
    return points[:count], normals[:count]


def _thinned(points: Floats, radius: float) -> np.ndarray:
    """Return boolean [n]: the points kept when each, in order, is dropped if one kept before lies within ``radius``."""
    pairs = KDTree(points).query_pairs(radius, output_type="ndarray")
    first, second = pairs.min(1), pairs.max(1)
    chosen, undecided = np.zeros(len(points), bool), np.ones(len(points), bool)
    while undecided.any():
        blocked = np.zeros(len(points), bool)
        blocked[second] = True
        fresh = undecided & ~blocked
        chosen |= fresh
        undecided &= ~fresh
        undecided[second[chosen[first]]] = False
        open_pairs = undecided[first] & undecided[second]
        first, second = first[open_pairs], second[open_pairs]
    return chosen


def _rim(points: Floats, normals: Floats, spacing: float) -> Floats:
    """Return [n, 3] away from the neighbours: zero inside a surface, a unit vector along the surface at its rim."""
    if len(points) <= RIM_NEIGHBOURS:
        return np.zeros_like(points)
    around = np.asarray(KDTree(points).query(points, RIM_NEIGHBOURS + 1)[1])
    away = points - points[around[:, 1:]].mean(1)
    away -= np.einsum("nd,nd->n", away, normals)[:, None] * normals
    length = np.linalg.norm(away, axis=1, keepdims=True)
    # A dozen neighbours of a rim fill a half disc, whose middle lies 1.2 spacings off.
    return away / np.maximum(length, 1e-12) * ((length / spacing - 0.25) / 0.7).clip(0, 1)


def _quats(normals: Floats, first: Floats) -> Floats:
    """Return [n, 4] rotations that turn z onto the normals [n, 3] and x towards ``first`` [n, 3], as far as it can."""
    x_axis = first - np.einsum("nd,nd->n", first, normals)[:, None] * normals
    x_axis /= np.linalg.norm(x_axis, axis=1, keepdims=True)
    frame = np.stack([x_axis, np.cross(normals, x_axis), normals], -1)
    return Rotation.from_matrix(frame).as_quat()[:, [3, 0, 1, 2]]


def _haze(samples: _Samples, colors: Floats, count: int, rng: np.random.Generator) -> tuple[Floats, ...]:
    """Return floaters near surfaces and large faint blobs in the air: means, quats, scales, opacities, colours."""
    near = rng.integers(0, len(samples.points), count)
    large = rng.random(count) < 0.12
    away = np.abs(rng.normal(0, np.where(large, 0.12, 0.012), count))
    means = samples.points[near] + samples.normals[near] * away[:, None] + rng.normal(0, 0.004, (count, 3))
    quats = rng.normal(size=(count, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    scales = np.where(large, 0.025, 0.0035)[:, None] * np.exp(rng.normal(0, 0.5, (count, 3)))
    opacities = np.where(large, rng.uniform(0.006, 0.03, count), rng.uniform(0.03, 0.25, count))
    shown = 0.7 * colors[near] + 0.3 * colors[rng.permutation(near)]
    return means, quats, scales, opacities, shown
