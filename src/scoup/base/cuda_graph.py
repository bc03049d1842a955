"""Functions of one tensor that a GPU repeats with a single launch."""

from __future__ import annotations

import threading
import warnings
from collections.abc import Callable
from typing import ClassVar

import torch
from torch import Tensor

from scoup.base.errors import ScoupWarning


class GraphedFunction:
    """A function, recorded as a CUDA graph: its kernels start together, without the time that torch takes for each.

    It must read all its results from tensors that stay where they are, and not wait for the GPU (no ``item``,
    ``nonzero``, ``equal``). The memory of what it computes stays taken. Threads may share it.

    Args:
        function: returns a tensor. What it reads besides its argument is what it was when recorded.
        example: an argument, on a GPU. All others have its shape and type.
    """

    # torch records one graph at a time in a process.
    _recording: ClassVar[threading.Lock] = threading.Lock()

    def __init__(self, function: Callable[[Tensor], Tensor], example: Tensor) -> None:
        self._function = function  # keeps alive what it reads
        self._lock = threading.Lock()
        self._graph = torch.cuda.CUDAGraph()
        self._used = torch.cuda.Event()
        stream, current = torch.cuda.Stream(example.device), torch.cuda.current_stream(example.device)
        # Tensors of inference mode could not be written to outside of it.
        with torch.inference_mode(False), torch.no_grad(), self._recording:
            self._given = torch.empty_like(example)
            stream.wait_stream(current)
            with torch.cuda.stream(stream):
                self._given.copy_(example)
                function(self._given)  # compiles kernels
                # ``torch.cuda.graph`` would collect garbage and empty torch's cache of memory.
                self._graph.capture_begin(capture_error_mode="thread_local")
                try:
                    self._found = function(self._given)
                finally:
                    self._graph.capture_end()
            current.wait_stream(stream)

    def __call__(self, argument: Tensor) -> Tensor:
        """Return what the function returns, the same to the last bit."""
        with self._lock, torch.no_grad():
            current = torch.cuda.current_stream(self._given.device)
            current.wait_event(self._used)  # perhaps of another stream
            self._given.copy_(argument)
            self._graph.replay()
            found = self._found.clone()
            self._used.record(current)
        return found


def graphed(function: Callable[[Tensor], Tensor], example: Tensor) -> Callable[[Tensor], Tensor]:
    """Return a function as a ``GraphedFunction``; or as it is, with a warning, if the GPU records none, as without
    memory for it."""
    try:
        return GraphedFunction(function, example)
    except RuntimeError as error:
        reason = " ".join(str(error).split())[:120]
        warnings.warn(
            f"queries of this view are slower: no CUDA graph of them ({reason})", ScoupWarning, stacklevel=2
        )
        return function
