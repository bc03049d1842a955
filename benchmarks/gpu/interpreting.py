"""Triton kernels interpreted on the CPU: fast enough to be tested, with products as tensor cores make them."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

_TF32 = np.uint32(0xFFFFE000)  # sign, exponent and the 10 leading bits of the fraction


def interpret_kernels() -> None:
    """Triton looks at this when it is first imported, and never again: a process interprets all kernels or none."""
    os.environ["TRITON_INTERPRET"] = "1"
    torch.set_num_threads(1)
    from triton.runtime.interpreter import InterpreterBuilder, ScanOps

    exact = InterpreterBuilder.create_dot

    def create_dot(builder: Any, a: Any, b: Any, d: Any, input_precision: Any, most: int) -> Any:
        found = exact(builder, a, b, d, input_precision, most)
        if found.data.dtype == np.float32 and a.data.dtype == np.float32:
            found.data = d.data + product(a.data, b.data, str(input_precision).rsplit(".", 1)[-1])
        return found

    setattr(ScanOps, "generic_scan", scan_whole_slices)  # noqa: B010 - of the same form
    setattr(InterpreterBuilder, "create_dot", create_dot)  # noqa: B010


def scan_whole_slices(scan: Any, tensors: list[Any]) -> list[Any]:
    """What the interpreter does number by number, which takes minutes: an associative scan along an axis."""
    arrays = [np.moveaxis(tensor.handle.data, scan.axis, 0) for tensor in tensors]
    results = [np.empty_like(array) for array in arrays]
    for place in range(len(arrays[0])):
        found = tuple(scan.to_tensor(a[place], t.dtype) for a, t in zip(arrays, tensors, strict=True))
        if place:
            before = (scan.to_tensor(r[place - 1], t.dtype) for r, t in zip(results, tensors, strict=True))
            found = scan.combine_fn.fn(*before, *found)
            found = found if isinstance(found, tuple) else (found,)
        for result, tensor in zip(results, found, strict=True):
            result[place] = tensor.handle.data
    whole = (np.ascontiguousarray(np.moveaxis(result, 0, scan.axis)) for result in results)
    return [scan.to_tensor(array, tensor.dtype) for array, tensor in zip(whole, tensors, strict=True)]


def product(a: NDArray[np.float32], b: NDArray[np.float32], precision: str) -> NDArray[np.float32]:
    """a [M, K] @ b [K, N] of float32, which the interpreter multiplies as they are whatever it is asked. Tensor cores
    leave the 13 last bits of each number for "TF32" unread; "TF32x3" splits a number into two such ones.
    """
    if precision not in ("TF32", "TF32x3"):
        return np.matmul(a, b)
    high_a, high_b = truncated(a), truncated(b)
    if precision == "TF32":
        return np.matmul(high_a, high_b)
    low_a, low_b = truncated(a - high_a), truncated(b - high_b)
    return np.matmul(high_a, low_b) + np.matmul(low_a, high_b) + np.matmul(high_a, high_b)


def truncated(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """float32 without the bits that tf32 does not have."""
    return (np.ascontiguousarray(values).view(np.uint32) & _TF32).view(np.float32)
