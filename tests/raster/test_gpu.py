"""The rasteriser's kernels on a GPU; ``test_triton.py`` interprets and compiles them without one."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch

from raster import gpu_checks
from raster.gpu_checks import KINDS_OF_SCENES
from scoup.scene import float32_products

if not torch.cuda.is_available():
    pytest.skip("needs a CUDA device", allow_module_level=True)


@pytest.mark.parametrize("check", gpu_checks.SMALL_CHECKS)
def test_small_things_on_a_gpu(check: Callable[[str], None]) -> None:
    check("cuda")


# What is asked of the same scenes is asked in tests of its own: one that fails hides no other.
scenes_on_a_gpu = pytest.mark.parametrize("kind", KINDS_OF_SCENES)
seeds_on_a_gpu = pytest.mark.parametrize("seed", [0, 1, 2], ids="seed{}".format)


@scenes_on_a_gpu
@seeds_on_a_gpu
def test_channels_on_a_gpu(kind: str, seed: int) -> None:
    for preset in ("inria", "gsplat"):
        for channels in (0, 1, 3, 64, 130):
            gpu_checks.check_channels(kind, seed, preset, channels, "cuda")


@scenes_on_a_gpu
@seeds_on_a_gpu
def test_region_sums_on_a_gpu(kind: str, seed: int) -> None:
    for levels, n_regions in ((1, 3), (3, 40), (8, 5), (2, 10**6)):
        gpu_checks.check_regions(kind, seed, levels, n_regions, "cuda")


@scenes_on_a_gpu
@seeds_on_a_gpu
@pytest.mark.parametrize("halves", [True, False], ids=["float16", "float32"])
@pytest.mark.parametrize(
    ("levels", "n_atoms", "k"), [(1, 1, 1), (3, 64, 4), (3, 128, 4), (8, 20, 2), (2, 256, 16), (1, 1024, 4)]
)
def test_codes_on_a_gpu(kind: str, seed: int, levels: int, n_atoms: int, k: int, halves: bool) -> None:
    gpu_checks.check_codes(kind, seed, levels, n_atoms, k, halves, "cuda")


def test_a_build_on_a_gpu() -> None:
    for rounds in (1, 2):
        gpu_checks.check_build(rounds, "cuda")


def test_products_have_all_bits_of_float32_whatever_the_user_allows() -> None:
    rows, others = torch.rand(2, 300, 512, generator=torch.Generator().manual_seed(0))
    before = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision("medium")
    try:
        found = float32_products(rows.cuda(), others.cuda()).cpu()
    finally:
        torch.set_float32_matmul_precision(before)
    assert torch.allclose(found, (rows.double() @ others.double().T).float(), rtol=1e-6, atol=0)
