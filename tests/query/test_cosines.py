"""Relevancy against a literal evaluation of its definition; further queries through one projection against those of a
fresh one, in every backend."""

from __future__ import annotations

import gc
import math
import weakref
from collections.abc import Iterator
from functools import partial
from unittest.mock import Mock

import numpy as np
import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st
from torch import Tensor

from query.conftest import random_vectors
from raster.parity import BACKENDS
from scoup import raster
from scoup.base import InputError
from scoup.field import FieldInfo, relevancy
from scoup.query.language_field import LanguageField
from scoup.scene import Gaussians
from support import KINDS, examples, make_camera, random_gaussians, scenes, unit

DIM = 16


assert_close = partial(torch.testing.assert_close, rtol=0, atol=2e-5)


def field_of(gaussians: Gaussians, seed: int, n_atoms: int = 7, k: int = 3) -> LanguageField:
    """Random codes, a third of the Gaussians without; atoms within a cone, as embeddings are."""
    generator = torch.Generator().manual_seed(seed)
    count = len(gaussians)
    indices = torch.randint(n_atoms, (count, 3, k), generator=generator).to(torch.uint8)
    weights = torch.rand(count, 3, k, generator=generator)
    weights[: count // 3] = 0
    codebook = unit(torch.randn(3, n_atoms, DIM, generator=generator) + 2 * torch.ones(DIM).div(4))
    info = FieldInfo(("s", "m", "l"), "a/model", gaussians.fingerprint(), count)
    return LanguageField(indices, weights, codebook, info, gaussians)


def vectors(count: int, seed: int) -> Tensor:
    return random_vectors(count, DIM, seed=seed)


@pytest.mark.parametrize("backend", BACKENDS)
@settings(max_examples=examples(25), deadline=None)
@given(scene=scenes(25), seed=st.integers(0, 999), n_queries=st.integers(1, 4))
@example((random_gaussians(60, 3, KINDS), make_camera(seed=2)), 5, 2)
@example((random_gaussians(0, 3), make_camera(seed=2)), 5, 2)
def test_further_queries_are_those_of_a_fresh_projection(backend, scene, seed, n_queries) -> None:
    gaussians, camera = scene
    field = field_of(gaussians, seed)
    canonical, others = vectors(4, seed + 1), vectors(2, seed + 2)
    view = field.at(camera, backend=backend)
    rounds = [
        (vectors(n_queries, seed + 3), canonical),
        (vectors(n_queries, seed + 4), canonical),
        (vectors(1, seed + 5), others),  # other phrases
        (vectors(9, seed + 6), others),  # more than are rendered as channels
        (vectors(1, seed + 7), canonical),
    ]
    for queries, phrases in rounds:
        found = view.relevancy(queries, phrases)
        expected = field.at(camera, backend=backend).relevancy(queries, phrases)
        assert found.shape == expected.shape == (3, len(queries), camera.height, camera.width)
        assert found.is_contiguous()
        assert torch.isfinite(found).all()
        assert len(gaussians) or (found == 0.5).all()
        assert_close(found, expected)


@pytest.mark.parametrize("backend", BACKENDS)
def test_what_is_known_is_rendered_once(backend, monkeypatch) -> None:
    gaussians, camera = random_gaussians(40, 1), make_camera()
    field, canonical = field_of(gaussians, 1), vectors(4, 1)
    rendered = Mock(wraps=raster.render_cosines_and_norms)  # all cosines
    monkeypatch.setattr(raster, "render_cosines_and_norms", rendered)
    view = field.at(camera, backend=backend)
    for seed in range(3):
        view.relevancy(vectors(2, seed), canonical)
    view.relevancy(vectors(1, 9), vectors(3, 9))
    assert rendered.call_count == 1
    assert 0 < view.cache.bytes <= view.cache.most_bytes
    field.at(camera, backend=backend).relevancy(vectors(1, 9), canonical)
    assert rendered.call_count == 2


def test_codes_and_phrases_that_change_are_noticed() -> None:
    gaussians, camera = random_gaussians(40, 1), make_camera()
    field, other = (field_of(gaussians, seed) for seed in (1, 2))
    view, canonical, queries = field.at(camera), vectors(4, 1), vectors(2, 2)

    def relevancies() -> Iterator[Tensor]:
        yield view.relevancy(queries, canonical)
        field.codebook[:] = field.codebook.flip(1)  # written to
        yield view.relevancy(queries, canonical)
        field.code_indices = other.code_indices  # put in its place
        yield view.relevancy(queries, canonical)
        canonical[:] = vectors(4, 5)
        yield view.relevancy(queries, canonical)

    before = torch.zeros(())
    for found in relevancies():
        assert_close(found, field.relevancy(camera, queries, canonical))
        assert not found.equal(before)
        before = found


def test_a_field_keeps_no_view_alive() -> None:
    gaussians, camera = random_gaussians(40, 1), make_camera()
    view = field_of(gaussians, 1).at(camera)
    view.relevancy(vectors(1, 2), vectors(4, 1))
    projection = weakref.ref(view.projection)
    del view
    gc.collect()
    assert projection() is None


def literal_relevancy(query: float, canonical: list[float], temperature: float) -> float:
    ours, theirs = math.exp(temperature * query), [math.exp(temperature * other) for other in canonical]
    return min(ours / (ours + other) for other in theirs)


@settings(max_examples=examples(50))
@given(st.sampled_from([(1,), (3,), (2, 3)]), st.integers(1, 5), st.floats(0.1, 30), st.integers(0, 2**31))
def test_relevancy_is_the_minimum_over_canonical_phrases(trailing, phrases, temperature, seed) -> None:
    """Of the same level and place."""
    generator = torch.Generator().manual_seed(seed)
    cosines, canonical = (2 * torch.rand(3, n, *trailing, generator=generator) - 1 for n in (2, phrases))
    found = relevancy(cosines, canonical, temperature)
    assert found.shape == cosines.shape
    for level, query, *place in np.ndindex(*found.shape):
        phrases_there = canonical[(level, slice(None), *place)].tolist()
        expected = literal_relevancy(float(cosines[level, query][tuple(place)]), phrases_there, temperature)
        assert float(found[level, query][tuple(place)]) == pytest.approx(expected, abs=1e-5)


def test_relevancy_of_a_draw_and_of_a_large_difference() -> None:
    ones = torch.ones(1, 1, 2)
    assert relevancy(0 * ones, 0 * ones).tolist() == [[[0.5, 0.5]]]  # a draw
    assert relevancy(ones, -ones, temperature=1e4).tolist() == [[[1.0, 1.0]]]


@pytest.mark.parametrize("canonical", [(2, 0, 5), (1, 4, 5), (2, 4, 6), (2, 4), (3,)])
def test_shapes_that_do_not_belong_together(canonical: tuple[int, ...]) -> None:
    with pytest.raises(InputError):
        relevancy(torch.zeros(3 if len(canonical) == 1 else (2, 1, 5)), torch.zeros(canonical))
