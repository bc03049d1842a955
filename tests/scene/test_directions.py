"""Vectors brought to unit norm, those that have no direction, and rotations as matrices and quaternions."""

from __future__ import annotations

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from messages import refuses
from scoup.scene.directions import (
    normalise_embeddings,
    quats_of_rotations,
    query_vectors,
    rotation_matrices,
    unit_rows,
)
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


def test_what_is_no_direction() -> None:
    nan, zero = torch.tensor([[1.0, 2, 3, 4, torch.nan]]), torch.tensor([[1.0, 2, 3, 4, 5], [0, 0, 0, 0, 0]])
    ones = torch.ones(2, 5)
    for bad in (ones[0, :4], ones[:0], ones.expand(2, 2, 5), ones.to(torch.int64), nan, zero):
        with refuses():
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
    for wrong, rows_ in (
        (labels.float(), embeddings),
        (labels, torch.full((3, 5), torch.inf)),
        (labels, torch.nan * embeddings),
        (labels, embeddings[:2]),
        (labels - 1, embeddings),
    ):
        with refuses():
            RegionMap(wrong, rows_)


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
    with refuses():
        build(gaussians, cameras, broken, settings_)


@settings(max_examples=examples(50), deadline=None)
@given(
    st.lists(st.tuples(*[st.sampled_from([-1.0, -1e-9, 0.0, 1e-9, 0.3, 1.0])] * 4).filter(any), min_size=1)
)
def test_quaternions_of_matrices(quats: list[tuple[float, ...]]) -> None:
    expected = unit(torch.tensor(quats, dtype=torch.float64))
    matrices = rotation_matrices(expected)
    found = quats_of_rotations(matrices)
    torch.testing.assert_close(rotation_matrices(found), matrices, atol=1e-12, rtol=0)
    torch.testing.assert_close((found * expected).sum(1).abs(), torch.ones(len(quats), dtype=torch.float64))
