"""The compiled core against the reference: every function, over random and hard scenes, any form of tensors, any number
of threads and every instruction set."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st

from messages import refuses
from raster.hard_scenes import HARD_KINDS, any_scenes, hard_scene
from raster.parity import (
    assert_channels_agree,
    assert_close,
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
from scoup.base import required_core
from scoup.raster.combinations import combine_reference
from scoup.scene import Camera, Gaussians
from support import examples, make_camera, random_gaussians, random_labels, threads_of_torch, unit

pytestmark = needs_native
PRESETS = st.sampled_from(["inria", "gsplat"])
SEEDS = st.integers(0, 2**31)
CHANNELS = (0, 1, 3, 8, 9, 17, 64, 130)
SIZES = [(1, 1), (1, 37), (37, 1), (16, 16), (17, 17), (4097, 3), (8192, 2), (8192, 17)]  # width, height


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
    if camera.width * camera.height * levels * n_atoms > 1_000_000:
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
    flipped = explained_flips(gaussians, camera, "inria", image, painted(reference, values))
    assert flipped.sum() <= max(1, 1e-3 * width * height)

    labels = random_labels(2, height, width, 11, 0)
    labels[:, flipped] = -1
    assert_same_sums(raster.region_sums(native, labels), raster.region_sums(reference, labels))
    assert_codes_agree((native, reference), ~flipped, random_codes(60, 1, 2, 3, 0))


def test_a_close_call_is_found():
    """The float64 evaluation itself: one Gaussian whose alpha crosses 1/255 at a pixel's centre."""
    gaussians = random_gaussians(1, 0).select(torch.tensor([0]))
    gaussians.means[:] = torch.tensor([0.0, 0.0, 4.0])
    gaussians.opacities[:] = 1.00001 / 255
    camera = make_camera(9, 9)  # the principal point is the centre of pixel (4, 4)
    here, there = torch.tensor([4]), torch.tensor([0])
    assert close_calls(gaussians, camera, "inria", here, here).tolist() == [1]
    assert close_calls(gaussians, camera, "inria", there, there).tolist() == [0]


# Other forms of tensors that the compiled core is handed, and labels that it must refuse.

COUNT, ATOMS = 50, 8
CAMERA = make_camera()


def a_view() -> raster.Projection:
    return raster.project(random_gaussians(COUNT, 1), CAMERA, backend="native")


def apart(tensor: torch.Tensor) -> torch.Tensor:
    """The same values with gaps between them in memory."""
    found = torch.stack([tensor, tensor], -1)[..., 0]
    assert not found.is_contiguous()
    return found


FORMS = {
    "apart": apart,
    "float64": lambda tensor: tensor.double() if tensor.is_floating_point() else tensor.long(),
    "requires_grad": lambda tensor: (
        tensor.clone().requires_grad_() if tensor.is_floating_point() else tensor.int()
    ),
}


@pytest.mark.parametrize("form", FORMS)
def test_other_forms_of_the_same_numbers(form):
    generator, projection = torch.Generator().manual_seed(0), a_view()
    values, labels = torch.rand(COUNT, 3, generator=generator), random_labels(3, 30, 40, 5, 0)
    indices, weights, codebook, queries = random_codes(COUNT, 3, 4, ATOMS, 0)
    given = values, labels, indices, weights, codebook, queries
    found, expected = (
        (
            raster.render_channels(projection, values)[0],
            raster.region_sums(projection, labels),
            raster.render_codes(projection, indices, weights, ATOMS),
            raster.render_cosines(projection, indices, weights, codebook, queries),
        )
        for values, labels, indices, weights, codebook, queries in (map(FORMS[form], given), given)
    )
    assert torch.equal(found[0], expected[0])
    assert_same_sums(found[1], expected[1])
    assert torch.equal(found[2], expected[2])
    assert_close(found[3], expected[3])
    assert not found[3].requires_grad


@pytest.mark.parametrize("form", ["apart", "requires_grad", "negative scales"])
def test_other_forms_of_the_scene(form):
    """A covariance holds squares of scales, so their sign means nothing."""
    plain, values = random_gaussians(COUNT, 1), torch.rand(COUNT, 3)
    if form == "negative scales":
        changed = replace(plain, scales=-plain.scales)
    else:
        names = ("means", "quats", "scales", "opacities", "sh")
        changed = Gaussians(*(FORMS[form](getattr(plain, name)) for name in names))
    found = raster.render_channels(raster.project(changed, CAMERA, backend="native"), values)
    assert torch.equal(found[0], raster.render_channels(a_view(), values)[0])


