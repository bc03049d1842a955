"""Fitted methods whose answers are known, or recorded: only what a test asks of them is real."""

from __future__ import annotations

from torch import Tensor

from scoup.raster import Projection


class NothingRendered:
    """A ``FittedMethod`` that is asked for Gaussians alone."""

    bytes_per_gaussian = 0.0
    shared_bytes = 0.0

    def relevancy(
        self, projection: Projection, queries: Tensor, canonical: Tensor, size: tuple[int, int] | None = None
    ) -> Tensor:
        raise AssertionError("nothing is rendered")
