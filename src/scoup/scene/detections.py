"""Names of things: what models that take words found in photographs, and which things they voted for."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from scoup.base import brief


@dataclass(frozen=True, eq=False)
class Detections:
    """Detections of a model in one photograph: M boxes, each for one of several texts."""

    texts: Tensor  # [M] int64, position of the text
    scores: Tensor  # [M] float32, 0 to 1
    boxes: Tensor  # [M, 4] float32, x0, y0, x1, y1 in pixels
    size: tuple[int, int]  # width and height of the photograph
    masks: Tensor | None = None  # [M, H, W] boolean; None of models that find boxes

    __repr__ = brief
