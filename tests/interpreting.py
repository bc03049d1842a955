"""Triton kernels interpreted on the CPU, in a process of its own."""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context

import torch


@contextmanager
def interpreter() -> Iterator[ProcessPoolExecutor]:
    """A process that interprets all kernels."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=interpret_kernels) as worker:
        yield worker


def interpret_kernels() -> None:
    """Triton looks at this when it is first imported, and never again: a process interprets all kernels or none."""
    os.environ["TRITON_INTERPRET"] = "1"
    torch.set_num_threads(1)
