"""The random scene; meshes and the z-buffer behind the ground truth, on shapes whose silhouettes are known."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from numpy.typing import ArrayLike
from scipy.spatial import ConvexHull

from messages import refuses
from scoup import raster
from scoup.scene import LEVELS, Camera
from scoup_lab.synthetic import random_scene
from scoup_lab.synthetic.art.meshes import Mesh
from scoup_lab.synthetic.art.zbuffer import visible_faces
from scoup_lab.synthetic.splat import evenly


def test_the_same_seed_gives_the_same_gaussians():
    one, same, other = (random_scene.random_scene_gaussians(500, seed=seed) for seed in (0, 0, 1))
    assert one.fingerprint() == same.fingerprint()
    assert torch.equal(one.sh, same.sh)
    assert one.fingerprint() != other.fingerprint()
    with refuses():
        random_scene.random_scene_gaussians(0)


@pytest.mark.parametrize("count", [1, 2, 30, 1000])
def test_a_scene_of_any_size(count):
    gaussians = random_scene.random_scene_gaussians(count)
    assert len(gaussians) == count
    assert gaussians.finite().all()
    assert torch.allclose(gaussians.quats.norm(dim=1), torch.ones(count))
    assert ((gaussians.opacities > 0) & (gaussians.opacities < 1)).all()
    assert ((gaussians.means >= -0.1) & (gaussians.means <= torch.from_numpy(random_scene.SIZE) + 0.1)).all()


def test_every_camera_is_inside_and_sees_the_scene():
    gaussians = random_scene.random_scene_gaussians(2000)
    for camera in random_scene.random_scene_cameras(9, 64, 48):
        place = camera.position.numpy()
        assert ((place > 0.2) & (place < random_scene.SIZE - 0.2)).all()
        _, alpha = raster.render_channels(raster.project(gaussians, camera), torch.ones(len(gaussians), 1))
        assert alpha.mean() > 0.5, camera.name


def test_cameras_of_any_size():
    lerf, small = random_scene.random_scene_cameras(1)[0], random_scene.random_scene_cameras(3, 494, 300)[0]
    assert (lerf.width, lerf.height, lerf.fx) == (988, 731, 700)
    assert (small.width, small.height, small.fx) == (494, 300, 350)
    assert torch.equal(lerf.viewmat, small.viewmat)
    assert len({tuple(camera.position.tolist()) for camera in random_scene.random_scene_cameras(7)}) == 7


def test_labels_are_the_nearest_seed():
    labels = random_scene.voronoi_labels((5, 1, 3000), 40, 30, seed=3)
    assert (labels.dtype, labels.shape) == (torch.int32, (3, 30, 40))
    assert [int(level.max()) + 1 for level in labels] == [5, 1, 1200]
    assert all(len(level.unique()) == count for level, count in zip(labels, (5, 1, 1200), strict=True))
    assert torch.equal(labels, random_scene.voronoi_labels((5, 1, 3000), 40, 30, seed=3))
    seeds = np.random.default_rng(3).choice(1200, 5, replace=False)
    rows, columns = np.mgrid[:30, :40]
    away = [(rows - seed // 40) ** 2 + (columns - seed % 40) ** 2 for seed in seeds]
    nearest = np.take_along_axis(np.stack(away), labels[:1].numpy().astype(np.int64), 0)[0]
    assert np.array_equal(nearest, np.min(away, axis=0))


def test_embeddings_are_as_alike_as_those_of_clip():
    rows = random_scene.clip_like(400, 512, seed=1, n_objects=300)
    assert torch.allclose(rows.norm(dim=1), torch.ones(400))
    cosines = rows @ rows.T
    pairs = cosines[~torch.eye(400, dtype=torch.bool)]
    assert 0.45 < float(pairs.median()) < 0.6
    assert float(pairs.quantile(0.999)) > 0.8


def test_regions_of_every_view():
    cameras = random_scene.random_scene_cameras(5, 40, 30)
    regions = random_scene.random_scene_regions(cameras, (8, 4, 2), dim=16, distinct=2)
    assert (regions.levels, regions.view_names) == (LEVELS, cameras.names)
    labels, embeddings = regions.load_view(cameras[3].name, 40, 30)
    assert labels.shape == (3, 30, 40)
    assert [tuple(rows.shape) for rows in embeddings] == [(8, 16), (4, 16), (2, 16)]
    assert regions.embeddings("m")[0].shape == (20, 16)
    assert torch.equal(labels, regions.load_view(cameras[1].name, 40, 30)[0])  # maps are shared in turn
    assert not torch.equal(embeddings[0], regions.load_view(cameras[1].name, 40, 30)[1][0])
    again = random_scene.random_scene_regions(cameras, (8, 4, 2), dim=16, distinct=2)
    assert torch.equal(again.embeddings("s")[0], regions.embeddings("s")[0])
    with refuses():
        random_scene.random_scene_regions(cameras, (1, 2, 3, 4))


def sphere(radius: float, centre: ArrayLike = (0, 0, 0), count: int = 300) -> Mesh:
    """The hull of points along a spiral, its faces seen from outside."""
    number = np.arange(count) + 0.5
    turn, high = number * np.pi * (1 + 5**0.5), 1 - 2 * number / count
    level = np.sqrt(1 - high**2)
    outwards = np.stack([level * np.cos(turn), level * np.sin(turn), high], 1)
    faces = ConvexHull(outwards).simplices.astype(np.int64)
    inwards = np.linalg.det(outwards[faces]) < 0
    faces[inwards] = faces[inwards, ::-1]
    return Mesh(outwards * radius, outwards, faces).moved(centre)


def rectangle(corner: ArrayLike, first: ArrayLike, second: ArrayLike) -> Mesh:
    """From a corner along two edges [3], seen from where first x second points."""
    start, u, v = (np.asarray(vector, float) for vector in (corner, first, second))
    normal = np.cross(u, v)
    normals = np.tile(normal / np.linalg.norm(normal), (4, 1))
    corners = np.stack([start, start + u, start + u + v, start + v])
    return Mesh(corners, normals, np.array([[0, 1, 2], [0, 2, 3]]))


HALF_TURN = np.diag([-1.0, 1.0, -1.0])  # about y
# At the origin, looking along +z, with its principal point off the middle.
INTRINSICS = torch.tensor([[80.0, 0, 97 / 2 + 3.3], [0, 80, 71 / 2 - 2.1], [0, 0, 1]])
VIEW = Camera("view.png", torch.eye(4), INTRINSICS, 97, 71)


def test_a_mesh_is_scaled_then_turned_then_moved() -> None:
    wall = rectangle((0, 0, 1), (1, 0, 0), (0, 2, 0))
    moved = wall.moved((10, 0, 0), HALF_TURN, 3.0)
    assert moved.vertices == pytest.approx(np.array([[10, 0, -3], [7, 0, -3], [7, 6, -3], [10, 6, -3]]))
    assert moved.normals == pytest.approx(np.tile([0, 0, -1], (4, 1)))
    assert moved.face_areas().sum() == pytest.approx(18)


def test_even_points_lie_on_the_surface_and_apart():
    rng = np.random.default_rng(0)
    ball = sphere(1.0, count=2000)
    spacing = np.sqrt(4 * np.pi / 900)
    points, normals = evenly(ball, 900, spacing, rng)
    assert points.shape == normals.shape == (900, 3)
    assert np.linalg.norm(points, axis=1) == pytest.approx(1, abs=0.01)
    assert np.einsum("nd,nd->n", points, normals) == pytest.approx(1, abs=0.01)
    gaps = np.linalg.norm(points[:, None] - points[None], axis=-1) + 9 * np.eye(900)
    assert np.quantile(gaps.min(1), 0.05) > 0.5 * spacing
    everywhere = sphere(1.0).vertices
    assert np.linalg.norm(everywhere[:, None] - points[None], axis=-1).min(1).max() < 1.6 * spacing


def test_sphere_is_seen_where_rays_hit_it():
    centre, radius = np.array([0.3, -0.2, 4.0]), 1.1
    ball = sphere(radius, centre, count=12_000)
    seen = visible_faces(ball.vertices, ball.faces, VIEW) >= 0
    y, x = np.mgrid[:71, :97] + 0.5  # rays through the pixel centres; z = 1
    ray = np.stack([(x - VIEW.cx) / VIEW.fx, (y - VIEW.cy) / VIEW.fy, np.ones_like(x)], -1)
    along = ray @ centre
    truth = along**2 - (ray**2).sum(-1) * (centre @ centre - radius**2) > 0
    # The mesh lies inside the sphere by a thousandth of its radius: some pixels of its rim may differ.
    assert (seen & ~truth).sum() == 0
    assert (truth & ~seen).sum() <= 0.01 * truth.sum()


def test_faces_seen_from_behind_or_behind_the_camera_are_not_drawn():
    wall = rectangle((-1, -1, 3), (0, 2, 0), (2, 0, 0))
    assert (visible_faces(wall.vertices, wall.faces, VIEW) >= 0).any()
    assert (visible_faces(wall.vertices, wall.faces[:, ::-1], VIEW) < 0).all()
    behind = wall.moved((0, 0, 0), HALF_TURN)
    assert (visible_faces(behind.vertices, behind.faces, VIEW) < 0).all()
