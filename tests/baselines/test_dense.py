"""Dense uplift against its definition, pixel by pixel."""

from __future__ import annotations

import torch

from scoup import raster
from scoup.field import relevancy
from scoup.uplift import region_sums
from scoup_lab.baselines.dense import dense_features, mean_features
from scoup_lab.baselines.fitted import FittedChannels
from scoup_lab.baselines.methods import METHODS
from scoup_lab.baselines.rasterised_scene import RasterisedScene
from support import small_scene, unit


def test_features_are_sums_and_means_of_embeddings() -> None:
    """``dense_features`` of unit norm; ``mean_features`` as long as the paper's Eq. 3 makes them."""
    gaussians, cameras, regions = small_scene(count=60, views=2)
    sums = region_sums(gaussians, cameras, regions)
    for s, level in enumerate(regions.levels):
        rows, _ = regions.embeddings(level)
        summed, total = torch.zeros(60, 16), torch.zeros(60)
        for camera in cameras:
            region_map = regions.load(camera.name, level)
            weights, _ = raster.render_channels(raster.project(gaussians, camera), torch.eye(60))
            has = region_map.labels >= 0
            summed += weights[has].T @ region_map.embeddings[region_map.labels[has].long()]
            total += weights[has].sum(0)
        assert torch.allclose(dense_features(sums, rows, s), unit(summed), atol=1e-4)
        found, seen = mean_features(sums, rows, s), total > 1e-4
        assert torch.allclose(found[seen], (summed / total[:, None])[seen], atol=1e-4)
        lengths = found.norm(dim=1)
        assert lengths.max() <= 1 + 1e-5
        assert lengths[seen].min() < 0.9  # regions differ
        assert not found[total == 0].any()


def test_relevancy_is_that_of_the_rendered_features() -> None:
    gaussians, cameras, regions = small_scene(count=60, views=1)
    scene = RasterisedScene(gaussians, cameras, regions)
    fitted = METHODS["dense"].fit(scene)
    assert isinstance(fitted, FittedChannels)
    queries, canonical = unit(torch.randn(2, 16)), unit(torch.randn(3, 16))
    projection = raster.project(gaussians, cameras[0])
    found = fitted.relevancy(projection, queries, canonical)
    for level, features in enumerate(fitted.channels):
        image = unit(raster.render_channels(projection, features)[0])
        expected = relevancy(
            (image @ queries.T).permute(2, 0, 1)[None], (image @ canonical.T).permute(2, 0, 1)[None]
        )
        assert torch.allclose(found[level], expected[0], atol=1e-6)