def test_labels_below_zero_are_no_region_and_those_beyond_32_bits_are_refused():
    labels, projection = random_labels(3, 30, 40, 5, 0).long(), a_view()
    found = raster.region_sums(projection, torch.where(labels >= 0, labels, -(2**32)))
    assert_same_sums(found, raster.region_sums(projection, labels))
    for offset in (2**31, 2**32, 2**40):
        with refuses():
            raster.region_sums(projection, torch.where(labels >= 0, labels + offset, -1))


# What the user's machine decides must not decide the answer: number of threads, instruction set.


LEVELS, REGIONS = 3, 15


def _resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.skipif(
    not Path("/proc/self/statm").exists(), reason="the system does not say what a process has"
)
def test_memory_of_views_is_given_back():
    def project():
        return raster.project(raster.prepare_gaussians(gaussians, "native"), make_camera(640, 480), "inria")

    gaussians = random_gaussians(6000, seed=1).select(torch.arange(600_000) % 6000)
    project()  # 38 MB of projected Gaussians, kept for the next view: malloc returns blocks above 32 MB at once
    before = _resident_bytes()
    with required_core() as core:
        core.release_memory()
    assert _resident_bytes() < before - 20e6
    assert project().n_gaussians == 600_000  # and taken anew


def everything(projection, count: int, labels) -> dict:
    """Every function's answer for a view of ``count`` Gaussians, from the same random inputs each time."""
    generator = torch.Generator().manual_seed(5)
    values = torch.randn(count, 11, generator=generator)
    indices = torch.randint(48, (count, LEVELS, 5), generator=generator, dtype=torch.uint8)
    weights = torch.rand(count, LEVELS, 5, generator=generator)
    codebook = torch.randn(LEVELS, 48, 512, generator=generator) + 0.3
    queries = unit(torch.randn(6, 512, generator=generator))
    image, alpha = raster.render_channels(projection, values)
    return {
        "channels": image,
        "alpha": alpha,
        "codes": raster.render_codes(projection, indices, weights, 48),
        "cosines": raster.render_cosines(projection, indices, weights, codebook, queries),
        "regions": raster.region_sums(projection, labels),
    }


@pytest.mark.parametrize(("number", "kind"), [*enumerate(HARD_KINDS)])
def test_every_instruction_set_agrees_with_the_reference(instruction_set, number, kind):
    with required_core() as core:
        assert core.current_isa() == instruction_set
    preset, scene = ("inria", "gsplat")[number % 2], hard_scene(kind, 11)
    count, views = len(scene[0]), both(*scene, preset)
    values = torch.randn(count, 11, generator=torch.Generator().manual_seed(5))
    assert_channels_agree(views, scene, preset, values)
    labels = labels_at(scene, preset, LEVELS, REGIONS, 0)
    found, expected = (raster.region_sums(view, labels) for view in views)
    assert_same_sums(found, expected)
    indices, weights, *vectors = random_codes(count, LEVELS, 5, 48, number)
    codes = indices, weights.half() if number < 2 else weights, *vectors
    assert_codes_agree(views, sure_pixels(*scene, preset), codes)


def on_any_threads(gaussians: Gaussians, camera: Camera, function, *arguments) -> list:
    """Return the function's answers for the projected scene, by number of threads."""
    found = []
    for threads in (1, 2, 3, 5):
        with threads_of_torch(threads):
            projection = raster.project(gaussians, camera, backend="native")
            found.append(function(projection, *arguments))
    return found


def test_same_bytes_on_any_number_of_threads():
    """Enough Gaussians, ties in depth among them, that every stage is shared out."""
    gaussians = random_gaussians(60_000, 8, ("plain", "needle", "tiny", "huge", "nan"))
    gaussians.scales.mul_(0.2)
    gaussians.opacities.mul_(0.1)
    gaussians.means[::3] = gaussians.means[:20_000]
    camera = make_camera(230, 190, 150.0, 2)
    labels = random_labels(LEVELS, 190, 230, REGIONS, 1)
    found = on_any_threads(gaussians, camera, everything, len(gaussians), labels)
    assert found[0]["alpha"].max() > 0.99
    for answers in found[1:]:
        assert same_bytes(answers.pop("regions"), found[0]["regions"])
        assert all(torch.equal(answer, found[0][name]) for name, answer in answers.items())


def test_cosines_of_a_large_codebook_do_not_depend_on_threads():
    """Its Gram matrices are products large enough to be shared out among threads."""
    gaussians, camera = random_gaussians(300, 8), make_camera(40, 30)
    generator = torch.Generator().manual_seed(0)
    indices = torch.randint(1024, (300, 2, 4), generator=generator).to(torch.uint16)
    weights = torch.rand(300, 2, 4, generator=generator)
    codebook = torch.randn(2, 1024, 512, generator=generator)
    queries = unit(torch.randn(40, 512, generator=generator))
    found = on_any_threads(gaussians, camera, raster.render_cosines, indices, weights, codebook, queries)
    assert all(torch.equal(cosines, found[0]) for cosines in found)
