"""Shapes: their areas, volumes and normals are those of geometry."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.scenes import LAYOUTS

from scoup_lab.synthetic.art.meshes import (
    Mesh,
    box,
    cylinder,
    ellipsoid,
    lathe,
    rotation,
    smooth_curve,
    torus,
    tube,
)
from scoup_lab.synthetic.art.paints import smooth_noise
from scoup_lab.synthetic.splat import evenly

SHAPES = {
    "ball": (ellipsoid(2.0, segments=96), 16 * np.pi, 32 / 3 * np.pi),
    "cylinder": (cylinder(1.0, 3.0, segments=96), 8 * np.pi, 3 * np.pi),
    "cone": (cylinder(1.0, 1.0, segments=96, top=0.0), np.pi * (1 + np.sqrt(2)), np.pi / 3),
    "torus": (torus(3.0, 1.0, 128), 12 * np.pi**2, 6 * np.pi**2),
    "box": (box((1, 2, 3), 0.001), 22.0, 6.0),
    "bar": (tube([(0, 0, z) for z in range(5)], 0.5, 64), 4 * np.pi + np.pi / 2, np.pi),
}


def volume(mesh: Mesh) -> float:
    a, b, c = (mesh.vertices[mesh.faces[:, corner]] for corner in range(3))
    return float(np.einsum("nd,nd->", a, np.cross(b, c)) / 6)


@pytest.mark.parametrize("name", SHAPES)
def test_area_and_volume(name: str):
    mesh, area, inside = SHAPES[name]
    assert mesh.face_areas().sum() == pytest.approx(area, rel=0.01)
    assert volume(mesh) == pytest.approx(inside, rel=0.01)


@pytest.mark.parametrize("name", SHAPES)
def test_normals_agree_with_the_faces(name: str):
    mesh = SHAPES[name][0]
    a, b, c = (mesh.vertices[mesh.faces[:, corner]] for corner in range(3))
    outwards = np.cross(b - a, c - a)
    assert (np.einsum("nd,nd->n", outwards, mesh.normals[mesh.faces].sum(1)) > 0).all()
    used = np.unique(mesh.faces)
    assert np.linalg.norm(mesh.normals[used], axis=1) == pytest.approx(1)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_closed_thing_is_right_side_out(layout: str):
    for thing in LAYOUTS[layout].things():
        for piece in thing.pieces:
            if thing.name not in {"wall", "ceiling", "sky"}:  # seen from inside, and open
                assert volume(piece.mesh) > -1e-9, piece.part


def test_rotation_turns_about_x_then_y_then_z():
    assert rotation(z=90) @ [1, 0, 0] == pytest.approx([0, 1, 0])
    assert rotation(x=90) @ [0, 1, 0] == pytest.approx([0, 0, 1])
    assert rotation(y=90) @ [0, 0, 1] == pytest.approx([1, 0, 0])
    assert rotation(x=90, z=90) @ [0, 0, 1] == pytest.approx([1, 0, 0])


def test_smooth_curve_goes_through_its_points():
    points = np.array([[0.0, 0], [1, 2], [3, 1], [4, 4]])
    curve = smooth_curve(points, 31)
    assert curve[::10] == pytest.approx(points)


def test_sharp_edges_keep_their_normals_apart():
    tin = lathe([(0, 0), (1, 0), (1, 0), (1, 2), (1, 2), (0, 2)], 16)
    upright = np.abs(tin.normals[np.unique(tin.faces)][:, 2])
    assert ((upright < 1e-9) | (upright > 1 - 1e-9)).all()


def test_even_points_lie_on_the_surface_and_apart():
    rng = np.random.default_rng(0)
    ball = ellipsoid(1.0, segments=64)
    spacing = np.sqrt(4 * np.pi / 900)
    points, normals = evenly(ball, 900, spacing, rng)
    assert points.shape == normals.shape == (900, 3)
    assert np.linalg.norm(points, axis=1) == pytest.approx(1, abs=0.01)
    assert np.einsum("nd,nd->n", points, normals) == pytest.approx(1, abs=0.01)
    gaps = np.linalg.norm(points[:, None] - points[None], axis=-1) + 9 * np.eye(900)
    assert np.quantile(gaps.min(1), 0.05) > 0.5 * spacing
    everywhere = ellipsoid(1.0, segments=24).vertices
    assert np.linalg.norm(everywhere[:, None] - points[None], axis=-1).min(1).max() < 1.6 * spacing


def test_noise_is_smooth_bounded_and_the_same_each_time():
    points = np.random.default_rng(1).uniform(-50, 50, (4000, 3))
    values = smooth_noise(points, 3.0, 4)
    assert np.abs(values).max() <= 1
    assert values.std() > 0.2
    assert np.abs(smooth_noise(points + 1e-6, 3.0, 4) - values).max() < 1e-4
    assert (smooth_noise(points, 3.0, 5) != values).any()
    assert smooth_noise(np.array([[0.5, 1.5, -2.5]]), 1.0, 7) == pytest.approx(
        smooth_noise(np.array([[0.5, 1.5, -2.5]]), 1.0, 7)
    )
