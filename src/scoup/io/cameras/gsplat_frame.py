"""The world in which gsplat's trainer trains: moved by the cameras and points of COLMAP (normalize_world_space)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from scoup.base import FileFormatError
from scoup.io.cameras.colmap import read_points
from scoup.scene import Camera, Cameras

_UP = np.array([0.0, -1.0, 0.0])
_TURNS = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
_CLEARLY = 0.7  # of the distance without a turn
_COMPARED = 20_000  # points and means
_REMEDY = "use cameras in the frame of the splat"


def in_gsplat_frame(cameras: Cameras, model: Path, means: np.ndarray | None = None) -> Cameras:
    """Return all cameras of a COLMAP model with points in the frame of the splat that gsplat's trainer made of it.

    The signs of the axes depend on the trainer's version and machine. Of the four possible turns, the one that brings
    the points nearest to the ``means`` [N, 3] of the splat is used, if it is clearly better than none.
    """
    points = read_points(model)[0].astype(np.float32).astype(np.float64)  # the trainer keeps float32
    if len(points) < 3 or not np.isfinite(points).all():
        raise FileFormatError(model, f"has {len(points)} points, too few to normalise the world by", _REMEDY)
    transform = gsplat_normalisation(list(cameras), points)
    if means is not None and len(means) and np.isfinite(transform).all():
        transform = _nearest_turn(transform, points, means) @ transform
    scale = float(np.cbrt(np.linalg.det(transform[:3, :3])))
    if not np.isfinite(transform).all() or not np.isfinite(scale) or scale <= 0:
        raise FileFormatError(model, "has cameras that give the world no direction or size", _REMEDY)
    rotation, shift = transform[:3, :3] / scale, transform[:3, 3] / scale
    return Cameras(camera.moved(rotation, shift, scale) for camera in cameras)


def gsplat_normalisation(cameras: Sequence[Camera], points: np.ndarray) -> np.ndarray:
    """Return [4, 4] similarity from COLMAP's world to that of gsplat's trainer.

    First the cameras' mean up becomes -y, the median of what they look at the origin, and their median distance 1;
    then the principal axes of the points [P, 3] become x, y, z, and last the side with more of the points is put down.
    """
    with np.errstate(all="ignore"):
        first = _from_cameras(np.stack([np.linalg.inv(camera.viewmat.numpy()) for camera in cameras]))
    if not np.isfinite(first).all():
        return first
    moved = points @ first[:3, :3].T + first[:3, 3]
    second = _principal_axes(moved)
    heights = (moved @ second[:3, :3].T + second[:3, 3])[:, 2]
    if np.median(heights) > np.mean(heights):
        second = np.diag([1.0, -1.0, -1.0, 1.0]) @ second
    return second @ first


def _nearest_turn(transform: np.ndarray, points: np.ndarray, means: np.ndarray) -> np.ndarray:
    """Return the identity or a half-turn about an axis [4, 4]: whichever brings the moved points nearest to the
    means, by the median.
    """
    from scipy.spatial import KDTree

    tree = KDTree(means[:: max(1, len(means) // _COMPARED)])
    some = points[:: max(1, len(points) // _COMPARED)] @ transform[:3, :3].T + transform[:3, 3]
    distances = [float(np.median(tree.query(some * turn)[0])) for turn in _TURNS]
    best = int(np.argmin(distances))
    return np.diag([*_TURNS[best if distances[best] < _CLEARLY * distances[0] else 0], 1.0])


def _from_cameras(c2w: np.ndarray) -> np.ndarray:
    rotations, centres = c2w[:, :3, :3], c2w[:, :3, 3]
    up = (rotations @ _UP).mean(0)
    up /= np.linalg.norm(up)
    cosine, cross = _UP @ up, np.cross(up, _UP)
    skew = np.array([[0, -cross[2], cross[1]], [cross[2], 0, -cross[0]], [-cross[1], cross[0], 0]])
    turn = np.eye(3) + skew + skew @ skew / (1 + cosine) if cosine > -1 else np.diag([-1.0, 1.0, 1.0])
    forward = (turn @ rotations)[:, :, 2]
    centres = centres @ turn.T
    nearest = centres - (forward * centres).sum(1, keepdims=True) * forward
    shift = -np.median(nearest, axis=0)
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = turn, shift
    transform[:3] /= np.median(np.linalg.norm(centres + shift, axis=1))
    return transform


def _principal_axes(points: np.ndarray) -> np.ndarray:
    centroid = np.median(points, axis=0)
    _, vectors = np.linalg.eigh(np.cov(points - centroid, rowvar=False))
    vectors = vectors[:, ::-1].copy()  # largest first
    if np.linalg.det(vectors) < 0:
        vectors[:, 0] *= -1
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = vectors.T, -vectors.T @ centroid
    return transform
