"""What the user's machine decides must not decide the answer: number of threads, instruction set."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
import torch

from raster.hard_scenes import HARD_KINDS, hard_scene
from raster.parity import assert_close, assert_same_sums, both, needs_native, same_bytes, sure_pixels
from scoup import raster
from scoup.base import required_core
from support import make_camera, random_gaussians, random_labels, threads_of_torch, unit

pytestmark = needs_native
LEVELS, ATOMS, REGIONS = 3, 48, 15


def _resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.skipif(
    not Path("/proc/self/statm").exists(), reason="the system does not say what a process has"
)
def test_memory_of_views_is_given_back():
    def project():
        return raster.project(raster.prepare_gaussians(gaussians, "native"), make_camera(640, 480), "inria")

    gaussians = random_gaussians(600_000, seed=1)
    project()  # 38 MB of projected Gaussians, kept for the next view: malloc returns blocks above 32 MB at once
    before = _resident_bytes()
    with required_core() as core:
        core.release_memory()
    assert _resident_bytes() < before - 20e6
    assert project().n_gaussians == 600_000  # and taken anew


def everything(projection, count: int, labels, dim: int = 24, dtype: torch.dtype = torch.float32) -> dict:
    """Every function's answer for a view of ``count`` Gaussians, from the same random inputs each time."""
    generator = torch.Generator().manual_seed(5)
    values = torch.randn(count, 11, generator=generator)
    indices = torch.randint(ATOMS, (count, LEVELS, 5), generator=generator, dtype=torch.uint8)
    weights = torch.rand(count, LEVELS, 5, generator=generator).to(dtype)
    codebook = torch.randn(LEVELS, ATOMS, dim, generator=generator) + 0.3
    queries = unit(torch.randn(6, dim, generator=generator))
    image, alpha = raster.render_channels(projection, values)
    return {
        "channels": image,
        "alpha": alpha,
        "codes": raster.render_codes(projection, indices, weights, ATOMS).movedim(0, 2),
        "cosines": raster.render_cosines(projection, indices, weights, codebook, queries).permute(2, 3, 0, 1),
        "regions": raster.region_sums(projection, labels),
    }


@pytest.mark.parametrize("kind", HARD_KINDS)
@pytest.mark.parametrize("preset", ["inria", "gsplat"])
def test_every_instruction_set_agrees_with_the_reference(instruction_set, kind, preset):
    with required_core() as core:
        assert core.current_isa() == instruction_set
    gaussians, camera = hard_scene(kind, 11)
    sure = sure_pixels(gaussians, camera, preset)
    labels = random_labels(LEVELS, camera.height, camera.width, REGIONS, 0)
    labels[:, ~sure] = -1
    dtype = torch.float16 if kind in ("crowd", "needles") else torch.float32
    native, reference = (
        everything(v, len(gaussians), labels, 24, dtype) for v in both(gaussians, camera, preset)
    )
    assert_close(native["channels"], reference["channels"], 6.0, sure)
    assert_close(native["alpha"], reference["alpha"], 1.0, sure)
    assert_close(native["codes"], reference["codes"], 2.0, sure)
    assert_close(native["cosines"], reference["cosines"], 5.0, sure)
    assert_same_sums(native["regions"], reference["regions"])


def test_same_bytes_on_any_number_of_threads():
    """Enough Gaussians, ties in depth among them, that every stage is shared out."""
    gaussians = random_gaussians(60_000, 8, ("plain", "needle", "tiny", "huge", "nan"))
    gaussians.scales.mul_(0.2)
    gaussians.opacities.mul_(0.1)
    gaussians.means[::3] = gaussians.means[:20_000]
    camera = make_camera(230, 190, 150.0, 2)
    labels = random_labels(LEVELS, 190, 230, REGIONS, 1)
    found = []
    for threads in (1, 2, 3, 5):
        with threads_of_torch(threads):
            projection = raster.project(gaussians, camera, backend="native")
            found.append(everything(projection, len(gaussians), labels, 512))
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
    found = []
    for threads in (1, 2, 3, 5):
        with threads_of_torch(threads):
            projection = raster.project(gaussians, camera, backend="native")
            found.append(raster.render_cosines(projection, indices, weights, codebook, queries))
    assert all(torch.equal(cosines, found[0]) for cosines in found)
