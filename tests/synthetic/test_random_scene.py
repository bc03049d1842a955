"""The random scene: the same from the same seed, of the requested sizes, visible to every camera."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from messages import refuses
from scoup import raster
from scoup.scene import LEVELS
from scoup_lab.synthetic.random_scene import (
    SIZE,
    clip_like,
    random_scene_cameras,
    random_scene_gaussians,
    random_scene_regions,
    voronoi_labels,
)


def test_the_same_seed_gives_the_same_gaussians():
    one, same, other = (random_scene_gaussians(500, seed=seed) for seed in (0, 0, 1))
    assert one.fingerprint() == same.fingerprint()
    assert torch.equal(one.sh, same.sh)
    assert one.fingerprint() != other.fingerprint()


@pytest.mark.parametrize("count", [1, 2, 30, 1000])
def test_a_scene_of_any_size(count):
    gaussians = random_scene_gaussians(count)
    assert len(gaussians) == count
    assert gaussians.finite().all()
    assert torch.allclose(gaussians.quats.norm(dim=1), torch.ones(count))
    assert ((gaussians.opacities > 0) & (gaussians.opacities < 1)).all()
    assert (gaussians.means >= -0.1).all()
    assert (gaussians.means <= torch.from_numpy(SIZE) + 0.1).all()


def test_a_scene_without_gaussians_is_refused():
    with refuses():
        random_scene_gaussians(0)


def test_every_camera_is_inside_and_sees_the_scene():
    gaussians = random_scene_gaussians(2000)
    for camera in random_scene_cameras(9, 64, 48):
        assert (camera.position.numpy() > 0.2).all()
        assert (camera.position.numpy() < SIZE - 0.2).all()
        _, alpha = raster.render_channels(raster.project(gaussians, camera), torch.ones(len(gaussians), 1))
        assert alpha.mean() > 0.5, camera.name


def test_cameras_of_any_size():
    lerf, small = random_scene_cameras(1)[0], random_scene_cameras(3, 494, 300)[0]
    assert (lerf.width, lerf.height, lerf.fx) == (988, 731, 700)
    assert (small.width, small.height, small.fx) == (494, 300, 350)
    assert torch.equal(lerf.viewmat, small.viewmat)
    assert len({tuple(camera.position.tolist()) for camera in random_scene_cameras(7)}) == 7


def test_labels_are_the_nearest_seed():
    labels = voronoi_labels((5, 1, 3000), 40, 30, seed=3)
    assert (labels.dtype, labels.shape) == (torch.int32, (3, 30, 40))
    assert [int(level.max()) + 1 for level in labels] == [5, 1, 1200]
    assert all(len(level.unique()) == count for level, count in zip(labels, (5, 1, 1200), strict=True))
    assert torch.equal(labels, voronoi_labels((5, 1, 3000), 40, 30, seed=3))
    seeds = np.random.default_rng(3).choice(1200, 5, replace=False)
    rows, columns = np.mgrid[:30, :40]
    away = [(rows - seed // 40) ** 2 + (columns - seed % 40) ** 2 for seed in seeds]
    nearest = np.take_along_axis(np.stack(away), labels[:1].numpy().astype(np.int64), 0)[0]
    assert np.array_equal(nearest, np.min(away, axis=0))


def test_embeddings_are_as_alike_as_those_of_clip():
    rows = clip_like(400, 512, seed=1, n_objects=300)
    assert torch.allclose(rows.norm(dim=1), torch.ones(400))
    cosines = rows @ rows.T
    pairs = cosines[~torch.eye(400, dtype=torch.bool)]
    assert 0.45 < float(pairs.median()) < 0.6
    assert float(pairs.quantile(0.999)) > 0.8


def test_regions_of_every_view():
    cameras = random_scene_cameras(5, 40, 30)
    regions = random_scene_regions(cameras, (8, 4, 2), dim=16, distinct=2)
    assert (regions.levels, regions.view_names) == (LEVELS, cameras.names)
    labels, embeddings = regions.load_view(cameras[3].name, 40, 30)
    assert labels.shape == (3, 30, 40)
    assert [tuple(rows.shape) for rows in embeddings] == [(8, 16), (4, 16), (2, 16)]
    assert regions.embeddings("m")[0].shape == (20, 16)
    assert torch.equal(labels, regions.load_view(cameras[1].name, 40, 30)[0])  # maps are shared in turn
    assert not torch.equal(embeddings[0], regions.load_view(cameras[1].name, 40, 30)[1][0])
    again = random_scene_regions(cameras, (8, 4, 2), dim=16, distinct=2)
    assert torch.equal(again.embeddings("s")[0], regions.embeddings("s")[0])
    with refuses():
        random_scene_regions(cameras, (1, 2, 3, 4))
