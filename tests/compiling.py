"""Compiling Triton kernels for a GPU that is not there, and what they take of it."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.gpu import compiled
from benchmarks.gpu.compiled import Usage
from benchmarks.gpu.launches import F32, I32, I64
from benchmarks.gpu.timing import Unavailable

__all__ = ["F32", "I32", "I64", "Usage", "compile_kernel"]


def compile_kernel(
    kernel: Any, types: dict[str, str], constants: dict[str, Any], warps: int, capability: int, folder: Path
) -> Usage:
    """``compiled.compile_kernel``, and what the kernel takes; the binary is written into ``folder``."""
    content, shared = compiled.compile_kernel(kernel, types, constants, warps, capability)
    binary = folder / "kernel.cubin"
    binary.write_bytes(content)
    try:
        (needs,) = compiled.resources(binary).values()
    except Unavailable as missing:
        pytest.skip(f"compiled; {missing}, which tells what spills")
    return Usage(*needs, shared)
