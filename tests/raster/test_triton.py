"""The rasteriser's kernels for GPUs: interpreted on the CPU, and compiled without a GPU."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from children import finished
from compiling import compile_kernel
from launches import launches
from machine_code import unwritten
from messages import refuses
from raster import gpu_checks
from raster.gpu_checks import KINDS_OF_SCENES
from scoup import raster
from support import examples, make_camera, random_gaussians, scenes

MOST_SHARED = 99 << 10  # bytes a block may have on the smallest of the GPUs served


def every_third(first: int) -> list[Any]:
    """The kinds of scenes by number, each once in turn with what is asked of it: the interpreter is slow. The others
    are left to `make test-all`.
    """
    return [
        pytest.param(number, kind, marks=[] if number % 3 == first else pytest.mark.slow)
        for number, kind in enumerate(KINDS_OF_SCENES)
    ]


@pytest.mark.parametrize(("number", "kind"), every_third(0))
def test_channels_agree_with_the_reference(interpreted, number, kind):
    preset, channels = ("inria", "gsplat")[number % 2], (1, 3, 17, 0, 70)[number % 5]
    interpreted(gpu_checks.check_channels, kind, number, preset, channels)


@pytest.mark.parametrize(("number", "kind"), every_third(1))
def test_region_sums_agree_with_the_reference(interpreted, number, kind):
    levels, n_regions = ((3, 6), (1, 40), (8, 3), (2, 10**6))[number % 4]
    interpreted(gpu_checks.check_regions, kind, 3, levels, n_regions)


@pytest.mark.slow
@settings(max_examples=examples(12))
@given(
    scene=scenes(25),
    seed=st.integers(0, 2**31),
    levels=st.integers(1, 5),
    n_regions=st.sampled_from([1, 4, 10**6]),
)
def test_region_sums_of_any_scene(interpreted, scene, seed, levels, n_regions):
    interpreted(gpu_checks.check_regions_of, *scene, seed, levels, n_regions)


@pytest.mark.parametrize("check", gpu_checks.SMALL_CHECKS)
def test_small_checks(interpreted, check):
    interpreted(check)


@pytest.mark.parametrize(("kind", "levels", "n_atoms", "k", "halves"), [
    pytest.param("mixed", 3, 64, 4, True, marks=pytest.mark.slow),
    pytest.param("equal depths", 1, 128, 2, True, marks=pytest.mark.slow),
    pytest.param("needles", 5, 20, 4, False, marks=pytest.mark.slow), ("off centre", 1, 200, 4, True),
    ("near", 1, 300, 1, False), ("empty", 2, 16, 4, True), ("one pixel", 4, 1, 3, True),
])  # fmt: skip
def test_codes_agree_with_the_reference(interpreted, kind, levels, n_atoms, k, halves):
    interpreted(gpu_checks.check_codes, kind, 7, levels, n_atoms, k, halves)


def test_a_build_agrees_with_the_reference(interpreted):
    interpreted(gpu_checks.check_build, 2)


@pytest.mark.parametrize(("capability", "names"), [
    (90, ("codes 3 x 64", "region sums")), pytest.param(80, None, marks=pytest.mark.slow, id="80-all"),
    pytest.param(90, None, marks=pytest.mark.slow, id="90-all"),
])  # fmt: skip
def test_kernels_compile_within_a_gpu(
    needs_triton: None, tmp_path: Path, capability: int, names: tuple[str, ...] | None
) -> None:
    for name in names or launches():
        launch = launches()[name]
        shared, unwritten_registers = compile_kernel(*launch, capability, tmp_path)
        assert shared <= MOST_SHARED, name
        assert not unwritten_registers, name


def test_registers_that_are_read_before_they_are_written_are_found() -> None:
    code = """
        /*0000*/                   ULDC.64 UR4, c[0x0][0x208] ;
        /*0010*/                   UIADD3 UR14, UP0, UR14, 0x20, URZ ;
        /*0020*/               @P0 BRA 0x50 ;
        /*0030*/                   UMOV UR22, 0x10 ;
        /*0040*/              @!P1 UMOV UR9, 0x1 ;
        /*0050*/                   UMOV UR23, URZ ;
        /*0060*/                   HGMMA.64x16x16.F32 R24, R64, gdesc[UR20].tnspB, R24 ;
        /*0070*/                   LDG.E R2, desc[UR4][R2.64] ;
        /*0080*/                   IMAD R3, R2, UR9, RZ ;
        /*0090*/                   EXIT ;
        /*00a0*/                   UMOV UR30, UR31 ;
    """
    assert unwritten(code) == ["UR9", "UR14", "UR22"]


def test_triton_is_not_imported_for_a_cpu(preloaded_python: str) -> None:
    program = (
        "import sys, torch, scoup; from scoup import raster; from scoup.scene.gaussians import Gaussians; "
        "from scoup.scene.cameras import Camera; "
        "g = Gaussians(torch.rand(3, 3) + 2, torch.rand(3, 4), torch.rand(3, 3), torch.rand(3), torch.rand(3, 1, 3)); "
        "K = torch.tensor([[9., 0, 4], [0, 9, 4], [0, 0, 1]]).double(); "
        "raster.render_channels(raster.project(g, Camera('a', torch.eye(4).double(), K, 8, 8)), torch.rand(3, 2)); "
        "scoup.fit_codes(torch.rand(30, 8), 4, 2, solver='exact').encode(torch.rand(3, 8)); "
        "found = {'triton', 'scoup.raster.triton.rendering'} & set(sys.modules); "
        "sys.exit(bool(found))"
    )
    finished([preloaded_python, "-c", program], check=True)


def test_tensors_on_a_cpu_are_refused() -> None:
    with refuses():
        raster.project(random_gaussians(3, 0), make_camera(), backend="triton")


def test_products_on_gpus_of_amd(needs_triton: None, monkeypatch: pytest.MonkeyPatch) -> None:
    from scoup.raster.triton.projection import product_precision
    from scoup.raster.triton.rendering import most_atoms_of_products

    assert [product_precision(wide) for wide in (False, True)] == ["fp16x3", "tf32x3"]
    assert [most_atoms_of_products(name) for name in ("fp16x3", "tf32x3", "ieee")] == [128, 128, 64]
    monkeypatch.setattr(torch.version, "hip", "6.4")
    assert [product_precision(wide) for wide in (False, True)] == ["fp16x3", "ieee"]
    assert [most_atoms_of_products(name) for name in ("fp16x3", "ieee")] == [128, 64]


def test_kernels_with_float32_compile_for_amd(needs_triton: None) -> None:
    import triton
    from triton.backends.compiler import GPUTarget
    from triton.compiler import ASTSource

    from scoup.raster.triton.projection import FUSED

    for name, changes in (("3 channels", {"PRECISION": "ieee"}), ("region sums", {}), ("codes 3 x 64", {})):
        kernel, types, constants, warps = launches()[name]
        signature = {argument: types.get(argument, "constexpr") for argument in kernel.arg_names}
        source = ASTSource(kernel, signature, {**constants, **changes})
        compiled = triton.compile(
            source, target=GPUTarget("hip", "gfx942", 64), options={"num_warps": warps, **FUSED}
        )
        assert compiled.metadata.shared <= 64 << 10, name
