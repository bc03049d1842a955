"""Sums over codes in the compiled core against torch, and against decoding."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from messages import refuses
from raster.parity import needs_native
from scoup.field import code_sums, relevancy
from scoup.field.code_sums import best_code_cosines, code_relevancy, code_scores, inverse_code_norms
from scoup.field.cosines import FieldCodes
from scoup.raster import cosines_and_norms
from scoup.scene import SparseCodes
from support import examples, threads_of_torch, unit


@dataclass(frozen=True)
class Coded:
    """Codes [N, S, K], some of them empty, a codebook [S, L, 6], and the scores of some vectors [Q, 6]."""

    indices: Tensor
    weights: Tensor
    codebook: Tensor
    vectors: Tensor

    @property
    def scores(self) -> Tensor:
        return self.codebook @ self.vectors.T

    @property
    def grams(self) -> Tensor:
        return self.codebook @ self.codebook.transpose(1, 2)


@st.composite
def coded(draw: st.DrawFn, least_columns: int = 0) -> Coded:
    generator = torch.Generator().manual_seed(draw(st.integers(0, 999)))
    count, levels, k = draw(st.integers(0, 140)), draw(st.integers(1, 4)), draw(st.integers(0, 6))
    n_atoms = draw(st.sampled_from([1, 7, 256, 300]))
    indices = torch.randint(n_atoms, (count, levels, k), generator=generator)
    weights = torch.rand(count, levels, k, generator=generator)
    weights[torch.rand(count, levels, generator=generator) < 0.2] = 0  # no code
    weights[torch.rand(count, levels, k, generator=generator) < 0.2] = 0  # fewer atoms
    return Coded(
        indices.to(torch.uint8 if n_atoms <= 256 else torch.uint16),
        weights.half() if draw(st.booleans()) else weights,
        unit(torch.randn(levels, n_atoms, 6, generator=generator)),
        unit(torch.randn(draw(st.integers(least_columns, 20)), 6, generator=generator)),
    )


@needs_native
@settings(max_examples=examples(60))
@given(coded())
def test_scores_and_norms_are_those_of_torch(codes: Coded) -> None:
    arrays = codes.indices, codes.weights
    found, expected = code_scores(*arrays, codes.scores), code_sums.plain_code_scores(*arrays, codes.scores)
    torch.testing.assert_close(found, expected, rtol=1e-5, atol=1e-6)
    found = inverse_code_norms(*arrays, codes.grams)
    torch.testing.assert_close(found, _inverse_norms(codes), rtol=2e-3, atol=1e-6)
    assert found[~(codes.weights > 0).any(-1)].eq(0).all()


@needs_native
@settings(max_examples=examples(60))
@given(coded(least_columns=1), st.floats(0.1, 40))
def test_relevancy_is_that_of_torch(codes: Coded, temperature: float) -> None:
    arrays = codes.indices, codes.weights
    norms = inverse_code_norms(*arrays, codes.grams)
    best = best_code_cosines(*arrays, codes.scores, norms)
    expected = code_sums.plain_best_code_cosines(*arrays, codes.scores, norms)
    torch.testing.assert_close(best, expected, rtol=1e-4, atol=1e-5)
    others = codes.scores.flip(-1)[..., 1:]  # perhaps none
    found = code_relevancy(*arrays, others, norms, best, temperature)
    expected = code_sums.plain_code_relevancy(*arrays, others, norms, best, temperature)
    assert found.shape == (others.shape[-1], len(codes.scores), len(codes.indices))
    torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-5 * temperature)
    for number, own in enumerate(others.unbind(-1)):  # alone, the same to the last bit
        alone = code_relevancy(*arrays, own[..., None].contiguous(), norms, best, temperature)
        assert torch.equal(alone[0], found[number])


@settings(max_examples=examples(30))
@given(coded(least_columns=2), st.booleans())
def test_relevancy_is_that_of_decoded_codes(codes: Coded, by_torch: bool) -> None:
    prefix, arrays = "plain_" if by_torch else "", (codes.indices, codes.weights)
    norms = _inverse_norms(codes) if by_torch else inverse_code_norms(*arrays, codes.grams)
    canonical, queries = codes.scores[..., :1].contiguous(), codes.scores[..., 1:].contiguous()
    best = getattr(code_sums, f"{prefix}best_code_cosines")(*arrays, canonical, norms)
    found = getattr(code_sums, f"{prefix}code_relevancy")(*arrays, queries, norms, best, 10.0)
    for level, atoms in enumerate(codes.codebook):
        rows = SparseCodes(codes.indices[:, level], codes.weights[:, level].float(), len(atoms)).to_dense()
        wide, vectors = atoms.double(), codes.vectors.double()
        cosines = cosines_and_norms(rows.double(), wide @ vectors.T, wide @ wide.T)[0].T[None]
        expected = relevancy(cosines[:, 1:], cosines[:, :1])[0]
        torch.testing.assert_close(found[:, level].double(), expected, rtol=0, atol=2e-3)


@needs_native
@settings(max_examples=examples(10))
@given(st.integers(1, 3), st.integers(0, 99))
def test_the_same_bytes_for_any_number_of_threads(levels: int, seed: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    indices = torch.randint(9, (40_000, levels, 4), generator=generator).to(torch.uint8)
    weights = torch.rand(40_000, levels, 4, generator=generator).half()
    codebook, scores = (torch.randn(levels, 9, count, generator=generator) for count in (5, 3))

    def all_sums() -> list[Tensor]:
        norms = FieldCodes(indices, weights, codebook).inverse_norms()
        best = best_code_cosines(indices, weights, scores, norms)
        relevancy = code_relevancy(indices, weights, scores, norms, best, 10.0)
        return [norms, best, relevancy, code_scores(indices, weights, scores)]

    found = []
    for count in (1, 3):
        with threads_of_torch(count):
            found.append(all_sums())
    assert all(one.equal(other) for one, other in zip(*found, strict=True))


@needs_native
def test_bytes_name_the_first_of_many_atoms() -> None:
    indices = torch.tensor([0, 255, 7], dtype=torch.uint8).reshape(3, 1, 1)
    scores = torch.arange(60_000.0).reshape(1, -1, 1)
    found = code_scores(indices, torch.ones(3, 1, 1), scores)
    assert found.flatten().tolist() == [0, 255, 7]


@pytest.mark.parametrize("n_atoms", [7, 300])
def test_atoms_there_are_not_are_refused(n_atoms: int) -> None:
    indices = torch.zeros(100, 1, 2, dtype=torch.uint8 if n_atoms == 7 else torch.uint16)
    indices[-1] = n_atoms
    weights, scores, norms = torch.ones(100, 1, 2), torch.zeros(1, n_atoms, 1), torch.ones(100, 1)
    calls = [
        lambda: code_scores(indices, weights, scores),
        lambda: inverse_code_norms(indices, weights, torch.ones(1, n_atoms, n_atoms)),
        lambda: best_code_cosines(indices, weights, scores, norms),
        lambda: code_relevancy(indices, weights, scores, norms, norms, 10.0),
    ]
    for call in calls:
        with refuses():
            call()


def _inverse_norms(codes: Coded) -> Tensor:
    return code_sums.plain_inverse_code_norms(codes.indices, codes.weights, codes.grams)
