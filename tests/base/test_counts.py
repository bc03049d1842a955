"""Numbers of things."""

from __future__ import annotations

from scoup.base.counts import counted, none_of


def test_one_is_singular():
    assert [counted(number, "view") for number in (0, 1, 2)] == ["0 views", "1 view", "2 views"]
    assert counted(90854, "Gaussian") == "90,854 Gaussians"
    assert counted(1, "view with regions", "views with regions") == "1 view with regions"
    assert counted(3, "view with regions", "views with regions") == "3 views with regions"


def test_none_of_one():
    assert [none_of(number, "view") for number in (1, 4)] == ["no view", "none of the 4 views"]
