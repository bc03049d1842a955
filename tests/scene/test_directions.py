"""Vectors brought to unit norm, and those that have no direction."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from scoup.base import InputError
from scoup.scene.directions import normalise_embeddings, query_vectors, unit_rows
from scoup.scene.regions import RegionMap, Regions
from scoup.uplift import BuildSettings, build
from support import examples, small_scene, unit


def rows(count: int, seed: int = 0) -> torch.Tensor:
    return unit(torch.randn(count, 5, generator=torch.Generator().manual_seed(seed)))


@settings(max_examples=examples(50))
@given(st.integers(0, 2**31), st.integers(-30, 30))
def test_any_norm_gives_the_same_direction(seed: int, exponent: int) -> None:
    expected = rows(4, seed)
    found = unit_rows(expected * 10.0**exponent)
    torch.testing.assert_close(found, expected, atol=1e-6, rtol=0)
    torch.testing.assert_close(normalise_embeddings(expected * 10.0**exponent), expected, atol=1e-6, rtol=0)


def test_unit_rows_stay_to_the_last_bit() -> None:
    given_rows = rows(6)
    assert unit_rows(given_rows).data_ptr() == given_rows.data_ptr()  # not even copied
    mixed = torch.cat([given_rows, 7 * given_rows, torch.zeros(1, 5)])
    found = unit_rows(mixed)
    assert torch.equal(found[:6], given_rows)
    assert torch.equal(found[-1], torch.zeros(5))
    torch.testing.assert_close(found[6:12], given_rows)
    short = torch.cat([0.3 * given_rows, 3 * given_rows])
    kept = unit_rows(short, lengthen=False)
    assert torch.equal(kept[:6], short[:6])
    torch.testing.assert_close(kept[6:], given_rows)


def test_arrays_and_single_vectors() -> None:
    one = rows(1)[0]
    for same in (one, one.numpy(), one.double() * 3, np.asarray(one, np.float16)):
        found = query_vectors(same, 5)
        assert found.shape == (1, 5)
        assert found.dtype == torch.float32
        torch.testing.assert_close(found[0], one, atol=1e-3, rtol=0)


@pytest.mark.parametrize(("bad", "message"), [
    (torch.ones(4), r"queries \[4\] must be \[5\]"),
    (torch.ones(0, 5), r"\[0, 5\]"),
    (torch.ones(2, 2, 5), r"\[2, 2, 5\]"),
    (torch.ones(2, 5, dtype=torch.int64), "int64"),
    (torch.tensor([[1.0, 2, 3, 4, torch.nan]]), "1 of 1 queries have values that are not finite"),
    (torch.tensor([[1.0, 2, 3, 4, 5], [0, 0, 0, 0, 0]]), "row 1 is zero"),
])  # fmt: skip
def test_what_is_no_direction(bad: torch.Tensor, message: str) -> None:
    with pytest.raises(InputError, match=message):
        query_vectors(bad, 5)


def test_region_maps_take_any_norm_and_integer() -> None:
    embeddings = rows(3)
    labels = torch.tensor([[0, 2], [-1, 1]])
    for integers in (torch.int64, torch.int32, torch.int16, torch.int8):
        made = RegionMap(labels.to(integers), embeddings)
        assert made.labels.dtype == torch.int32
        assert made.labels.equal(labels.int())
    made = RegionMap(labels.numpy(), 7 * embeddings.double().numpy())  # pyright: ignore[reportArgumentType]
    torch.testing.assert_close(made.embeddings, embeddings)
    with pytest.raises(InputError, match="integers"):
        RegionMap(labels.float(), embeddings)
    with pytest.raises(InputError, match="not finite"):
        RegionMap(labels, torch.full((3, 5), torch.inf))


def test_scaled_embeddings_build_the_same_field() -> None:
    gaussians, cameras, regions = small_scene(count=80, views=3)
    # With codes of all 8 atoms, learning a codebook would make much of the rounding of the last bit.
    settings_ = BuildSettings(n_atoms=8, k=4)
    expected = build(gaussians, cameras, regions, settings_)
    sevenfold = lambda name, level: regions.load_embeddings(name, level) * 7  # noqa: E731
    scaled = Regions(regions.levels, regions.view_names, regions.load, sevenfold)
    found = build(gaussians, cameras, scaled, settings_)
    random = torch.Generator().manual_seed(0)
    queries, canonical = (unit(torch.randn(count, expected.dim, generator=random)) for count in (4, 2))
    relevancy = [each.gaussian_relevancy(queries, canonical) for each in (found, expected)]
    torch.testing.assert_close(*relevancy, atol=1e-3, rtol=0)
    endless = lambda *_: torch.full((4, 16), torch.nan)  # noqa: E731
    broken = Regions(regions.levels, regions.view_names, regions.load, endless)
    with pytest.raises(InputError, match=r"view_00.*not finite"):
        build(gaussians, cameras, broken, settings_)
