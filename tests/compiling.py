"""Triton kernels compiled for a GPU that is not there."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from children import finished
from machine_code import unwritten


def compile_kernel(
    kernel: Any, types: dict[str, str], constants: dict[str, Any], warps: int, capability: int, folder: Path
) -> tuple[int, list[str]]:
    """Compile for an NVIDIA GPU as a launch would; torch's tensors begin at multiples of 16 bytes.

    Args:
        kernel: the ``triton.jit`` function.
        types: of each argument that is no constant.
        constants: values of the others.
        warps: of a block.
        capability: 80 for an A100, 90 for an H100.
        folder: where the binary is written.

    Returns:
        bytes of shared memory of a block, and the uniform registers that are read before they are written, a bug of
        the compiler.
    """
    import triton
    from triton.backends.compiler import GPUTarget
    from triton.compiler import ASTSource

    given, expected = {*types, *constants}, set(kernel.arg_names)
    assert given == expected, f"types and constants do not fit the kernel: {sorted(given ^ expected)}"
    signature = {name: types.get(name, "constexpr") for name in kernel.arg_names}
    aligned = {
        (place,): [["tt.divisibility", 16]]
        for place, name in enumerate(kernel.arg_names)
        if signature[name].startswith("*")
    }
    compiled = triton.compile(
        ASTSource(kernel, signature, constants, aligned),
        target=GPUTarget("cuda", capability, 32),
        options={"num_warps": warps, "enable_fp_fusion": True},
    )
    tool = Path(triton.__file__).parent / "backends" / "nvidia" / "bin" / "cuobjdump"
    if not tool.exists():
        pytest.skip("compiled; this triton comes without cuobjdump, which shows the machine code")
    binary = folder / "kernel.cubin"
    binary.write_bytes(compiled.asm["cubin"])
    code = finished([tool, "--dump-sass", binary], check=True).stdout
    return compiled.metadata.shared, unwritten(code)
