"""Fields with things: kept in files, chosen rows, and what does not fit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from field_files import parts_of
from messages import refuses
from planted_wall import SETTINGS, planted_wall
from scoup.field import Field
from scoup.field.checks import MOST_THINGS
from scoup.field.thing_table import NO_THING, ThingTable
from scoup.query import LanguageField
from scoup.uplift import build
from support import altered

PARTS = ("owners", "levels", "parents", "embeddings", "agreement", "n_regions", "mass", "stability")


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


def assert_same(one: ThingTable | None, other: ThingTable | None) -> None:
    for name in PARTS:
        mine, theirs = getattr(one, name), getattr(other, name)
        assert mine.dtype == theirs.dtype
        assert mine.equal(theirs), name


def test_numbers_take_two_bytes_in_files(field: LanguageField, tmp_path: Path) -> None:
    field.save(tmp_path / "f.scoup")
    _, tensors = parts_of(tmp_path / "f.scoup")
    mine = {name.removeprefix("things.") for name in tensors if name.startswith("things.")}
    assert mine == set(PARTS)
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
        parts: dict[str, Any] = {name: getattr(things, name)[rows] for name in PARTS if name != "owners"}
        owners = things.owners.clone() if count else torch.full_like(things.owners, NO_THING)
        owners[5, 1] = count - 1  # NO_THING of none
        things = ThingTable(owners, **parts)
    altered(field, thing_table=things).save(tmp_path / "f.scoup", weight_bits=weight_bits)
    assert_same(LanguageField.load(tmp_path / "f.scoup", field.gaussians).thing_table, things)


def test_some_gaussians_keep_their_owners(field: LanguageField, tmp_path: Path) -> None:
    things, mask = things_of(field), torch.zeros(len(field), dtype=torch.bool)
    mask[40:400:3] = True
    some = field[mask]
    assert things_of(some).owners.equal(things.owners[mask])
    assert_same(replace(things_of(some), owners=things.owners), things)
    some.save(tmp_path / "part.scoup")
    assert_same(LanguageField.load(tmp_path / "part.scoup").thing_table, some.thing_table)
    backwards = list(range(len(field)))[::-1]
    assert things_of(field[backwards]).owners.equal(things.owners.flip(0))
    assert things_of(field[[]]).owners.shape == (0, 2)
    assert altered(field, thing_table=None)[mask].thing_table is None
    moved = replace(field.gaussians, means=field.gaussians.means + 1, opacities=field.gaussians.opacities / 2)
    assert_same(field.with_gaussians(moved).thing_table, field.thing_table)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_fields_move_to_a_gpu_with_their_things(field: LanguageField) -> None:
    moved = field.to("cuda")
    assert {part.device.type for part in vars(things_of(moved)).values()} == {"cuda"}
    assert_same(things_of(moved.to("cpu")), field.thing_table)
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
