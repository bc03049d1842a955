"""Compiling Triton kernels for a GPU that is not there, and what they take of it."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path
from typing import Any, NamedTuple

import pytest

F32, I32, I64, HALF, U8, I8, I16, DOUBLE = "*fp32", "*i32", "*i64", "*fp16", "*u8", "*i8", "*i16", "*fp64"


class Usage(NamedTuple):
    """Of one thread: registers, and bytes of stack and local memory, where what does not fit spills to. Of a block:
    bytes of shared memory.
    """

    registers: int
    spilled: int
    shared: int


def compile_kernel(
    kernel: Any, types: dict[str, str], constants: dict[str, Any], warps: int, capability: int, folder: Path
) -> Usage:
    """Compile for an NVIDIA GPU of this compute capability.

    Args:
        kernel: the ``triton.jit`` function.
        types: of each argument that is no constant.
        constants: values of the others.
        warps: of a block.
        capability: 80 for an A100, 90 for an H100.
        folder: for the binary.
    """
    import triton
    from triton.backends.compiler import GPUTarget
    from triton.compiler import ASTSource

    signature = {name: types.get(name, "constexpr") for name in kernel.arg_names}
    assert set(kernel.arg_names) == {*types, *constants}, {*kernel.arg_names} ^ {*types, *constants}
    source = ASTSource(kernel, signature, constants)
    compiled = triton.compile(
        source,
        target=GPUTarget("cuda", capability, 32),
        options={"num_warps": warps, "enable_fp_fusion": True},
    )
    binary = folder / "kernel.cubin"
    binary.write_bytes(compiled.asm["cubin"])
    tool = Path(triton.__file__).parent / "backends" / "nvidia" / "bin" / "cuobjdump"
    if not tool.exists():
        pytest.skip("compiled; this triton comes without cuobjdump, which tells what spills")
    usage = subprocess.run(
        [str(tool), "-res-usage", str(binary)], capture_output=True, text=True, check=True
    ).stdout
    found = re.search(r"REG:(\d+) STACK:(\d+) .*?LOCAL:(\d+)", usage, re.DOTALL)
    assert found, usage
    registers, stack, local = map(int, found.groups())
    return Usage(registers, stack + local, compiled.metadata.shared)
