"""Frames of the world: lengths in words, their record, and refused values."""

from __future__ import annotations

from typing import Any

import pytest

from messages import refuses
from scoup.base import WorldFrame

PLACE = WorldFrame(0.25, (0.1, -0.9, 0.2), (0.8, 0.1, 0.5), (48.2082, 16.3738, 187.5), "map")


def test_lengths_are_in_metres_once_a_metre_is_known() -> None:
    position, extent = [4.0, 0.0, -1.0], [1.0, 0.5, 0.123456]
    assert WorldFrame().place(position, extent) == "[4, 0, -1], extent 1 x 0.5 x 0.123 scene units"
    assert WorldFrame().metres(position, extent) == {}
    framed = WorldFrame(0.5)
    assert framed.place(position, extent) == "[2, 0, -0.5], extent 0.5 x 0.25 x 0.0617 m"
    wanted = {"position_metres": [2, 0, -0.5], "extent_metres": pytest.approx([0.5, 0.25, 0.061728])}
    assert framed.metres(position, extent) == wanted


@pytest.mark.parametrize("frame", [WorldFrame(), PLACE, WorldFrame(up=(0.0, -1.0, 0.0))])
def test_the_record_keeps_every_bit(frame: WorldFrame) -> None:
    assert WorldFrame.of_header(frame.entry()) == frame
    assert WorldFrame.of_header({"frame": {**frame.to_dict(), "of a newer version": 1}}) == frame


@pytest.mark.parametrize("record", [
    {"metres_per_unit": "x"}, {"up": "xyz"}, {"up": 3}, {"origin": [1, 2]}, {"origin": [None] * 3}, {"name": 7},
])  # fmt: skip
def test_a_damaged_record_is_refused(record: dict[str, Any]) -> None:
    with refuses():
        WorldFrame.of_header({"frame": record})


@pytest.mark.parametrize("values", [
    {"metres_per_unit": value} for value in (0, -1.0, float("nan"), float("inf"))
] + [{"origin": (0, 181, 0)}, {"origin": (float("nan"), 0, 0)}, {"north": (0, 0, 0)},
     {"up": (0, 0, 1), "north": (0, 0, -1)}])  # fmt: skip
def test_what_is_no_frame_is_refused(values: dict[str, Any]) -> None:
    with refuses():
        WorldFrame(**values)
