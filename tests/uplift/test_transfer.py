"""Codes of a field on another splat: edited, rounded by a format, or elsewhere."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from messages import refuses
from scoup.field import NO_THING
from scoup.io import load_gaussians, save_gaussians
from scoup.query import LanguageField, build
from scoup.scene import Gaussians, index_dtype
from scoup.uplift.constants import NEAREST
from scoup.uplift.field_transfer import source_rows, transfer
from scoup.uplift.settings import BuildSettings
from support import altered, random_gaussians, small_scene
from uplift.edits import joined


@pytest.fixture(scope="module")
def field() -> LanguageField:
    gaussians, cameras, regions = small_scene(count=200, views=3)
    return build(gaussians, cameras, regions, BuildSettings(n_atoms=6, k=3, keep=3, check_fit=False))


def moved(gaussians: Gaussians, by: float) -> Gaussians:
    return replace(gaussians, means=gaussians.means + by)


def test_an_edited_splat_keeps_its_codes_and_things(field: LanguageField) -> None:
    order = torch.randperm(200, generator=torch.Generator().manual_seed(0))[:150]
    pasted = moved(random_gaussians(2, 9), 100.0)
    edited = joined(field.gaussians.select(order), pasted)
    found = transfer(field, edited)
    assert found.code_indices[:150].equal(field.code_indices[order])
    assert found.code_weights[:150].equal(field.code_weights[order])
    assert not found.code_weights[150:].any()
    assert found.thing_table is not None
    assert field.thing_table is not None
    assert found.thing_table.owners[:150].equal(field.thing_table.owners[order])
    assert (found.thing_table.owners[150:] == NO_THING).all()
    assert found.gaussians.fingerprint() == found.fingerprint == edited.fingerprint()
    record = found.info.provenance["transferred"]
    assert record == {"from": field.fingerprint, "coded": 150, "not_coded": 2}


@pytest.mark.parametrize("suffix", [".spz", ".splat"])
def test_a_format_that_rounds_keeps_most_codes(field: LanguageField, suffix: str, tmp_path: Path) -> None:
    save_gaussians(field.gaussians, tmp_path / f"rounded{suffix}")
    rounded = load_gaussians(tmp_path / f"rounded{suffix}")
    rows = source_rows(field.gaussians, rounded)
    assert (rows >= 0).all()
    assert float((field.gaussians.means[rows] - rounded.means).norm(dim=1).max()) < 0.01


def test_the_nearest_that_contains_the_centre_is_the_source() -> None:
    before, after = random_gaussians(60, 1), random_gaussians(40, 2)
    distances = torch.cdist(after.means.double(), before.means.double())
    expected = np.full(40, -1)
    for row, far in enumerate(distances):
        for near in far.argsort()[:NEAREST].tolist():
            if far[near] <= before.scales[near].max():
                expected[row] = near
                break
    assert (expected >= 0).any()
    assert (expected < 0).any()
    np.testing.assert_array_equal(source_rows(before, after), expected)


def test_rows_that_are_not_finite_are_nobody() -> None:
    before, broken = random_gaussians(5, 1), random_gaussians(5, 1)
    broken.means[2] = torch.nan
    assert source_rows(broken, broken).tolist() == [0, 1, -1, 3, 4]
    assert source_rows(before.select([]), broken).tolist() == [-1] * 5
    assert source_rows(before.select([0]), before.select([0])).tolist() == [0]


def test_codes_of_many_atoms_are_carried(field: LanguageField) -> None:
    codebook = torch.nn.functional.pad(field.codebook, (0, 0, 0, 300))
    indices = field.code_indices.to(index_dtype(306))
    wide = altered(field, code_indices=indices, codebook=codebook, thing_table=None, cameras=None)
    found = transfer(wide, joined(moved(random_gaussians(2, 9), 100.0), field.gaussians))
    assert found.code_indices.dtype == torch.uint16
    assert found.code_indices[2:].equal(indices)
    with refuses():
        transfer(field, moved(field.gaussians, 1000.0))
