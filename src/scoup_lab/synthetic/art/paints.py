"""Colours and patterns: functions from points on a surface to colours."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from scoup_lab.synthetic.art.meshes import Floats

Paint = Callable[[Floats, Floats], Floats]
"""``paint(points [n, 3], normals [n, 3]) -> [n, 3]`` sRGB colours 0..1; points in the object's own frame."""


def color(code: str) -> Floats:
    """Return [3] colour 0..1 of a hexadecimal code such as "d94f3d"."""
    return np.array([int(code[start : start + 2], 16) for start in (0, 2, 4)]) / 255.0


def smooth_noise(points: Floats, size: float | ArrayLike, seed: int = 0) -> Floats:
    """Return [n] smooth noise between -1 and 1 at ``points`` [n, 3], with blobs of about ``size`` (one number or
    three).

    Random numbers on a lattice, interpolated; the lattice is hashed, so the noise is the same everywhere.
    """
    position = points / np.asarray(size, float)
    corner = np.floor(position).astype(np.int64)
    t = position - corner
    t = t * t * (3 - 2 * t)
    total = np.zeros(len(points))
    for step in range(8):
        offset = np.array([step & 1, step >> 1 & 1, step >> 2 & 1])
        weight = np.prod(np.where(offset, t, 1 - t), axis=1)
        total += weight * _hashed(corner + offset, seed)
    return total


def _hashed(cells: np.ndarray, seed: int) -> Floats:
    mixed = cells.astype(np.uint64) @ np.array([73856093, 19349663, 83492791], np.uint64) + np.uint64(
        seed * 2654435761
    )
    mixed = (mixed ^ (mixed >> np.uint64(13))) * np.uint64(0x9E3779B97F4A7C15)
    mixed = (mixed ^ (mixed >> np.uint64(29))) * np.uint64(0xBF58476D1CE4E5B9)
    return (mixed >> np.uint64(40)).astype(np.float64) / float(1 << 23) - 1.0


def mix(first: Floats, second: Floats, share: Floats) -> Floats:
    """Return [n, 3]: ``first`` where ``share`` [n] is 0, ``second`` where it is 1."""
    weight = np.clip(share, 0, 1)[:, None]
    return first * (1 - weight) + second * weight


def solid(code: str, grain: float = 0.035, size: float = 1.5) -> Paint:
    """Return one colour, with brightness varying by ``grain`` over blobs of ``size``."""

    def paint(points: Floats, normals: Floats) -> Floats:
        tone = 1 + grain * (smooth_noise(points, size, 1) + smooth_noise(points, size / 4, 2))
        return np.clip(color(code) * tone[:, None], 0, 1)

    return paint


def bands(code: str, other: str, axis: int, edges: ArrayLike) -> Paint:
    """Return the second colour between pairs of coordinates along an axis: edges [start, end, start, end, ...]."""
    base, stripe = solid(code), solid(other)
    limits = np.asarray(edges, float)

    def paint(points: Floats, normals: Floats) -> Floats:
        inside = np.searchsorted(limits, points[:, axis]) % 2 == 1
        return np.where(inside[:, None], stripe(points, normals), base(points, normals))

    return paint


def gradient(
    low: str, high: str, axis: int, start: float, end: float, grain: float = 0.08, size: float = 2.0
) -> Paint:
    """Blend one colour into the other along an axis, with a blotchy border."""

    def paint(points: Floats, normals: Floats) -> Floats:
        share = (points[:, axis] - start) / (end - start) + 0.2 * smooth_noise(points, size, 3)
        tone = 1 + grain * smooth_noise(points, size / 3, 4)
        return np.clip(mix(color(low), color(high), share) * tone[:, None], 0, 1)

    return paint


def spotted(base: str, spots: str, size: float, amount: float = 0.4, seed: int = 0) -> Paint:
    """Return blobs of the second colour of about ``size``; ``amount`` below 0 gives more of them."""

    def paint(points: Floats, normals: Floats) -> Floats:
        return mix(
            solid(base)(points, normals), color(spots), (smooth_noise(points, size, seed + 5) - amount) * 8
        )

    return paint


def checked(code: str, other: str, axes: tuple[int, int], size: float) -> Paint:
    """Return a woven check: overlapping stripes along two axes."""

    def paint(points: Floats, normals: Floats) -> Floats:
        stripes = [np.sin(points[:, axis] * (np.pi / size)) > 0 for axis in axes]
        share = 0.5 * (stripes[0].astype(float) + stripes[1])
        return mix(color(code), color(other), share) * (1 + 0.06 * smooth_noise(points, size / 4, 6))[:, None]

    return paint


def wood(code: str, along: int = 0, size: float = 4.0, planks: float = 0.0, contrast: float = 0.16) -> Paint:
    """Return wood grain running along an axis; ``planks`` is the width of boards laid side by side (0: one board)."""
    across = 1 if along == 0 else 0

    def paint(points: Floats, normals: Floats) -> Floats:
        board = np.floor(points[:, across] / planks) if planks else np.zeros(len(points))
        shifted = points + board[:, None] * np.array([37.0, 11.0, 5.0])
        stretch = np.full(3, size / 3)
        stretch[along] = size * 6
        lines = smooth_noise(shifted, stretch, 7) + 0.5 * smooth_noise(shifted, stretch / 3, 8)
        tone = 1 + contrast * lines + 0.12 * np.sin(board * 2.4 + np.cos(board * 5.1))
        if planks:
            gap = np.abs(points[:, across] / planks - np.round(points[:, across] / planks)) * planks
            tone = np.where(gap < size * 0.06, tone * 0.72, tone)
        return np.clip(color(code) * tone[:, None], 0, 1)

    return paint


def fur(code: str, tint: str) -> Paint:
    """Return plush: short-range noise between two tones."""

    def paint(points: Floats, normals: Floats) -> Floats:
        share = 0.5 + 0.6 * smooth_noise(points, 0.7, 9) + 0.35 * smooth_noise(points, 2.2, 10)
        return mix(color(code), color(tint), share)

    return paint
