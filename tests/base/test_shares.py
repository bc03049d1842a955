"""Shares of some work, as named and as torchrun gives them."""

from __future__ import annotations

import pytest

from scoup.base.errors import InputError
from scoup.base.shares import Share, device_of_process


def test_shares_are_everything_once() -> None:
    items = list(range(11))
    shares = [Share(number, 4).of(items) for number in range(4)]
    assert sorted(item for share in shares for item in share) == items
    assert max(map(len, shares)) - min(map(len, shares)) <= 1


@pytest.mark.parametrize("text", ["", "1", "0/2", "3/2", "1/0", "a/b", "1/2/3", "-1/2", "1/ 2", "²/3"])
def test_invalid_shares_are_refused(text: str) -> None:
    with pytest.raises(InputError, match="expected I/N with 1 <= I <= N"):
        Share.parse(text)


def test_shares_count_from_one() -> None:
    assert [Share.parse("1/4"), Share.parse("4/4")] == [Share(0, 4), Share(3, 4)]
    assert str(Share.parse("3/4")) == "3-of-4"


def test_the_environment_of_torchrun(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("RANK", "WORLD_SIZE", "LOCAL_RANK"):
        monkeypatch.delenv(name, raising=False)
    assert Share.of_environment().is_everything
    assert device_of_process("cuda") == "cuda"
    monkeypatch.setenv("RANK", "5")
    monkeypatch.setenv("WORLD_SIZE", "8")
    monkeypatch.setenv("LOCAL_RANK", "1")
    assert Share.of_environment() == Share(5, 8)
    assert device_of_process("cuda") == "cuda:1"
    assert device_of_process("cuda:3") == "cuda:3"
    assert device_of_process("cpu") == "cpu"
    monkeypatch.setenv("RANK", "8")
    with pytest.raises(InputError, match="WORLD_SIZE"):
        Share.of_environment()
