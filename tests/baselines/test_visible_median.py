"""The streaming median of directions, Gaussian by Gaussian and view by view."""

from __future__ import annotations

import pytest
import torch

from messages import refuses
from scoup.uplift import RegionSums
from scoup_lab.baselines.fitted import FittedChannels
from scoup_lab.baselines.methods import METHODS
from scoup_lab.baselines.pixel_rules import VisibleInView
from scoup_lab.baselines.rasterised_scene import RasterisedScene
from scoup_lab.baselines.visible_median import streaming_median
from support import small_scene


@pytest.mark.parametrize("views", [1, 4])
def test_against_a_loop(views: int) -> None:
    scene = RasterisedScene(*small_scene(count=50, views=views))
    inputs = scene.inputs(VisibleInView())
    for level, embeddings in enumerate(inputs.embeddings):
        assert inputs.sums.rows is not None
        expected = torch.zeros(50, 16)
        weights = [0.0] * 50
        for view, rows in inputs.sums.rows[level].items():
            for gaussian, region, weight in zip(*inputs.sums.triplets(view, level), strict=True):
                direction = embeddings[rows][int(region)]
                weights[gaussian] += float(weight)
                before = expected[gaussian]
                moved = before + float(weight) / weights[gaussian] * (
                    direction - (direction @ before) * before
                )
                expected[gaussian] = moved / moved.norm()
        found = streaming_median(inputs.sums, embeddings, level)
        assert torch.allclose(found, expected, atol=1e-5)
        assert torch.equal(found.any(1), torch.tensor(weights) > 0)
        assert 0 < int(found.any(1).sum()) < 50


def test_several_regions_in_a_view_enter_as_their_mean() -> None:
    scene = RasterisedScene(*small_scene(count=40, views=1))
    inputs = scene.inputs()
    found = streaming_median(inputs.sums, inputs.embeddings[0], 0)
    mean = torch.from_numpy(inputs.sums.matrix(0) @ inputs.embeddings[0].numpy())
    assert torch.allclose(found, torch.nn.functional.normalize(mean, dim=1), atol=1e-5)


def test_the_method_is_this_median_behind_the_gate() -> None:
    scene = RasterisedScene(*small_scene(count=50, views=3))
    fitted = METHODS["visible-centre-median"].fit(scene)
    assert isinstance(fitted, FittedChannels)
    inputs = scene.inputs(VisibleInView(0.75, 0.13))
    for level, channels in enumerate(fitted.channels):
        assert torch.equal(channels, streaming_median(inputs.sums, inputs.embeddings[level], level))


def test_rows_must_be_known() -> None:
    gaussians, _, regions = small_scene(count=5, views=1)
    with refuses():
        streaming_median(RegionSums.empty(gaussians, regions.levels), torch.ones(3, 4), 0)
