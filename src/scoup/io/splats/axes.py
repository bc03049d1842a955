"""Axes of splat formats, and half-turns between them.

Gaussians have the axes of 3D Gaussian Splatting: x right, y down, z forward. A format that names its axes is turned
when it is read and written; all others keep the numbers.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np
import torch

from scoup.scene.gaussians import Gaussians

Axis = Literal["x", "y", "z"]
"""Of a half-turn: x from 3DGS to right, up, back; z to left, up, forward."""
Columns = dict[str, np.ndarray]
"""means, quats (w, x, y, z), scales, opacities, sh, as ``keep_finite`` takes them."""


def half_turn(columns: Mapping[str, np.ndarray], axis: Axis) -> Columns:
    """Return Gaussians in axes turned by 180 degrees: signs change, all other bits stay."""
    signs = np.array([1 if name == axis else -1 for name in "xyz"], np.float32)
    sh = columns["sh"]
    with np.errstate(all="ignore"):  # rows that are not finite are dropped later
        return {
            **columns,
            "means": columns["means"] * signs,
            "quats": columns["quats"] * np.array([1, *signs], np.float32),
            "sh": sh * _sh_signs(sh.shape[1], axis)[:, None],
        }


def turned(gaussians: Gaussians, axis: Axis) -> Gaussians:
    """Return ``half_turn`` of Gaussians, on the CPU."""
    names = ("means", "quats", "scales", "opacities", "sh")
    columns = {name: getattr(gaussians, name).detach().cpu().numpy() for name in names}
    return Gaussians(**{name: torch.from_numpy(column) for name, column in half_turn(columns, axis).items()})


def _sh_signs(count: int, axis: Axis) -> np.ndarray:
    """Return the signs [count] of real spherical harmonics: products of the axes that each is odd in."""
    odd = []
    for degree in range(round(count**0.5)):
        for order in range(-degree, degree + 1):
            odd.append({"x": degree + order + (order < 0), "y": degree + (order < 0), "z": order}[axis])
    return np.array([-1 if number % 2 else 1 for number in odd], np.float32)
