"""The compiled core against the reference: every function, over random and hard scenes."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from raster.hard_scenes import any_scenes, hard_scene
from raster.parity import (
    assert_close,
    assert_same_sums,
    both,
    close_calls,
    explained_flips,
    needs_native,
    same_bytes,
    span_of,
    sure_pixels,
)
from scoup import raster
from scoup.raster.combinations import combine_reference
from scoup.scene.codes import index_dtype
from support import examples, make_camera, random_gaussians, random_labels, unit

pytestmark = needs_native
PRESETS = st.sampled_from(["inria", "gsplat"])
SEEDS = st.integers(0, 2**31)
CHANNELS = (0, 1, 3, 8, 9, 17, 64, 130)
SIZES = [(1, 1), (1, 37), (37, 1), (16, 16), (17, 17), (4097, 3), (8192, 2), (8192, 64)]  # width, height


def random_codes(count, levels, k, n_atoms, seed, dtype=torch.float32):
    """(indices, weights) [N, S, K] with a third of the Gaussians without a code; atoms may repeat."""
    generator = torch.Generator().manual_seed(seed)
    indices = torch.randint(n_atoms, (count, levels, k), generator=generator).to(index_dtype(n_atoms))
    weights = torch.rand(count, levels, k, generator=generator).sort(dim=2, descending=True).values
    weights[torch.rand(count, generator=generator) < 0.3] = 0
    return indices, weights.to(dtype)


@settings(max_examples=examples(60))
@given(scene=any_scenes(), preset=PRESETS, channels=st.sampled_from(CHANNELS), seed=SEEDS)
def test_channels_and_alpha(scene, preset, channels, seed):
    gaussians, camera = scene
    native, reference = both(gaussians, camera, preset)
    values = torch.randn(len(gaussians), channels, generator=torch.Generator().manual_seed(seed))
    image, alpha = raster.render_channels(native, values)
    expected, expected_alpha = raster.render_channels(reference, values)
    assert image.shape == (camera.height, camera.width, channels)
    actual = torch.cat([image, alpha[..., None]], 2)
    expected = torch.cat([expected, expected_alpha[..., None]], 2)
    span = max(1.0, span_of(values))
    sure = sure_pixels(gaussians, camera, preset)
    assert_close(actual, expected, span, sure)
    explained_flips(gaussians, camera, preset, actual, expected, span)
    assert (image[alpha == 0] == 0).all()


@settings(max_examples=examples(40))
@given(
    scene=any_scenes(),
    preset=PRESETS,
    levels=st.integers(1, 8),
    regions=st.sampled_from([1, 3, 40, 100_000]),
    dtype=st.sampled_from([torch.int32, torch.int64, torch.int16]),
    seed=SEEDS,
)
def test_region_sums(scene, preset, levels, regions, dtype, seed):
    gaussians, camera = scene
    native, reference = both(gaussians, camera, preset)
    regions = min(regions, 30_000) if dtype == torch.int16 else regions
    labels = random_labels(levels, camera.height, camera.width, regions, seed % 1000).to(dtype)
    labels[:, ~sure_pixels(gaussians, camera, preset)] = -1
    assert_same_sums(raster.region_sums(native, labels), raster.region_sums(reference, labels))


@pytest.mark.parametrize("levels", [1, 3, 8])
@pytest.mark.parametrize("holes", [0.0, 0.5])
def test_every_pixel_its_own_region(levels, holes):
    gaussians, camera = hard_scene("wall", 3)
    native, reference = both(gaussians, camera)
    generator = torch.Generator().manual_seed(levels)
    pixels = camera.height * camera.width
    labels = torch.stack([torch.randperm(pixels, generator=generator) for _ in range(levels)])
    labels[torch.rand(labels.shape, generator=generator) < holes] = -1
    labels = labels.view(levels, camera.height, camera.width).int()
    labels[:, ~sure_pixels(gaussians, camera)] = -1
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
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        found = raster.combine(labels)
    finally:
        torch.set_num_threads(before)
    expected = combine_reference(labels.long())
    assert torch.equal(found.map, expected.map)
    assert torch.equal(found.table, expected.table)
    assert found.digest() == expected.digest()
    # Labels come back, all numbers below 0 as -1.
    none = torch.full((1, levels), -1, dtype=torch.int32)
    known = torch.cat([found.table, none])[found.map.long()].movedim(2, 0)
    assert torch.equal(known, labels.int().clamp(min=-1))


@settings(max_examples=examples(40))
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
def test_codes(scene, preset, levels, n_atoms, k, halves, longs, seed):
    gaussians, camera = scene
    if camera.width * camera.height * levels * n_atoms > 4_000_000:
        levels = 1
    native, reference = both(gaussians, camera, preset)
    dtype = torch.float16 if halves else torch.float32
    indices, weights = random_codes(len(gaussians), levels, k, n_atoms, seed, dtype)
    indices = indices.long() if longs else indices
    actual = raster.render_codes(native, indices, weights, n_atoms)
    expected = raster.render_codes(reference, indices, weights, n_atoms)
    assert actual.shape == (levels, camera.height, camera.width, n_atoms)
    sure = sure_pixels(gaussians, camera, preset)
    assert_close(actual.movedim(0, 2), expected.movedim(0, 2), max(1, k / 4), sure)


@settings(max_examples=examples(40))
@given(
    scene=any_scenes(),
    preset=PRESETS,
    levels=st.integers(1, 8),
    n_atoms=st.sampled_from([1, 7, 64, 300]),
    k=st.integers(1, 16),
    n_queries=st.integers(1, 20),
    alike=st.booleans(),
    seed=SEEDS,
)
def test_cosines(scene, preset, levels, n_atoms, k, n_queries, alike, seed):
    gaussians, camera = scene
    native, reference = both(gaussians, camera, preset)
    generator = torch.Generator().manual_seed(seed)
    codebook = torch.randn(levels, n_atoms, 24, generator=generator) + float(alike)
    queries = unit(torch.randn(n_queries, 24, generator=generator))
    indices, weights = random_codes(len(gaussians), levels, k, n_atoms, seed)
    actual = raster.render_cosines(native, indices, weights, codebook, queries)
    expected = raster.render_cosines(reference, indices, weights, codebook, queries)
    assert actual.shape == (levels, n_queries, camera.height, camera.width)
    # Where atoms cancel, so do digits: a feature is known to the share that is left of its terms.
    painted = raster.render_codes(reference, indices, weights, n_atoms)
    terms = (painted * codebook.norm(dim=2)[:, None, None]).sum(3)
    left = torch.einsum("shwl,sld->shwd", painted, codebook).norm(dim=3) / terms.clamp(min=1e-30)
    whole = (left > 0.1).all(0) & sure_pixels(gaussians, camera, preset)
    assert_close(actual.permute(2, 3, 0, 1), expected.permute(2, 3, 0, 1), 5.0, whole)
    assert torch.isfinite(actual).all()
    assert (actual.abs() <= 1 + 1e-3).all()
    unpainted = (painted == 0).all(3) & sure_pixels(gaussians, camera, preset)
    assert (actual.movedim(1, 3)[unpainted] == 0).all()


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_image_sizes(width, height):
    gaussians = random_gaussians(60, width, ("plain", "needle", "huge", "tiny"))
    gaussians.opacities[gaussians.scales[:, 0] > 10] *= 0.1
    camera = make_camera(width, height, 0.4 * width, 7)
    native, reference = both(gaussians, camera)
    values = torch.rand(60, 3, generator=torch.Generator().manual_seed(0))
    images = []
    for projection in (native, reference):
        image, alpha = raster.render_channels(projection, values)
        images.append(torch.cat([image, alpha[..., None]], 2))
    assert images[0].any()
    flips = explained_flips(gaussians, camera, "inria", images[0], images[1])
    assert flips.pixels.sum() <= max(1, 1e-3 * width * height)

    labels = random_labels(2, height, width, 11, 0)
    labels[:, flips.pixels] = -1
    assert_same_sums(raster.region_sums(native, labels), raster.region_sums(reference, labels))
    codebook, queries = torch.rand(2, 12, 8), unit(torch.rand(2, 8))
    indices, weights = random_codes(60, 2, 3, 12, 0)
    cosines = [
        raster.render_cosines(projection, indices, weights, codebook, queries)
        for projection in (native, reference)
    ]
    assert_close(cosines[0].permute(2, 3, 0, 1), cosines[1].permute(2, 3, 0, 1), 1.0, ~flips.pixels)


def test_a_close_call_is_found():
    """The float64 evaluation itself: one Gaussian whose alpha crosses 1/255 at a pixel's centre."""
    gaussians = random_gaussians(1, 0).select(torch.tensor([0]))
    gaussians.means[:] = torch.tensor([0.0, 0.0, 4.0])
    gaussians.opacities[:] = 1.00001 / 255
    camera = make_camera(9, 9)  # the principal point is the centre of pixel (4, 4)
    here, there = torch.tensor([4]), torch.tensor([0])
    assert close_calls(gaussians, camera, "inria", here, here).tolist() == [1]
    assert close_calls(gaussians, camera, "inria", there, there).tolist() == [0]
