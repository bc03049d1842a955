"""Numbers of things, where one, none and many differ; the messages of other tests show the rest."""

from __future__ import annotations

from scoup.base.texts import listed, share_of, spread


def test_ends_of_lists() -> None:
    assert [listed("abcd"[:length]) for length in (0, 1, 3, 4)] == ["", "a", "a, b, c", "a, b, c, ..."]
    assert listed(("a", "b"), 1) == "a, ..."
    assert [share_of(1, total, "camera") for total in (1, 2)] == ["the only camera", "1 of 2 cameras"]


def test_items_are_spread_evenly() -> None:
    numbers = list(range(200))
    assert spread(numbers[:3], 8) == [0, 1, 2]
    assert len(spread(numbers, 8)) == 8
    assert spread(numbers[:16], 8) == [1, 3, 5, 7, 9, 11, 13, 15]
    assert spread([], 8) == []
