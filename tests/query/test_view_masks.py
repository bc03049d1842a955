"""Boxes, parts and points of masks against literal loops; depth of a view and the position of a mask."""

from __future__ import annotations

import gc

import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st
from torch import Tensor

from query.conftest import Queried
from scoup import raster
from scoup.query import constants
from scoup.query.boxes import PointSets
from scoup.query.view_answer import main_parts, mask_box, most_relevant_pixel, render_depth
from support import examples


def flooded(mask: Tensor) -> list[set[tuple[int, int]]]:
    """Sets of pixels that touch, in the order of their first pixels."""
    left, parts = {(y, x) for y, x in mask.nonzero().tolist()}, []
    while left:
        reached, waiting = set(), [min(left)]
        while waiting:
            y, x = waiting.pop()
            if (y, x) in left:
                left.remove((y, x))
                reached.add((y, x))
                waiting += [(y + i, x + j) for i in (-1, 0, 1) for j in (-1, 0, 1)]
        parts.append(reached)
    return parts


masks = st.builds(
    lambda shape, share, seed: torch.rand(shape, generator=torch.Generator().manual_seed(seed)) < share / 10,
    st.tuples(st.integers(0, 16), st.integers(0, 16)),
    st.integers(0, 10),
    st.integers(0, 2**31),
)


SPECKS = torch.zeros(20, 30, dtype=torch.bool)
SPECKS[5:15, 5:15] = SPECKS[1, 20:22] = SPECKS[18, 3] = True  # a hundred pixels, two and one


@settings(max_examples=examples(60))
@given(masks)
@example(SPECKS)
def test_boxes_and_main_parts_are_what_a_flood_reaches(mask: Tensor) -> None:
    parts = flooded(mask)
    kept, largest = main_parts(mask)
    if not parts:
        assert (kept.any(), largest.any(), mask_box(mask)) == (False, False, None)
        return
    areas = [len(part) for part in parts]
    most = max(areas)
    assert {tuple(each) for each in largest.nonzero().tolist()} == parts[areas.index(most)]
    expected = set().union(*(part for part in parts if len(part) >= constants.SPECK * most))
    assert {tuple(each) for each in kept.nonzero().tolist()} == expected
    rows, columns = zip(*expected, strict=True)
    assert mask_box(kept) == (min(columns), min(rows), max(columns) + 1, max(rows) + 1)


@settings(max_examples=examples(60))
@given(masks, st.integers(0, 2**31))
def test_the_most_relevant_pixel_has_the_largest_mean_around_it(mask: Tensor, seed: int) -> None:
    heat = torch.randint(0, 9, mask.shape, generator=torch.Generator().manual_seed(seed)) / 8
    found = most_relevant_pixel(heat, mask)
    assert (found is None) == (not mask.any())
    if found is None:
        return
    means = {
        (x, y): float(heat[max(0, y - 3) : y + 4, max(0, x - 3) : x + 4].mean())
        for y, x in mask.nonzero().tolist()
    }
    assert means[found] == pytest.approx(max(means.values()), abs=1e-6)


def test_of_a_plateau_the_middle_is_the_point() -> None:
    mask = torch.zeros(40, 60, dtype=torch.bool)
    mask[5:36, 10:51] = True
    assert most_relevant_pixel(torch.full((40, 60), 0.7), mask) == (30, 20)


def test_depth_is_the_mean_of_what_paints_a_pixel(queried: Queried) -> None:
    field, camera = queried.field, queried.camera
    projection = field.project(camera)
    found = render_depth(projection, field.gaussians, camera)
    means = field.gaussians.means.double()
    distances = (means @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3])[:, 2]
    ones = torch.eye(len(field)).split(1)
    shares = torch.cat([raster.render_channels(projection, one.T)[0] for one in ones], -1).double()
    alpha = shares.sum(-1)
    painted = alpha >= 0.5
    assert painted.any()
    assert torch.equal(torch.isfinite(found), painted)
    assert torch.allclose(found[painted].double(), (shares @ distances / alpha)[painted], rtol=1e-4)


def test_the_position_is_that_of_the_thing_seen_most(queried: Queried) -> None:
    """It is the median of its Gaussians by what they contribute to the main parts, without any others."""
    field, camera = queried.field, queried.camera
    view = field.at(camera)
    assert field.thing_table is not None
    every = torch.eye(len(field))
    for seen in view.answer(queried.texts):
        image = raster.render_values(view.projection, every)  # [H, W, N]
        weights = image[seen.main_parts].double().sum(0)
        members = [field.thing_table.members(torch.tensor([thing])) for thing in seen.answer.things]
        rows = max(members, key=lambda mask: float(weights[mask].sum()))
        points = PointSets.of_one_thing(field.gaussians.means[rows].double(), weights[rows])
        assert seen.position is not None
        assert torch.allclose(seen.position, torch.from_numpy(points.medians()[0]), atol=1e-4)
    assert max(len(seen.answer.things) for seen in view.answer(queried.texts)) > 1


def test_answers_know_their_position_after_the_projection_is_gone(queried: Queried) -> None:
    field, camera = queried.field, queried.camera
    view = field.at(camera)
    expected = [answer.position for answer in view.answer(queried.texts)]
    answers = field.at(camera).answer(queried.texts)
    del view
    gc.collect()
    for answer, wanted in zip(answers, expected, strict=True):
        found = answer.position
        assert (found is None) == (wanted is None)
        assert found is None or (wanted is not None and torch.equal(found, wanted))
    assert any(answer.position is not None for answer in answers)
