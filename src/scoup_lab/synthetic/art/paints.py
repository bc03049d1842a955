"""Paints: functions from points on a surface to colours. They are stored as graphs of array operations, as materials
are in the formats of renderers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from scoup_lab.synthetic.art.meshes import Floats

Paint = Callable[[Floats, Floats], Floats]
"""``paint(points [n, 3], normals [n, 3]) -> [n, 3]`` sRGB colours 0..1; points in the object's own frame."""


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


OPERATIONS: dict[str, Callable[..., Any]] = {
    # numpy's functions of these names
    **{
        name: getattr(np, name)
        for name in (
            "absolute", "add", "arctan2", "bitwise_and", "bitwise_or", "clip", "cos", "divide", "equal", "floor",
            "greater", "hypot", "less", "matmul", "maximum", "minimum", "multiply", "remainder", "round",
            "searchsorted", "sin", "subtract", "where",
        )
    },
    "column": lambda values, number: values[:, number],
    "expand": lambda values: values[:, None],
    "float": lambda values: values.astype(np.float64),
    "integer": lambda values: values.astype(np.int64),
    "noise": smooth_noise,
    "take": lambda rows, numbers: np.asarray(rows)[numbers],
}  # fmt: skip
"""Operations of a node of a graph, by name."""


def paint_of(graph: Sequence[Sequence[Any]]) -> Paint:
    """Return the paint of a graph.

    ``graph``: nodes ``[operation, argument, ...]`` in the order of their evaluation; the last gives the colours. An
    argument is a number, a list of numbers, or a string: "points", "normals", or "#3" for the result of node 3.
    """

    def paint(points: Floats, normals: Floats) -> Floats:
        values: dict[str, Any] = {"points": points, "normals": normals}
        result = points
        for number, (operation, *arguments) in enumerate(graph):
            result = OPERATIONS[operation](
                *(values[argument] if isinstance(argument, str) else argument for argument in arguments)
            )
            values[f"#{number}"] = result
        return result

    return paint
