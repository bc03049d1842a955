"""Votes of detections for things against a plain reading of the rule, and things as a view shows them."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
import pytest
import torch

from literal_rules import overlap_of_boxes
from query.planted_room import FRONT, planted_room
from scoup.field import NameTable
from scoup.scene import Detections
from scoup.uplift.constants import BEST_SCORES, BEST_VIEWS, EVEN_SCORE, NAMING_IOU
from scoup.uplift.naming import (
    ThingsInView,
    count_votes,
    name_things,
    overlaps,
    things_in_view,
    votes_in_view,
)


def random_views(seed: int, count: int = 13) -> list[tuple[ThingsInView, Detections]]:
    rng = np.random.default_rng(seed)

    def boxes(n: int) -> torch.Tensor:
        low = rng.integers(0, 2, (n, 2)) * 8
        return torch.from_numpy(np.concatenate([low, low + rng.integers(2, 5, (n, 2)) * 4], 1)).float()

    views = []
    for _ in range(count):
        things = boxes(4)
        masks = torch.zeros(4, 48, 48, dtype=torch.bool)
        for mask, (left, top, right, bottom) in zip(masks, things.int().tolist(), strict=True):
            mask[top:bottom, left:right] = rng.random() < 0.8  # else not seen
        size, n = (96, 96), int(rng.integers(1, 9))  # the photograph is twice as large
        scores = torch.from_numpy(rng.random(n)).float()
        found = Detections(torch.from_numpy(rng.integers(0, 3, n)), scores, boxes(n) * 2, size)
        views.append((ThingsInView(masks, things), found))
    return views


@pytest.mark.parametrize("seed", range(3))
def test_votes_are_those_of_a_plain_reading(seed: int) -> None:
    views = random_views(seed)
    names = count_votes(("a", "b", "c"), [votes_in_view(view, found, 3) for view, found in views])
    votes, seen, tops = defaultdict(list), defaultdict(int), defaultdict(list)
    for view, found in views:
        best = defaultdict(float)
        top = [0.0] * 3
        lists = found.texts.tolist(), found.scores.tolist(), (found.boxes / 2).tolist()
        for text, score, box in zip(*lists, strict=True):
            top[text] = max(top[text], score)
            for thing, other in enumerate(view.boxes.tolist()):
                overlap = overlap_of_boxes(box, other)
                if view.masks[thing].any() and overlap >= NAMING_IOU:
                    best[text, thing] = max(best[text, thing], score * overlap)
        for key, value in best.items():
            votes[key].append(value)
        for thing in range(4):
            seen[thing] += bool(view.masks[thing].any())
        for text in range(3):
            tops[text].append(top[text])
    assert len(votes) == len(names.votes) > 3
    for (text, thing), each in votes.items():
        wanted = sum(sorted(each)[-BEST_VIEWS:]) / min(max(seen[thing], 2), BEST_VIEWS)
        assert float(names.votes_of(text, 4)[thing]) == pytest.approx(wanted, abs=1e-6)
    for text in range(3):
        mean = sum(sorted(tops[text])[-BEST_SCORES:]) / BEST_SCORES
        assert float(names.presence[text]) == pytest.approx(mean / (mean + EVEN_SCORE), abs=1e-6)
    alone = count_votes(("b",), [votes_in_view(view, found, 3).of_text(1) for view, found in views])
    torch.testing.assert_close(alone.votes_of(0, 4), names.votes_of(1, 4))
    torch.testing.assert_close(alone.presence[0], names.presence[1])


def test_masks_are_compared_as_masks() -> None:
    """An L covers half of its box: by masks it is another thing than the box."""
    shape = torch.zeros(1, 40, 40, dtype=torch.bool)
    shape[0, :, :10] = shape[0, 30:] = True
    view = ThingsInView(shape, torch.tensor([[0.0, 0, 40, 40]]))
    found = torch.zeros(1, dtype=torch.int64), torch.ones(1), torch.tensor([[0.0, 0, 80, 80]]), (80, 80)
    large = shape.repeat_interleave(2, 1).repeat_interleave(2, 2)
    for masks, expected in ((None, 1), (large, 1), (torch.ones_like(large), 700 / 1600)):
        assert float(overlaps(Detections(*found, masks), view)) == pytest.approx(expected)


def test_the_thing_in_a_box_is_named() -> None:
    field = planted_room()
    table = field.thing_table
    assert table is not None
    view = things_in_view(field.gaussians, table, FRONT, "inria")
    lamp = 4  # of planted_room.ROOM
    assert bool(view.seen[lamp])
    rows, columns = (view.masks[lamp].any(axis).nonzero()[:, 0] for axis in (1, 0))
    box = torch.stack([columns[0], rows[0], columns[-1] + 1, rows[-1] + 1]).float()
    torch.testing.assert_close(view.boxes[lamp], box)
    found = Detections(torch.tensor([1]), torch.tensor([0.8]), box[None], (FRONT.width, FRONT.height))
    names = name_things(field.gaussians, table, [(FRONT, found)] * 3, ("mug", "lamp"))
    assert names.things[names.votes.argmax()] == lamp
    assert set(names.rows.tolist()) == {1}
    assert float(names.presence[0]) == 0 < float(names.presence[1])


def test_newer_names_replace_older_ones() -> None:
    def table(*texts: str, vote: float) -> NameTable:
        count = len(texts)
        numbers = torch.arange(count, dtype=torch.int32)
        return NameTable(texts, torch.full((count,), vote), numbers, numbers, torch.full((count,), vote))

    joined = table("mug", "cup", vote=0.1).joined(table("Cup", "pen", vote=0.2))
    assert joined.texts == ("mug", "Cup", "pen")
    assert (joined.number("CUP"), joined.number("cap")) == (1, None)
    torch.testing.assert_close(joined.matrix(2), torch.tensor([[0.1, 0.2, 0], [0, 0, 0.2]]))
