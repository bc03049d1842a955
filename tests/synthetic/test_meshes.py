"""Meshes: areas, moves, and the points that are spread over them; the meshes of all things are closed and whole."""

from __future__ import annotations

import numpy as np
import pytest

from scoup_lab.synthetic.splat import evenly
from synthetic.shapes import half_turn, rectangle, sphere


def test_a_mesh_is_scaled_then_turned_then_moved() -> None:
    wall = rectangle((0, 0, 1), (1, 0, 0), (0, 2, 0))
    moved = wall.moved((10, 0, 0), half_turn(), 3.0)
    assert moved.vertices == pytest.approx(np.array([[10, 0, -3], [7, 0, -3], [7, 6, -3], [10, 6, -3]]))
    assert moved.normals == pytest.approx(np.tile([0, 0, -1], (4, 1)))
    assert moved.face_areas().sum() == pytest.approx(18)


def test_even_points_lie_on_the_surface_and_apart():
    rng = np.random.default_rng(0)
    ball = sphere(1.0, segments=64)
    spacing = np.sqrt(4 * np.pi / 900)
    points, normals = evenly(ball, 900, spacing, rng)
    assert points.shape == normals.shape == (900, 3)
    assert np.linalg.norm(points, axis=1) == pytest.approx(1, abs=0.01)
    assert np.einsum("nd,nd->n", points, normals) == pytest.approx(1, abs=0.01)
    gaps = np.linalg.norm(points[:, None] - points[None], axis=-1) + 9 * np.eye(900)
    assert np.quantile(gaps.min(1), 0.05) > 0.5 * spacing
    everywhere = sphere(1.0).vertices
    assert np.linalg.norm(everywhere[:, None] - points[None], axis=-1).min(1).max() < 1.6 * spacing
