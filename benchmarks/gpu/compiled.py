"""Kernels compiled for a GPU that is not there, and what they take of it."""

from __future__ import annotations

import re
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.gpu.timing import Unavailable

THREADS = 32  # of a warp
PARTS = 4  # of a multiprocessor, each with registers of its own
REGISTERS = 65536  # of a multiprocessor
REGISTER_UNIT, SHARED_UNIT = 256, 128  # in which registers are given to a warp, and bytes to a block
RESERVED = 1 << 10  # bytes of shared memory of each block that are not the kernel's


@dataclass(frozen=True)
class Device:
    """Of a multiprocessor: bytes of shared memory, warps, blocks."""

    shared: int
    warps: int
    blocks: int


# CUDA programming guide, technical specifications by compute capability.
DEVICES = {
    80: Device(164 << 10, 64, 32),
    86: Device(100 << 10, 48, 16),
    89: Device(100 << 10, 48, 24),
    90: Device(228 << 10, 64, 32),
}


@dataclass(frozen=True)
class Usage:
    """Of one thread: registers, and bytes of stack and local memory, where what does not fit spills to. Of a block:
    bytes of shared memory.
    """

    registers: int
    spilled: int
    shared: int

    def blocks(self, warps: int, device: Device) -> int:
        """How many blocks of so many warps a multiprocessor holds at once; 0 where not even one can run."""
        of_warp = _up(self.registers * THREADS, REGISTER_UNIT)
        shared = _up(self.shared + RESERVED, SHARED_UNIT)
        by_registers = REGISTERS // PARTS // of_warp * PARTS // warps
        return min(by_registers, device.shared // shared, device.warps // warps, device.blocks)


def compile_kernel(
    kernel: Any, types: dict[str, str], constants: dict[str, Any], warps: int, capability: int
) -> tuple[bytes, int]:
    """Compile for an NVIDIA GPU as a launch would: tensors begin where torch puts them, at multiples of 16 bytes.

    Args:
        kernel: the ``triton.jit`` function.
        types: of each argument that is no constant.
        constants: values of the others.
        warps: of a block.
        capability: 80 for an A100, 90 for an H100.

    Returns:
        The binary, and bytes of shared memory that a block takes.
    """
    import triton
    from triton.backends.compiler import GPUTarget
    from triton.compiler import ASTSource

    given, asked = {*types, *constants}, set(kernel.arg_names)
    if given != asked:
        raise ValueError(f"launches.py and the kernel disagree about {', '.join(sorted(given ^ asked))}")
    signature = {name: types.get(name, "constexpr") for name in kernel.arg_names}
    aligned = {
        (place,): [["tt.divisibility", 16]]
        for place, name in enumerate(kernel.arg_names)
        if signature[name].startswith("*")
    }
    compiled = triton.compile(
        ASTSource(kernel, signature, constants, aligned),
        target=GPUTarget("cuda", capability, THREADS),
        options={"num_warps": warps, "enable_fp_fusion": True},
    )
    return compiled.asm["cubin"], compiled.metadata.shared


def tool(name: str) -> Path:
    """``nvdisasm`` or ``cuobjdump``, which come with triton.

    Raises:
        Unavailable: this triton comes without.
    """
    import triton

    path = Path(triton.__file__).parent / "backends" / "nvidia" / "bin" / name
    if not path.exists():
        raise Unavailable(f"this triton comes without {name}")
    return path


def disassemble(binary: Path) -> str:
    """The text of ``nvdisasm -c``."""
    return _run(str(tool("nvdisasm")), "-c", str(binary))


def resources(binary: Path) -> dict[str, tuple[int, int]]:
    """Of each function: registers, and bytes of stack and local memory, of a thread."""
    text = _run(str(tool("cuobjdump")), "-res-usage", str(binary))
    found = re.findall(r"Function (\S+?):\s+REG:(\d+) STACK:(\d+) .*?LOCAL:(\d+)", text, re.DOTALL)
    return {name: (int(registers), int(stack) + int(local)) for name, registers, stack, local in found}


def _run(*command: str) -> str:
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def _up(value: int, unit: int) -> int:
    return -(-value // unit) * unit
