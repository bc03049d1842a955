"""A model that predicts masks from points, and decodes each point of a photograph once for all rules over masks."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, TypeVar
from weakref import proxy

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from benchmarks.extract import Timed
from scoup.models.sam import EncodedImage, PointModel

T = TypeVar("T")
Answer = tuple[Tensor, Tensor]
"""Logits [P, 3, h, w] and predicted IoU [P, 3] of points."""


class Decoded:
    """A ``PointModel`` of one photograph. Points of its crops are decoded each time, for memory."""

    def __init__(self, model: PointModel, image: NDArray[np.uint8]) -> None:
        self.model, self.shape = Timed(model), image.shape
        self.changed: Callable[[Answer], Answer] = lambda answer: answer
        self.asked = self.encoded = 0  # points, images
        self.images_encoded = 0  # by the model
        self.whole: EncodedImage | None = None

    def to_dict(self) -> dict[str, Any]:
        return self.model.to_dict()

    def encode(self, image: NDArray[np.uint8]) -> EncodedImage:
        self.encoded += 1
        if self.whole is None or image.shape != self.shape:
            self.images_encoded += 1
            found = _DecodedImage(
                proxy(self), self.model.encode(image)
            )  # no cycle: logits go with their owner
            if image.shape != self.shape:
                return found
            self.whole = found
        return self.whole

    def costs(self, work: Callable[[], T]) -> tuple[T, int, float]:
        """Run ``work``; return its result, the points asked, and its CPU seconds as if nothing had been decoded before.

        Points that were decoded before count with the mean of all, images likewise.
        """
        self.asked = self.encoded = 0
        spent, start = sum(self.model.seconds.values()), time.process_time()
        found = work()
        rules = time.process_time() - start - (sum(self.model.seconds.values()) - spent)
        encoder = self.encoded * self.model.seconds["encoder"] / max(self.images_encoded, 1)
        decoder = self.asked * self.model.seconds["decoder"] / max(self.model.points, 1)
        return found, self.asked, rules + encoder + decoder


class _DecodedImage:
    def __init__(self, owner: Decoded, encoded: EncodedImage) -> None:
        self.owner, self.encoded = owner, encoded
        self.known: dict[tuple[float, ...], Answer] = {}

    def predict(self, points: Tensor) -> Answer:
        self.owner.asked += len(points)
        keys = [tuple(point) for point in points.tolist()]
        missing = [number for number, key in enumerate(keys) if key not in self.known]
        if missing:
            found = self.encoded.predict(points[missing])
            self.known |= zip((keys[number] for number in missing), zip(*found, strict=True), strict=True)
        logits, iou = (torch.stack(each) for each in zip(*(self.known[key] for key in keys), strict=True))
        return self.owner.changed((logits, iou))

    def without_padding(self, logits: Tensor) -> Tensor:
        return self.encoded.without_padding(logits)

    def upscale(self, logits: Tensor) -> Tensor:
        return self.encoded.upscale(logits)
