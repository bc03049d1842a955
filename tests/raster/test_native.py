"""The compiled core against the reference: every function, over random and hard scenes."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st

from raster.hard_scenes import any_scenes, hard_scene
from raster.parity import (
    assert_channels_agree,
    assert_codes_agree,
    assert_same_sums,
    both,
    close_calls,
    explained_flips,
    labels_at,
    needs_native,
    painted,
    random_codes,
    same_bytes,
    sure_pixels,
)
from scoup import raster
from scoup.raster.combinations import combine_reference
from support import examples, make_camera, random_gaussians, random_labels, threads_of_torch

pytestmark = needs_native
PRESETS = st.sampled_from(["inria", "gsplat"])
SEEDS = st.integers(0, 2**31)
CHANNELS = (0, 1, 3, 8, 9, 17, 64, 130)
SIZES = [(1, 1), (1, 37), (37, 1), (16, 16), (17, 17), (4097, 3), (8192, 2), (8192, 64)]  # width, height


@settings(max_examples=examples(60))
@given(scene=any_scenes(), preset=PRESETS, channels=st.sampled_from(CHANNELS), seed=SEEDS)
def test_channels_and_alpha(scene, preset, channels, seed):
    values = torch.randn(len(scene[0]), channels, generator=torch.Generator().manual_seed(seed))
    assert_channels_agree(both(scene[0], scene[1], preset), scene, preset, values)


@settings(max_examples=examples(40))
@given(
    scene=any_scenes(),
    preset=PRESETS,
    levels=st.integers(1, 8),
    regions=st.sampled_from([1, 3, 40, 10**6]),
    dtype=st.sampled_from([torch.int32, torch.int64, torch.int16]),
    seed=SEEDS,
)
@example(hard_scene("wall", 3), "inria", 1, 10**6, torch.int32, 0)
@example(hard_scene("wall", 3), "inria", 8, 10**6, torch.int32, 1)
def test_region_sums(scene, preset, levels, regions, dtype, seed):
    labels = labels_at(scene, preset, levels, regions, seed % 1000).to(dtype)
    native, reference = both(scene[0], scene[1], preset)
    assert_same_sums(raster.region_sums(native, labels), raster.region_sums(reference, labels))


@settings(max_examples=examples(30))
@given(scene=any_scenes(), highest=st.sampled_from([2**16, 2**24 + 1, 2**31 - 2]), levels=st.integers(1, 8))
def test_label_numbers_may_be_huge(scene, highest, levels):
    """Only the names of the regions change."""
    gaussians, camera = scene
    projection = raster.project(gaussians, camera, backend="native")
    labels = random_labels(levels, camera.height, camera.width, 3, 5).long()
    sums, large = raster.region_sums(projection, labels), torch.tensor([0, highest // 2, highest])
    found = raster.region_sums(projection, torch.where(labels >= 0, large[labels.clamp(min=0)], -1))
    renamed = torch.where(sums.table >= 0, large[sums.table.long().clamp(min=0)], -1)
    assert same_bytes(found, replace(sums, table=renamed.int()))


@settings(max_examples=examples(60))
@given(
    levels=st.integers(1, 9),
    width=st.integers(1, 70),
    height=st.integers(1, 40),
    regions=st.sampled_from([1, 3, 500]),
    edge=st.sampled_from([1, 5]),
    dtype=st.sampled_from([torch.int8, torch.uint8, torch.int16, torch.int32, torch.int64]),
    threads=st.integers(1, 3),
    seed=SEEDS,
)
def test_combinations(levels, width, height, regions, edge, dtype, threads, seed):
    generator = torch.Generator().manual_seed(seed)
    regions = min(regions, 100) if dtype in (torch.int8, torch.uint8) else regions
    lowest = 0 if dtype == torch.uint8 else -3
    labels = torch.randint(
        lowest, regions, (levels, -(-height // edge), -(-width // edge)), generator=generator
    )
    labels = labels.repeat_interleave(edge, 1).repeat_interleave(edge, 2)[:, :height, :width].to(dtype)
    with threads_of_torch(threads):
        found = raster.combine(labels)
    expected = combine_reference(labels.long())
    assert torch.equal(found.map, expected.map)
    assert torch.equal(found.table, expected.table)
    assert found.digest() == expected.digest()
    # Labels come back, all numbers below 0 as -1.
    none = torch.full((1, levels), -1, dtype=torch.int32)
    known = torch.cat([found.table, none])[found.map.long()].movedim(2, 0)
    assert torch.equal(known, labels.int().clamp(min=-1))


@settings(max_examples=examples(60))
@given(
    scene=any_scenes(),
    preset=PRESETS,
    levels=st.integers(1, 8),
    n_atoms=st.sampled_from([1, 7, 64, 256, 257, 1024]),
    k=st.integers(1, 16),
    halves=st.booleans(),
    longs=st.booleans(),
    seed=SEEDS,
)
def test_codes_and_cosines(scene, preset, levels, n_atoms, k, halves, longs, seed):
    gaussians, camera = scene
    if camera.width * camera.height * levels * n_atoms > 4_000_000:
        levels = 1
    indices, weights, *vectors = random_codes(len(gaussians), levels, k, n_atoms, seed, repeated=True)
    codes = indices.long() if longs else indices, weights.half() if halves else weights, *vectors
    assert_codes_agree(both(gaussians, camera, preset), sure_pixels(gaussians, camera, preset), codes)


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_image_sizes(width, height):
    gaussians = random_gaussians(60, width, ("plain", "needle", "huge", "tiny"))
    gaussians.opacities[gaussians.scales[:, 0] > 10] *= 0.1
    camera = make_camera(width, height, 0.4 * width, 7)
    native, reference = both(gaussians, camera)
    values = torch.rand(60, 3, generator=torch.Generator().manual_seed(0))
    image = painted(native, values)
    assert image.any()
    flips = explained_flips(gaussians, camera, "inria", image, painted(reference, values))
    assert flips.pixels.sum() <= max(1, 1e-3 * width * height)

    labels = random_labels(2, height, width, 11, 0)
    labels[:, flips.pixels] = -1
    assert_same_sums(raster.region_sums(native, labels), raster.region_sums(reference, labels))
    assert_codes_agree((native, reference), ~flips.pixels, random_codes(60, 1, 2, 3, 0))


def test_a_close_call_is_found():
    """The float64 evaluation itself: one Gaussian whose alpha crosses 1/255 at a pixel's centre."""
    gaussians = random_gaussians(1, 0).select(torch.tensor([0]))
    gaussians.means[:] = torch.tensor([0.0, 0.0, 4.0])
    gaussians.opacities[:] = 1.00001 / 255
    camera = make_camera(9, 9)  # the principal point is the centre of pixel (4, 4)
    here, there = torch.tensor([4]), torch.tensor([0])
    assert close_calls(gaussians, camera, "inria", here, here).tolist() == [1]
    assert close_calls(gaussians, camera, "inria", there, there).tolist() == [0]
