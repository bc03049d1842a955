"""Triton kernels compiled for a GPU that is not there, and what they take of it."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from children import finished
from machine_code import unwritten

_WARP = 32


@dataclass(frozen=True)
class Usage:
    """What a compiled kernel takes.

    Attributes:
        registers: of a thread.
        spilled: bytes of stack and local memory of a thread, where what does not fit into registers goes.
        shared: bytes of shared memory of a block.
        unwritten: uniform registers that are read before they are written, a bug of the compiler.
    """

    registers: int
    spilled: int
    shared: int
    unwritten: list[str]


def compile_kernel(
    kernel: Any, types: dict[str, str], constants: dict[str, Any], warps: int, capability: int, folder: Path
) -> Usage:
    """Compile for an NVIDIA GPU as a launch would; torch's tensors begin at multiples of 16 bytes.

    Args:
        kernel: the ``triton.jit`` function.
        types: of each argument that is no constant.
        constants: values of the others.
        warps: of a block.
        capability: 80 for an A100, 90 for an H100.
        folder: where the binary is written.
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
        target=GPUTarget("cuda", capability, _WARP),
        options={"num_warps": warps, "enable_fp_fusion": True},
    )
    binary = folder / "kernel.cubin"
    binary.write_bytes(compiled.asm["cubin"])
    registers, spilled = _resources(binary)
    code = unwritten(_cuobjdump("--dump-sass", binary))
    return Usage(registers, spilled, compiled.metadata.shared, code)


def _cuobjdump(option: str, binary: Path) -> str:
    import triton

    tool = Path(triton.__file__).parent / "backends" / "nvidia" / "bin" / "cuobjdump"
    if not tool.exists():
        pytest.skip("compiled; this triton comes without cuobjdump, which reports what spills")
    return finished([tool, option, binary], check=True).stdout


def _resources(binary: Path) -> tuple[int, int]:
    """Registers, and bytes of stack and local memory, of a thread."""
    printed = _cuobjdump("-res-usage", binary)
    found = re.search(r"REG:(\d+) STACK:(\d+) .*?LOCAL:(\d+)", printed, re.DOTALL)
    assert found is not None, printed
    registers, stack, local = map(int, found.groups())
    return registers, stack + local
