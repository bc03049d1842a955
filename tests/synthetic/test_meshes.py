"""Meshes: areas, moves, and the points that are spread over them; the meshes of all things are closed and whole."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.scenes import LAYOUTS

from scoup_lab.synthetic.art.meshes import Mesh
from scoup_lab.synthetic.splat import evenly
from synthetic.shapes import half_turn, rectangle, sphere


def volume(mesh: Mesh) -> float:
    a, b, c = (mesh.vertices[mesh.faces[:, corner]] for corner in range(3))
    return float(np.einsum("nd,nd->", a, np.cross(b, c)) / 6)


def test_a_mesh_is_scaled_then_turned_then_moved() -> None:
    wall = rectangle((0, 0, 1), (1, 0, 0), (0, 2, 0))
    moved = wall.moved((10, 0, 0), half_turn(), 3.0)
    assert moved.vertices == pytest.approx(np.array([[10, 0, -3], [7, 0, -3], [7, 6, -3], [10, 6, -3]]))
    assert moved.normals == pytest.approx(np.tile([0, 0, -1], (4, 1)))
    assert moved.face_areas().sum() == pytest.approx(18)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_thing_is_whole_and_right_side_out(layout: str) -> None:
    for thing in LAYOUTS[layout].things():
        assert thing.turn @ thing.turn.T == pytest.approx(np.eye(3))
        for piece in thing.pieces:
            mesh = piece.mesh
            assert mesh.faces.dtype == np.int64
            used = np.unique(mesh.faces)
            assert used[-1] < len(mesh.vertices) == len(mesh.normals)
            assert np.linalg.norm(mesh.normals[used], axis=1) == pytest.approx(1)
            colors = piece.paint(mesh.vertices, mesh.normals)
            assert colors.shape == mesh.vertices.shape
            assert np.isfinite(colors).all()
            if thing.name not in {"wall", "ceiling", "sky"}:  # seen from inside, and open
                assert volume(mesh) > -1e-9, piece.part


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
