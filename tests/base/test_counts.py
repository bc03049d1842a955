"""Numbers of things."""

from __future__ import annotations

from scoup.base.texts import counted, listed, none_of, share_of, spread, verb


def test_one_is_singular():
    assert [counted(number, "view") for number in (0, 1, 2)] == ["0 views", "1 view", "2 views"]
    assert counted(90854, "Gaussian") == "90,854 Gaussians"
    assert counted(1, "view with regions", "views with regions") == "1 view with regions"
    assert counted(3, "view with regions", "views with regions") == "3 views with regions"


def test_none_of_one():
    assert [none_of(number, "view") for number in (1, 4)] == ["no view", "none of the 4 views"]


def test_shares_of_one_and_of_many():
    assert [share_of(1, total, "camera") for total in (1, 2)] == ["the only camera", "1 of 2 cameras"]
    assert share_of(2000, 2000, "camera tried", "cameras tried") == "2,000 of 2,000 cameras tried"


def test_verbs_agree():
    assert [verb(number, "sees", "see") for number in (0, 1, 2)] == ["see", "sees", "see"]


def test_names_are_listed_up_to_a_number():
    assert [listed("abcd"[:length]) for length in (0, 1, 3, 4)] == ["", "a", "a, b, c", "a, b, c, ..."]
    assert listed(("a", "b"), 1) == "a, ..."


def test_items_are_spread_evenly():
    names = [str(number) for number in range(200)]
    assert spread(names[:3], 8) == ["0", "1", "2"]
    assert len(spread(names, 8)) == 8
    assert spread(names[:16], 8) == [str(number) for number in (1, 3, 5, 7, 9, 11, 13, 15)]
    assert spread([], 8) == []
