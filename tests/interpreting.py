"""Triton kernels interpreted on the CPU."""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch

from children import workers


def interpret_kernels() -> None:
    """Triton reads the setting when it is first imported: a process interprets all kernels or none."""
    os.environ["TRITON_INTERPRET"] = "1"
    torch.set_num_threads(1)
    from triton.runtime.interpreter import ScanOps

    setattr(ScanOps, "generic_scan", _scan_whole_slices)  # noqa: B010 - of the same form


@contextmanager
def interpreter() -> Iterator[ProcessPoolExecutor]:
    """A process that interprets all kernels."""
    with workers(1, interpret_kernels) as worker:
        yield worker


def _scan_whole_slices(scan: Any, tensors: list[Any]) -> list[Any]:
    """An associative scan along an axis, which the interpreter does number by number in minutes."""
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
