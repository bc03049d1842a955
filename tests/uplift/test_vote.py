"""The vote by the compiled core against the reference, over random region sums."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from messages import refuses
from raster.parity import assert_close, needs_native
from scoup.base import InputError
from scoup.scene import SparseCodes
from scoup.uplift.reweighting import EarlierRound
from scoup.uplift.vote_backends.native import Vote as NativeVote
from scoup.uplift.vote_backends.reference import Vote as ReferenceVote
from support import examples, threads_of_torch
from uplift.random_votes import Sizes, buckets_of, check_rounds, damaged, earlier_of, random_vote

CPU = torch.device("cpu")


@needs_native
@settings(max_examples=examples(40), deadline=None)
@given(
    sizes=st.builds(
        Sizes,
        n_gaussians=st.sampled_from([0, 1, 255, 256, 257, 700]),
        views=st.integers(0, 4),
        levels=st.integers(1, 5),
        n_atoms=st.sampled_from([1, 7, 33, 256, 257, 600]),
        k=st.integers(1, 9),
        entries=st.just(500),
        without=st.sampled_from([None, 0]),
    ),
    keep=st.sampled_from([1, 4, 33, 64]),
    seed=st.integers(0, 2**31),
)
def test_the_core_agrees_with_the_reference(sizes: Sizes, keep: int, seed: int) -> None:
    check_rounds(NativeVote, sizes, keep, seed)


@pytest.mark.parametrize("backend", [pytest.param(NativeVote, marks=needs_native), ReferenceVote])
def test_a_process_may_have_no_share(backend):
    arguments = random_vote(Sizes(), 2)
    earlier = earlier_of(arguments, 4, 3)
    prepared = backend(**arguments, device=CPU)
    for nothing in (range(0), range(2, 2)):
        indices, weights = prepared.round(4, earlier, True, nothing)
        assert indices.shape == weights.shape == (0, 3, 4)
        assert [len(of_level) for of_level in prepared.deviations(earlier, nothing)] == [0, 0, 0]


@needs_native
@pytest.mark.parametrize("n_atoms", [24, 300])
def test_all_atoms_may_be_kept(n_atoms):
    check_rounds(NativeVote, Sizes(n_atoms=n_atoms), n_atoms, 1)


def test_the_reference_adds_codes_up_as_written():
    """w_i = sum of A[i, r] W_r, with loops."""
    arguments = random_vote(Sizes(40, 3, 2, 6, 2, 60), 3)
    sums = ReferenceVote(**arguments, device=CPU).sums(None, range(1))
    expected = torch.zeros_like(sums)
    for view in arguments["views"]:
        part = view.entries
        for gaussian, combination, weight in zip(
            part.gaussians(), part.combinations, part.weights, strict=True
        ):
            for level, codes in enumerate(arguments["codes"]):
                region = view.regions[combination, level]
                if region >= 0:
                    expected[gaussian, level] += float(weight) * codes.to_dense()[region]
    assert expected.any()
    assert_close(sums, expected, 20.0)


@needs_native
def test_same_bytes_on_any_number_of_threads_and_share_of_the_buckets():
    arguments = random_vote(Sizes(5000, 6, 3, 48, 4, 20_000), 5)
    earlier, buckets = earlier_of(arguments, 4, 3), buckets_of(arguments)
    found = []
    for threads in (1, 2, 3, 5):
        with threads_of_torch(threads):
            prepared = NativeVote(**arguments, device=CPU)
            found.append(
                (*prepared.round(4, earlier, False, buckets), *prepared.deviations(earlier, buckets))
            )
            shares = buckets[:3], buckets[3:4], buckets[4:]
            parts = [prepared.round(4, earlier, False, some) for some in shares]
        assert torch.equal(torch.cat([weights for _, weights in parts]), found[0][1])
    for others in found[1:]:
        assert all(torch.equal(one, other) for one, other in zip(others, found[0], strict=True))


@needs_native
@pytest.mark.usefixtures("instruction_set")
def test_every_instruction_set_agrees_with_the_reference():
    check_rounds(NativeVote, Sizes(), 4, 7)


@needs_native
@settings(max_examples=examples(40), deadline=None)
@given(
    n_atoms=st.sampled_from([1, 2, 16, 33, 256, 257, 1024]),
    keep=st.integers(1, 40),
    kind=st.sampled_from(["ties", "sparse", "zero", "large", "small"]),
    seed=st.integers(0, 2**31),
)
def test_the_largest_sums_are_kept(n_atoms, keep, kind, seed):
    """One region each, so that the sums are the codes themselves, to the last bit: ties go by index."""
    generator = torch.Generator().manual_seed(seed)
    arguments = random_vote(Sizes(50, 1, 1, n_atoms, 1), seed)
    rows = torch.rand(50, n_atoms, generator=generator)
    if kind == "ties":
        rows = torch.randint(0, 3, rows.shape, generator=generator).float()
    elif kind == "sparse":
        rows *= torch.rand(rows.shape, generator=generator) < 0.1
    elif kind == "zero":
        rows *= 0
    elif kind in ("large", "small"):
        rows *= 1e30 if kind == "large" else 1e-30
    atoms = torch.arange(n_atoms).expand(50, n_atoms)
    dtype = torch.uint8 if n_atoms <= 256 else torch.uint16
    (view,) = arguments["views"]
    entries = replace(
        view.entries,
        starts=np.array([0, 50], np.uint32),
        places=np.arange(50, dtype=np.uint8),
        combinations=np.arange(50, dtype=np.uint16),
        weights=np.ones(50, np.float32),
    )
    arguments["views"] = [replace(view, entries=entries, regions=np.arange(50)[:, None])]
    arguments["codes"] = [SparseCodes(atoms.to(dtype).contiguous(), rows, n_atoms)]
    indices, weights = NativeVote(**arguments, device=CPU).round(keep, None, False, range(1))
    expected = SparseCodes.from_dense(rows, keep)
    assert indices.dtype == expected.indices.dtype
    assert torch.equal(indices[:, 0].int(), expected.indices.int())
    assert torch.equal(weights[:, 0] > 0, expected.weights > 0)
    # A total of terms is rounded once less than there are, in whatever order; the quotient once more.
    assert torch.allclose(weights[:, 0], expected.weights, rtol=1e-6, atol=0)


@needs_native
@pytest.mark.parametrize("backend", [NativeVote, ReferenceVote])
@pytest.mark.parametrize("why", damaged(random_vote(Sizes(), 2)))
def test_damaged_sums_are_refused(why, backend):
    arguments = damaged(random_vote(Sizes(), 2))[why]
    with refuses():
        backend(**arguments, device=CPU).round(4, None, False, buckets_of(arguments))


@needs_native
def test_an_earlier_round_that_does_not_fit_is_refused():
    arguments = random_vote(Sizes(), 2)
    prepared, buckets = NativeVote(**arguments, device=CPU), buckets_of(arguments)
    good = earlier_of(arguments, 4, 3)
    beyond_the_codebook = good.indices.clone()
    beyond_the_codebook[7, 0, 0] = 24
    for bad in (
        replace(good, indices=beyond_the_codebook),
        replace(good, indices=good.indices[1:]),
        replace(good, weights=good.weights[:, :, :2]),
        EarlierRound(good.indices, good.weights, good.sharpness[:2]),
    ):
        with pytest.raises(InputError):
            prepared.round(4, bad, False, buckets)
        with pytest.raises(InputError):
            prepared.deviations(bad, buckets)


@needs_native
@pytest.mark.parametrize("backend", [NativeVote, ReferenceVote])
def test_codes_beyond_the_codebook_are_refused(backend):
    arguments = random_vote(Sizes(), 2)
    arguments["codes"][0].indices[2, 0] = 24
    with refuses():
        backend(**arguments, device=CPU)
