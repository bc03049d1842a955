"""The paper's per-pixel scatter against the reference: interpreted, compiled, and where there is a GPU, run on it."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from compiling import compile_kernel
from interpreting import interpreter
from launches import F32, I32, I64
from raster.gpu_checks import projections_of, scene_of
from raster.parity import assert_close, sure_pixels
from scoup import raster
from scoup.scene.codes import SparseCodes
from support import random_labels

on_a_gpu = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")


def check_scatter(kind: str, levels: int, n_atoms: int, k: int, device: str) -> None:
    from benchmarks.scatter_kernel import scatter_view

    gaussians, camera = scene_of(kind, 3, device == "cpu")
    projection, reference = projections_of(gaussians, camera, "inria", device)
    generator = torch.Generator().manual_seed(3)
    labels = random_labels(levels, camera.height, camera.width, 7, 3)
    labels[:, ~sure_pixels(gaussians, camera)] = -1
    codes = [SparseCodes.from_dense(torch.rand(7, n_atoms, generator=generator), k) for _ in range(levels)]
    expected = torch.rand(len(gaussians), levels, n_atoms, generator=generator)
    found = expected.to(device, copy=True)
    sums = raster.region_sums(reference, labels)
    for level, own in enumerate(codes):
        gaussian, region, weight = sums.triplets(level)
        expected[:, level].index_add_(0, gaussian, weight[:, None] * own.to_dense()[region])
    before = found.clone()
    assert scatter_view(projection, labels.to(device), codes, found) is found
    assert not torch.equal(found, before), "nothing was added: proves little"
    assert_close(found.cpu(), expected, 3.0)


QUICK = ("needles", 1, 5, 1)
CASES = [("mixed", 3, 40, 4), QUICK, ("giants", 2, 300, 9)]


@pytest.mark.parametrize(
    "case", [QUICK, *(pytest.param(case, marks=pytest.mark.slow) for case in CASES if case != QUICK)]
)
def test_agrees_with_the_reference(needs_triton: None, case: tuple[str, int, int, int]) -> None:
    with interpreter() as worker:
        worker.submit(check_scatter, *case, "cpu").result()


@on_a_gpu
@pytest.mark.parametrize("case", CASES)
def test_agrees_with_the_reference_on_a_gpu(case: tuple[str, int, int, int]) -> None:
    check_scatter(*case, "cuda")


@pytest.mark.parametrize("capability", [80, 90])
def test_compiles_without_spilling(needs_triton: None, tmp_path: Path, capability: int) -> None:
    from benchmarks.scatter_kernel import scatter_kernel

    types = {
        "records": F32, "numbers": I32, "starts": I64, "labels": I32, "first_rows": I64,
        "atoms": I32, "weights": F32, "out": F32, "alpha_max": "fp32", "stop": "fp32",
        **dict.fromkeys(("width", "height", "across", "n_levels", "n_atoms"), "i32"),
    }  # fmt: skip
    constants = {"STOP_INCLUSIVE": False, "TILE": 8, "CHUNK": 16, "K": 4}
    usage = compile_kernel(scatter_kernel, types, constants, 2, capability, tmp_path)
    assert usage.spilled == 0, usage
