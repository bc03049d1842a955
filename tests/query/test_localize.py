"""Localisation of hand-made maps."""

from __future__ import annotations

import pytest
import torch

from scoup.query.localize import localize
from scoup.query.presets import QueryPreset


def test_localize_by_hand() -> None:
    relevancy = torch.zeros(3, 20, 30)
    relevancy[0, 3, 4] = 1.0  # a spike: large, but averaged away
    relevancy[2, 10:17, 15:22] = 0.8
    place = localize(relevancy)
    assert (place.pixel, place.level) == ((18, 13), 2)
    assert place.score == pytest.approx(0.8)
    assert place.pixels.tolist() == [[18, 13]]


def test_ties_are_all_reported_row_by_row_and_the_first_level_wins() -> None:
    relevancy = torch.zeros(2, 20, 40)
    relevancy[0, 10, 10] = relevancy[0, 10, 30] = relevancy[1, 5, 5] = 1.0
    preset = QueryPreset("one", kernel=1, border="inside", threshold=0.6, smoothing=1)
    place = localize(relevancy, preset)
    assert place.pixels.tolist() == [[10, 10], [30, 10]]
    assert place.level == 0
    assert place.pixel in [(10, 10), (30, 10)]
