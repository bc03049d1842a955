"""A scene prepared for many views shows the same as the scene itself, also where chunks of Gaussians that a camera
cannot see are passed over."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from raster.hard_scenes import any_scenes, hard_scene
from raster.parity import BACKENDS, needs_native, same_bytes
from scoup import raster
from scoup.raster import native
from scoup.raster.ordering import morton_order
from scoup.scene import Camera, Gaussians
from support import examples, random_gaussians, random_labels

on_every_backend = pytest.mark.parametrize("backend", BACKENDS)
COUNT = 30_000  # Gaussians of a town: four chunks


@on_every_backend
@settings(max_examples=examples(40))
@given(scene=any_scenes())
@example(hard_scene("equal depths", 4))  # the original rows decide
def test_views_show_the_same(backend, scene):
    """Behind the camera, huge, needles, not finite, opacities of 0 and infinity; empty scenes, images of one pixel.
    Region sums are in the new order."""
    gaussians, camera = scene
    prepared = raster.prepare_gaussians(gaussians, backend)
    order = torch.arange(len(gaussians)) if prepared.order is None else prepared.order
    plain, view = raster.project(gaussians, camera, backend=backend), raster.project(prepared, camera)
    values = torch.arange(3.0 * len(gaussians)).reshape(-1, 3)
    expected = raster.render_channels(plain, values)
    found = raster.render_channels(view, values[order])
    assert all(torch.equal(a, b) for a, b in zip(found, expected, strict=True))
    labels = random_labels(2, camera.height, camera.width, 5, 0)
    sums = raster.region_sums(view, labels)
    rows = order[sums.gaussian.long()]
    moved = (rows * len(sums.table) + sums.combination).argsort()
    restored = rows[moved].int(), sums.combination[moved], sums.weight[moved]
    assert same_bytes(raster.ViewSums(*restored, sums.table), raster.region_sums(plain, labels))


@on_every_backend
@pytest.mark.parametrize("dtype", [torch.float32, torch.uint8, torch.uint16])
def test_rows_are_restored(backend, dtype):
    gaussians = random_gaussians(100, 1)
    scene = raster.prepare_gaussians(gaussians, backend)
    numbers = torch.arange(100).to(dtype)
    rows = torch.stack([numbers, numbers], 1)
    order = torch.arange(100) if scene.order is None else scene.order
    moved = rows.view(torch.int16)[order].view(dtype) if dtype == torch.uint16 else rows[order]
    assert torch.equal(raster.restored(moved, order).long(), rows.long())


def test_the_order_is_along_a_curve():
    """Halves of a row of points stay together, whatever the order they came in; what is not finite is kept."""
    means = torch.zeros(64, 3)
    means[:, 0] = torch.randperm(64).float()
    assert means[morton_order(means), 0].tolist() == sorted(means[:, 0].tolist())
    means[3] = torch.nan
    means[5, 1] = torch.inf
    assert sorted(morton_order(means).tolist()) == list(range(64))
    assert morton_order(means[:0]).shape == (0,)


# Chunks of the compiled core.


def town(seed: int) -> Gaussians:
    """Gaussians far apart, some of them huge, needles, or not finite."""
    numbers = np.random.default_rng(seed)
    means = numbers.uniform(-50, 50, (COUNT, 3)) * [1, 1, 0.05]
    scales = 10 ** numbers.uniform(-2, 0, (COUNT, 3))
    odd = numbers.integers(0, COUNT, 40)
    scales[odd[:10]] *= [100, 0.01, 1]
    means[odd[10:20], 0] = np.nan
    scales[odd[20:30]] = np.inf
    opacities = numbers.uniform(0, 1, COUNT)
    opacities[odd[30:]] = np.inf
    return Gaussians(means, numbers.normal(size=(COUNT, 4)), scales, opacities, np.zeros((COUNT, 1, 3)))  # type: ignore[arg-type]


@needs_native
@settings(max_examples=examples(25), deadline=None)
@given(
    seed=st.integers(0, 3),
    eye=st.tuples(*[st.floats(-60, 60)] * 3),
    target=st.tuples(*[st.floats(-60, 60)] * 3),
    focal=st.sampled_from([10.0, 60.0, 400.0]),
    preset=st.sampled_from(sorted(raster.RASTER_PRESETS)),
    most=st.sampled_from([0, native.MOST_ROWS_IN_MEMORY]),
)
def test_what_is_seen_is_the_same(
    seed: int, eye: tuple[float, ...], target: tuple[float, ...], focal: float, preset: str, most: int
) -> None:
    assume(np.linalg.norm(np.subtract(eye, target)[:2]) >= 1e-3)
    camera = Camera.look_at(eye, target, "view", 64, 48, focal)
    gaussians = town(seed)
    labels = torch.arange(4).repeat_interleave(16).expand(48, 64)[None]
    with pytest.MonkeyPatch.context() as patch:
        for module in (native, raster):
            patch.setattr(module, "MOST_ROWS_IN_MEMORY", most)
        prepared = raster.prepare_gaussians(gaussians, "native")
    plain = dataclasses.replace(
        prepared, handle=native.make_scene(prepared.gaussians, prepared.order, many_views=False)
    )
    found = [raster.region_sums(raster.project(each, camera, preset), labels) for each in (prepared, plain)]
    assert same_bytes(*found)


@needs_native
def test_chunks_are_passed_over() -> None:
    """A camera that sees a corner of the town keeps memory for fewer rows than there are."""
    gaussians = dataclasses.replace(town(0), scales=torch.full((COUNT, 3), 0.01))
    prepared = raster.prepare_gaussians(gaussians, "native")
    rows = []
    away, corner, everything = ((70, 0, 0), (80, 0, 0)), ((40, 40, 0), (60, 60, 0)), ((-300, 0, 0), (0, 0, 0))
    for eye, target in (away, corner, everything):
        projection = raster.project(prepared, Camera.look_at(eye, target, "view", 64, 48, 60.0))
        assert isinstance(projection, native.NativeProjection)
        rows.append(projection.handle.n_looked_at)
    assert rows[0] == 0 < rows[1] < rows[2] == COUNT
