"""Work on the next items of a loop."""

from __future__ import annotations

from scoup.base.work import worked_ahead


def test_results_come_in_order_and_few_are_made_ahead() -> None:
    started: list[int] = []

    def work(item: int) -> int:
        started.append(item)
        return item * item

    for number, (item, future) in enumerate(worked_ahead(work, range(20), 3)):
        assert (item, future.result()) == (number, number**2)
        assert len(started) <= number + 4
    assert sorted(started) == list(range(20))
