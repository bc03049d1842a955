"""A scene prepared for many views shows the same as the scene itself."""

from __future__ import annotations

import pytest
import torch
from hypothesis import example, given, settings

from raster.hard_scenes import any_scenes, hard_scene
from raster.parity import BACKENDS
from scoup import raster
from scoup.raster.ordering import morton_order
from support import examples, make_camera, random_gaussians, random_labels

pytestmark = pytest.mark.parametrize("backend", BACKENDS)


@settings(max_examples=examples(40))
@given(scene=any_scenes())
@example(hard_scene("equal depths", 4))  # the original rows decide
def test_views_show_the_same(backend, scene):
    """Behind the camera, huge, needles, not finite, opacities of 0 and infinity; empty scenes, images of one pixel."""
    gaussians, camera = scene
    prepared = raster.prepare_gaussians(gaussians, backend)
    values = torch.arange(3.0 * len(gaussians)).reshape(-1, 3)
    moved = values if prepared.order is None else values[prepared.order]
    expected = raster.render_channels(raster.project(gaussians, camera, backend=backend), values)
    found = raster.render_channels(raster.project(prepared, camera), moved)
    assert all(torch.equal(a, b) for a, b in zip(found, expected, strict=True))


@pytest.mark.parametrize("dtype", [torch.float32, torch.uint8, torch.uint16])
def test_rows_are_restored(backend, dtype):
    gaussians = random_gaussians(100, 1)
    scene = raster.prepare_gaussians(gaussians, backend)
    numbers = torch.arange(100).to(dtype)
    rows = torch.stack([numbers, numbers], 1)
    order = torch.arange(100) if scene.order is None else scene.order
    moved = rows.view(torch.int16)[order].view(dtype) if dtype == torch.uint16 else rows[order]
    assert torch.equal(raster.restored(moved, order).long(), rows.long())


def test_region_sums_are_in_the_new_order(backend):
    gaussians, camera = random_gaussians(80, 3), make_camera()
    labels = random_labels(2, 30, 40, 5, 0)
    scene = raster.prepare_gaussians(gaussians, backend)
    order = torch.arange(80) if scene.order is None else scene.order
    expected = raster.region_sums(raster.project(gaussians, camera, backend=backend), labels)
    found = raster.region_sums(raster.project(scene, camera), labels)
    assert sorted(
        zip(order[found.gaussian.long()].tolist(), found.combination.tolist(), strict=True)
    ) == list(zip(expected.gaussian.tolist(), expected.combination.tolist(), strict=True))
    assert torch.equal(found.weight.sort().values, expected.weight.sort().values)


def test_the_order_is_along_a_curve(backend):
    """Halves of a row of points stay together, whatever the order they came in; what is not finite is kept."""
    means = torch.zeros(64, 3)
    means[:, 0] = torch.randperm(64).float()
    assert means[morton_order(means), 0].tolist() == sorted(means[:, 0].tolist())
    means[3] = torch.nan
    means[5, 1] = torch.inf
    assert sorted(morton_order(means).tolist()) == list(range(64))
    assert morton_order(means[:0]).shape == (0,)
