"""Things of a field: what is refused, what they say of themselves, in files and of chosen rows."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from field_files import check_same_things, parts_of
from messages import refuses
from planted_wall import SETTINGS, planted_wall
from scoup.field import MOST_THINGS, NO_THING, Field, ThingTable
from scoup.field.thing_table import LEAST_SPREAD, SURE_REGIONS, TENSORS
from scoup.query import LanguageField
from scoup.uplift import build
from support import altered


@pytest.fixture(scope="module")
def field() -> LanguageField:
    """With Gaussians and things that belong to none, too."""
    wall = planted_wall(views=3)
    built = build(wall.gaussians, wall.cameras, wall.regions, SETTINGS)
    owners = things_of(built).owners.clone()
    owners[::7, 0] = owners[::11, 1] = NO_THING
    return altered(built, thing_table=replace(things_of(built), owners=owners))


def things_of(field: Field) -> ThingTable:
    assert field.thing_table is not None
    return field.thing_table


def test_numbers_take_two_bytes_in_files(field: LanguageField, tmp_path: Path) -> None:
    field.save(tmp_path / "f.scoup")
    _, tensors = parts_of(tmp_path / "f.scoup")
    mine = {name.removeprefix("things.") for name in tensors if name.startswith("things.")}
    assert mine == set(TENSORS)
    for name in ("owners", "parents"):
        kept, numbers = tensors[f"things.{name}"], getattr(things_of(field), name)
        assert kept.dtype == torch.uint16
        assert kept.int().equal(torch.where(numbers == NO_THING, MOST_THINGS, numbers))
    altered(field, thing_table=None).save(tmp_path / "none.scoup")
    assert LanguageField.load(tmp_path / "none.scoup", field.gaussians).thing_table is None


@pytest.mark.parametrize(("count", "weight_bits"), [(0, 16), (None, 8), (MOST_THINGS, 16)])
def test_files_contain_any_number_of_things(
    field: LanguageField, tmp_path: Path, count: int | None, weight_bits: int
) -> None:
    """Of as many as there may be, 65534 is a thing, and 65535 in a file is none."""
    things = things_of(field)
    if count is not None:
        rows = torch.arange(count).clamp(max=len(things) - 1)
        parts: dict[str, Any] = {name: getattr(things, name)[rows] for name in TENSORS if name != "owners"}
        owners = things.owners.clone() if count else torch.full_like(things.owners, NO_THING)
        owners[5, 1] = count - 1  # NO_THING of none
        things = ThingTable(owners, **parts)
    altered(field, thing_table=things).save(tmp_path / "f.scoup", weight_bits=weight_bits)
    check_same_things(LanguageField.load(tmp_path / "f.scoup", field.gaussians).thing_table, things)


def test_some_gaussians_keep_their_owners(field: LanguageField, tmp_path: Path) -> None:
    things, mask = things_of(field), torch.zeros(len(field), dtype=torch.bool)
    mask[40:400:3] = True
    some = field[mask]
    assert things_of(some).owners.equal(things.owners[mask])
    check_same_things(replace(things_of(some), owners=things.owners), things)
    some.save(tmp_path / "part.scoup")
    check_same_things(LanguageField.load(tmp_path / "part.scoup").thing_table, some.thing_table)
    backwards = list(range(len(field)))[::-1]
    assert things_of(field[backwards]).owners.equal(things.owners.flip(0))
    assert things_of(field[[]]).owners.shape == (0, 2)
    assert altered(field, thing_table=None)[mask].thing_table is None
    moved = replace(field.gaussians, means=field.gaussians.means + 1, opacities=field.gaussians.opacities / 2)
    check_same_things(field.with_gaussians(moved).thing_table, field.thing_table)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_fields_move_to_a_gpu_with_their_things(field: LanguageField) -> None:
    moved = field.to("cuda")
    assert {part.device.type for part in vars(things_of(moved)).values()} == {"cuda"}
    check_same_things(things_of(moved.to("cpu")), field.thing_table)
    assert things_of(moved[10:20]).owners.cpu().equal(things_of(field).owners[10:20])


def test_things_of_another_field_are_refused(field: LanguageField) -> None:
    things = things_of(field)
    for other in (
        replace(things, owners=things.owners[:-1]),
        replace(things, owners=things.owners[:, :1].expand(-1, 3).contiguous()),
        replace(things, embeddings=things.embeddings[:, :-1]),
    ):
        with refuses():
            altered(field, thing_table=other)


@pytest.fixture
def things() -> ThingTable:
    """Five things: 0 to 2 of level 0, 3 and 4 of level 1; six Gaussians."""
    owners = [[0, 3], [0, 3], [1, 3], [2, NO_THING], [NO_THING, 4], [NO_THING, NO_THING]]
    return ThingTable(
        owners=torch.tensor(owners, dtype=torch.int32),
        levels=torch.tensor([0, 0, 0, 1, 1], dtype=torch.uint8),
        parents=torch.tensor([3, 3, NO_THING, NO_THING, NO_THING], dtype=torch.int32),
        embeddings=torch.eye(5, 8, dtype=torch.float16),
        agreement=torch.tensor([0.9, 0.8, 0.2, 0.95, 0.1]),
        n_regions=torch.tensor([3, 4, 2, 9, 2], dtype=torch.int32),
        mass=torch.tensor([5.0, 3.0, 2.0, 9.0, 1.0]),
        stability=torch.tensor([0.9, 0.5, 0.1, 1.0, 0.0]),
    )


def test_what_is_whole_is_taken(things: ThingTable) -> None:
    assert {*TENSORS, "names"} == {*vars(things)}
    empty = {name: getattr(things, name)[:0] for name in TENSORS[1:]}
    nothing = ThingTable(torch.full_like(things.owners, NO_THING), **empty)
    assert (len(things), len(nothing)) == (5, 0)
    assert not nothing.members(torch.zeros(0, dtype=torch.int64)).any()
    assert nothing.sums(torch.ones(6)).shape == (0,)
    assert nothing.spread == LEAST_SPREAD


def test_values_that_make_no_sense_are_refused(things: ThingTable) -> None:
    """The rules are those of files (tests/field/test_facts.py), but numbers are int32."""
    for name in ("owners", "parents"):
        with refuses():
            replace(things, **{name: getattr(things, name).long()})
    for name, place, value in (
        ("owners", (2, 1), 5), ("owners", (2, 1), MOST_THINGS), ("owners", (0, 0), -2), ("parents", 0, 5),
        ("parents", 1, -7), ("levels", 4, 2), ("embeddings", (1, 3), math.nan), ("mass", 0, -math.inf),
    ):  # fmt: skip
        tensor = getattr(things, name).clone()
        tensor[place] = value
        with refuses():
            replace(things, **{name: tensor})
    rows = torch.zeros(MOST_THINGS + 1, dtype=torch.int64)  # files can number no more
    with refuses():
        replace(things, **{name: getattr(things, name)[rows] for name in TENSORS[1:]})


def test_members_are_the_gaussians_of_things_and_sums_are_over_them(things: ThingTable) -> None:
    expected = {(0,): [0, 1], (2, 0): [0, 1, 3], (3,): [0, 1, 2], (4,): [4], (4, 3): [0, 1, 2, 4], (): []}
    for numbers, rows in expected.items():
        found = things.members(torch.tensor(numbers, dtype=torch.int64))
        assert found.nonzero()[:, 0].tolist() == rows
        assert found.dtype == torch.bool
    weights = torch.tensor([1.0, 2.0, 4.0, 8.0, 16.0, 32.0])
    assert things.sums(weights).dtype == torch.float64
    assert things.sums(weights).tolist() == [3, 4, 8, 7, 16]
    assert things.sums(weights > 3).tolist() == [0, 1, 1, 1, 1]
    assert things.rows(torch.tensor([4, 0])).sums(torch.ones(2)).tolist() == [1, 0, 0, 1, 1]


def test_the_spread_is_that_of_the_median_sure_thing(things: ThingTable) -> None:
    """Of the things of three regions or more, which here agree by 0.8, 0.9 and 0.95."""
    assert SURE_REGIONS == 3
    assert things.spread == pytest.approx(math.sqrt((1 - 0.9**2) / 8), abs=1e-6)
    for other in ({"n_regions": things.n_regions.clamp(max=2)}, {"agreement": torch.ones(5)}):
        assert replace(things, **other).spread == LEAST_SPREAD
    assert replace(things, agreement=torch.zeros(5)).spread == pytest.approx(8**-0.5)
    check_same_things(things.to("cpu"), things)
