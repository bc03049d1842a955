"""Who is who among the Gaussians of an edited splat."""

from __future__ import annotations

import contextlib
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from scoup.base.errors import InputError, ScoupWarning
from scoup.io import load_gaussians, save_gaussians
from scoup.scene.gaussians import Gaussians
from scoup.uplift.matching import Matching, Tolerance, match
from support import KINDS, random_gaussians
from uplift.edits import joined


def rows_of(gaussians: Gaussians) -> list[bytes]:
    numbers = torch.cat(
        [gaussians.means, gaussians.quats, gaussians.scales, gaussians.opacities[:, None]], 1
    ).numpy()
    return [row.tobytes() for row in numbers]


def plain_match(before: Gaussians, after: Gaussians) -> list[int]:
    """Each row after the edit takes the first row before it of the same bytes that is not taken."""
    free: dict[bytes, list[int]] = {}
    for row, content in enumerate(rows_of(before)):
        free.setdefault(content, []).append(row)
    return [free[content].pop(0) if free.get(content) else -1 for content in rows_of(after)]


@st.composite
def edits(draw: st.DrawFn) -> tuple[Gaussians, Gaussians]:
    """A splat with duplicates and rows that are not finite, and what rows of it, with new ones, became."""
    count = draw(st.integers(0, 25))
    kinds = tuple(draw(st.lists(st.sampled_from(KINDS), min_size=1, max_size=4, unique=True)))
    pool = random_gaussians(count, draw(st.integers(0, 2**31)), kinds)
    rows = st.lists(st.integers(0, count - 1), max_size=30) if count else st.just([])
    before = pool.select(torch.tensor(draw(rows), dtype=torch.int64))
    appended = random_gaussians(draw(st.integers(0, 5)), draw(st.integers(0, 2**31)), kinds)
    after = joined(pool.select(torch.tensor(draw(rows), dtype=torch.int64)), appended)
    order = draw(st.permutations(range(len(after))))
    return before, after.select(torch.tensor(order, dtype=torch.int64))


@given(edits())
def test_equal_bytes_are_matched_in_order(edit):
    before, after = edit
    found = match(before, after)
    assert found.before.tolist() == plain_match(before, after)
    assert found.exact.equal(found.before >= 0)
    assert found.n_matched + found.n_appended == len(after)
    assert found.n_matched + found.n_deleted == len(before)


@given(edits())
def test_a_tolerance_keeps_what_bytes_have_matched_and_names_none_twice(edit):
    before, after = edit
    bare, found = match(before, after), match(before, after, Tolerance(0.5, 0.5, 0.5))
    assert found.before[bare.exact].equal(bare.before[bare.exact])
    named = found.before[found.before >= 0]
    assert len(named.unique()) == len(named)
    assert bool((after.finite() | bare.exact | (found.before < 0)).all())
    near = (found.before >= 0) & ~bare.exact
    distance = (before.means[found.before[near]] - after.means[near]).norm(dim=1)
    assert bool((distance <= 0.5 + 1e-5).all())


def test_rounded_rows_are_found_in_any_order():
    before = random_gaussians(500, 0)
    generator = torch.Generator().manual_seed(1)
    order = torch.randperm(500, generator=generator)[:400]
    part = before.select(order)
    after = Gaussians(
        part.means + 1e-4 * (torch.rand(400, 3, generator=generator) - 0.5),
        part.quats,
        part.scales * 1.02,
        (part.opacities * 255).round() / 255,
        part.sh,
    )
    assert match(before, after).n_matched == 0
    found = match(before, after, Tolerance(1e-3))
    assert found.before.equal(order)
    assert found.counts() == {"matched": 400, "rounded": 400, "appended": 0, "deleted": 100}


def test_two_rounded_rows_at_one_place_are_told_apart_by_their_scales():
    both = random_gaussians(2, 0)
    both = Gaussians(both.means[:1].repeat(2, 1), both.quats, torch.tensor([[1.0] * 3, [1.06] * 3]),
                     torch.full((2,), 0.5), both.sh)  # fmt: skip
    swapped = Gaussians(both.means + 1e-5, both.quats, both.scales.flip(0) * 1.01, both.opacities, both.sh)
    assert match(both, swapped, Tolerance(1e-3)).before.tolist() == [1, 0]


def test_another_scale_or_opacity_is_another_gaussian():
    one = random_gaussians(1, 0)
    for scales, opacities in ((one.scales * 1.3, one.opacities), (one.scales, (one.opacities + 0.3) % 1)):
        other = Gaussians(one.means + 1e-5, one.quats, scales, opacities, one.sh)
        assert match(one, other, Tolerance(1e-3)).n_matched == 0


@pytest.mark.data
@pytest.mark.parametrize("suffix", [".ply", ".splat", ".spz"])
def test_a_trained_splat_is_found_again_in_other_formats(data_folder: Path, tmp_path: Path, suffix: str):
    path = data_folder / "kitchen" / "scene" / "model.splat"
    if not path.is_file():
        pytest.skip(f"no kitchen in {data_folder}")
    before = load_gaussians(path)
    order = torch.randperm(len(before), generator=torch.Generator().manual_seed(0))[5000:]
    clipped = pytest.warns(ScoupWarning, match="of 119,495 Gaussians had scales outside")
    with clipped if suffix == ".spz" else contextlib.nullcontext():
        save_gaussians(before.select(order), tmp_path / f"edited{suffix}")
    found = match(before, load_gaussians(tmp_path / f"edited{suffix}"), Tolerance(1e-3))
    assert found.n_matched == len(order)
    assert found.n_rounded > 0
    wrong = found.before != order
    assert all(rows_of(before.select(found.before[wrong]))[i] == row
               for i, row in enumerate(rows_of(before.select(order[wrong]))))  # fmt: skip


@given(st.lists(st.integers(0, 40), max_size=25, unique=True))
def test_unmoved_is_a_longest_part_in_order(rows):
    matching = Matching(41, torch.tensor(rows, dtype=torch.int64), torch.ones(len(rows), dtype=torch.bool))
    kept = [row for row, stays in zip(rows, matching.unmoved().tolist(), strict=True) if stays]
    assert kept == sorted(kept)
    longest = np.zeros(len(rows), int)  # the plain way: of each row, the longest part that ends there
    for i, row in enumerate(rows):
        longest[i] = 1 + max((longest[j] for j in range(i) if rows[j] < row), default=0)
    assert len(kept) == longest.max(initial=0)


def test_what_was_rounded_has_not_stayed():
    matching = Matching(3, torch.tensor([0, 1, 2]), torch.tensor([True, False, True]))
    assert matching.unmoved().tolist() == [True, False, True]
    assert not matching.is_identity


@pytest.mark.parametrize("distance", [0.0, -1.0, float("nan"), float("inf")])
def test_a_tolerance_is_a_positive_distance(distance):
    with pytest.raises(InputError, match="tolerance"):
        Tolerance(distance)
