"""The truth about relations of boxes, and average precision by hand."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.things import average_precision
from benchmarks.things_truth import is_between, is_true

SPANS = {  # along right, up and away
    "table": [(0, 2), (0.7, 0.75), (0, 1)],
    "mug": [(0.2, 0.3), (0.75, 0.85), (0.4, 0.5)],
    "bowl": [(1.4, 1.8), (0.75, 0.9), (0.2, 0.6)],
    "apple": [(1.5, 1.6), (0.8, 0.88), (0.3, 0.4)],
    "lamp": [(0.9, 1.1), (1.8, 2), (0.4, 0.6)],
    "pen": [(0.31, 0.41), (0.75, 0.76), (0.4, 0.5)],
}
BOXES = {name: np.array(spans) for name, spans in SPANS.items()}


@pytest.mark.parametrize(
    ("one", "relation", "other", "truth"),
    [
        ("mug", "left of", "bowl", True), ("bowl", "left of", "mug", False), ("mug", "left of", "table", None),
        ("bowl", "right of", "mug", True), ("apple", "in front of", "mug", None), ("mug", "behind", "apple", None),
        ("mug", "on", "table", True), ("lamp", "on", "table", False), ("mug", "on", "bowl", False),
        ("lamp", "above", "table", True), ("table", "above", "lamp", False), ("table", "under", "mug", True),
        ("apple", "inside", "bowl", True), ("mug", "inside", "bowl", False), ("bowl", "inside", "apple", None),
        ("pen", "near", "mug", True), ("mug", "near", "bowl", False),
    ],
)  # fmt: skip
def test_relations_of_boxes(one, relation, other, truth) -> None:
    assert is_true(relation, BOXES[one], BOXES[other], other) is truth


def test_between() -> None:
    assert is_between(BOXES["table"], BOXES["mug"], BOXES["bowl"]) is True
    assert is_between(BOXES["mug"], BOXES["table"], BOXES["bowl"]) is False
    assert is_between(BOXES["pen"], BOXES["mug"], BOXES["bowl"]) is None


def test_average_precision_by_hand() -> None:
    overlaps = np.array([[0.9, 0.0], [0.8, 0.1], [0.0, 0.6], [0.0, 0.0]])  # the second finds the first again
    assert average_precision(overlaps, 0.5) == pytest.approx((1 + 2 / 3) / 2)
    assert average_precision(overlaps, 0.7) == pytest.approx(0.5)
    assert average_precision(np.zeros((0, 2)), 0.5) == 0
