"""Triton kernels interpreted on the CPU, in a process of its own."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context

from benchmarks.gpu.interpreting import interpret_kernels


@contextmanager
def interpreter() -> Iterator[ProcessPoolExecutor]:
    """A process that interprets all kernels."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=interpret_kernels) as worker:
        yield worker
