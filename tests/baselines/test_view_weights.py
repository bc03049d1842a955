"""Blending weights of small views as matrices, against the rasteriser."""

from __future__ import annotations

import pytest
import torch

from messages import refuses
from scoup import raster
from scoup_lab.baselines.rasterised_scene import RasterisedScene
from scoup_lab.baselines.view_weights import rendered, weights_of_views
from support import small_scene


@pytest.mark.parametrize("width", [20, 40, 400])
def test_products_with_the_weights_are_renderings(width: int) -> None:
    gaussians, cameras, regions = small_scene(80, views=2)
    views = weights_of_views(RasterisedScene(gaussians, cameras, regions), width)
    assert [view.name for view in views] == list(regions.view_names)
    channels = torch.randn(80, 5)
    for camera, view in zip(cameras, views, strict=True):
        small = camera.resized(20, 15) if width == 20 else camera  # never enlarged
        image, _ = raster.render_channels(raster.project(gaussians, small), channels)
        labels = regions.load_labels(camera.name, small.width, small.height).flatten(1).long()
        described = (labels >= 0).any(0)
        assert torch.equal(view.labels, labels[:, described])
        found = rendered(view, channels[view.members])
        assert torch.allclose(found, image.view(-1, 5)[described], atol=1e-5)


def test_members_are_those_that_paint() -> None:
    scene = RasterisedScene(*small_scene(80, views=1))
    (view,) = weights_of_views(scene, 40)
    painting = torch.from_numpy(view.weights.sum(0) > 0)
    assert painting.all()
    assert len(view.members) < 80
    assert torch.equal(view.members, view.members.unique())


def test_a_width_of_nothing_is_refused() -> None:
    with refuses():
        weights_of_views(RasterisedScene(*small_scene(20, views=1)), 0)
