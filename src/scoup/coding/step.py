"""One step of Adam, as torch.optim.Adam takes it (Kingma and Ba 2015, algorithm 1)."""

from __future__ import annotations

import math
from dataclasses import dataclass

from torch import Tensor

BETAS = (0.9, 0.999)
EPSILON = 1e-8


@dataclass(frozen=True)
class Step:
    """The bias-corrected step p -= size * m / (sqrt(v) / root + epsilon)."""

    size: float
    root: float

    @classmethod
    def of_epoch(cls, epoch: int, learning_rate: float) -> Step:
        """The step of epoch 1, 2, ..."""
        return cls(learning_rate / (1 - BETAS[0] ** epoch), math.sqrt(1 - BETAS[1] ** epoch))

    def move(self, parameter: Tensor, first: Tensor, second: Tensor) -> None:
        """Move ``parameter`` in place along its moments m = ``first`` and v = ``second`` of one shape."""
        parameter.addcdiv_(first, second.sqrt().div_(self.root).add_(EPSILON), value=-self.size)


def add_gradient(first: Tensor, second: Tensor, gradient: Tensor) -> None:
    """Add a gradient to moments that have decayed already, in place."""
    first.add_(gradient, alpha=1 - BETAS[0])
    second.addcmul_(gradient, gradient, value=1 - BETAS[1])


def decay(first: Tensor, second: Tensor) -> None:
    """Decay the moments by one epoch, in place."""
    first.mul_(BETAS[0])
    second.mul_(BETAS[1])
