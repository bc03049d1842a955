"""Functions of one tensor that a GPU repeats with a single launch."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import ClassVar

import torch
from torch import Tensor


class GraphedFunction:
    """A function, recorded as a CUDA graph: its kernels start together, without the time that torch takes for each.

    It must read all its results from tensors that stay where they are, start no process of the CPU, and not wait for
    the GPU (no ``item``, ``nonzero``, ``equal``). The memory of what it computes stays taken. Threads may share it.

    Args:
        function: returns a tensor. What it reads besides its argument is what it was when recorded.
        example: an argument, on a GPU. All others have its shape and type.
    """

    # torch records one graph at a time in a process.
    _recording: ClassVar[threading.Lock] = threading.Lock()

    def __init__(self, function: Callable[[Tensor], Tensor], example: Tensor) -> None:
        self._function = function  # keeps alive what it reads
        self._given = example.clone()
        self._stream = torch.cuda.Stream(example.device)
        self._graph = torch.cuda.CUDAGraph()
        self._lock = threading.Lock()
        self._stream.wait_stream(torch.cuda.current_stream(example.device))
        with self._recording, torch.cuda.stream(self._stream):
            function(self._given)  # compiles kernels
            # ``torch.cuda.graph`` would collect garbage and empty torch's cache of memory.
            self._graph.capture_begin(capture_error_mode="thread_local")
            try:
                self._found = function(self._given)
            finally:
                self._graph.capture_end()

    def __call__(self, argument: Tensor) -> Tensor:
        """Return what the function returns, the same to the last bit."""
        current = torch.cuda.current_stream(self._given.device)
        with self._lock, torch.cuda.stream(self._stream):
            self._stream.wait_stream(current)
            self._given.copy_(argument)
            self._graph.replay()
            found = self._found.clone()
            current.wait_stream(self._stream)
        found.record_stream(current)
        return found
