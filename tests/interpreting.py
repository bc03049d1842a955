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
    # Memory that nothing has written holds the largest numbers, as that of a GPU may.
    torch.use_deterministic_algorithms(True)
    from triton.runtime import interpreter as of_triton

    setattr(of_triton.ScanOps, "generic_scan", _scan_whole_slices)  # noqa: B010 - of the same form
    _guard_memory(of_triton)


def _guard_memory(of_triton: Any) -> None:
    """Make kernels fail that touch memory outside the tensors they are given, which on a GPU is an illegal access."""
    executor, builder = of_triton.GridExecutor, of_triton.interpreter_builder
    copy_arguments, load, store = (
        executor._init_args_hst, builder.create_masked_load, builder.create_masked_store,
    )  # fmt: skip
    bounds = np.zeros((2, 0), np.uint64)  # first and last byte of each tensor's memory, rising

    def copied(self: Any, arguments: Any, keywords: Any) -> Any:
        nonlocal bounds
        found = copy_arguments(self, arguments, keywords)
        tensors = [each for each in (*found[0], *found[1].values()) if isinstance(each, torch.Tensor)]
        storages = [each.untyped_storage() for each in tensors]
        ranges = {(each.data_ptr(), each.data_ptr() + each.nbytes()) for each in storages if each.nbytes()}
        bounds = np.array(sorted(ranges), np.uint64).reshape(-1, 2).T
        return found

    def check(pointers: Any, mask: Any) -> None:
        size = max(1, pointers.get_element_ty().primitive_bitwidth // 8)
        first = np.broadcast_to(pointers.data, mask.data.shape)[mask.data]
        own = np.searchsorted(bounds[0], first, side="right").astype(np.int64) - 1
        if (own < 0).any() or (first + np.uint64(size) > bounds[1][own]).any():
            raise IndexError("a kernel touches memory outside its tensors")

    def guarded_load(pointers: Any, mask: Any, *rest: Any) -> Any:
        check(pointers, mask)
        return load(pointers, mask, *rest)

    def guarded_store(pointers: Any, value: Any, mask: Any, *rest: Any) -> Any:
        check(pointers, mask)
        return store(pointers, value, mask, *rest)

    executor._init_args_hst = copied
    builder.create_masked_load, builder.create_masked_store = guarded_load, guarded_store


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
