"""The vote by the compiled core against the reference, over random region sums; and its rounds, worked out by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from messages import refuses
from raster.parity import needs_native
from scoup.base import InputError
from scoup.raster import ViewSums, merge
from scoup.scene import SparseCodes, index_dtype
from scoup.uplift.reweighting import EarlierRound, scene_sharpness
from scoup.uplift.stored_sums import RegionSums
from scoup.uplift.vote_backends.native import Vote as NativeVote
from scoup.uplift.vote_backends.reference import Vote as ReferenceVote
from scoup.uplift.voting import vote
from support import examples, threads_of_torch, unit
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
    earlier, prepared = earlier_of(arguments, 4), backend(**arguments, device=CPU)
    for nothing in (range(0), range(2, 2)):
        indices, weights = prepared.round(4, earlier, True, nothing)
        assert indices.shape == weights.shape == (0, 3, 4)
        assert [len(of_level) for of_level in prepared.deviations(earlier, nothing)] == [0, 0, 0]


@needs_native
@pytest.mark.usefixtures("instruction_set")
@pytest.mark.parametrize(
    ("n_atoms", "k", "keep"), [(24, 4, 4), (24, 4, 24), (300, 4, 300), (24, 1, 1), (600, 1, 1)]
)
def test_every_instruction_set_agrees_also_where_all_or_one_is_kept(n_atoms, k, keep):
    check_rounds(NativeVote, Sizes(n_gaussians=7200 // n_atoms, n_atoms=n_atoms, k=k), keep, 7)


@needs_native
def test_same_bytes_on_any_number_of_threads_and_share_of_the_buckets():
    arguments = random_vote(Sizes(5000, 6, 3, 48, 4, 20_000), 5)
    earlier, buckets = earlier_of(arguments, 4), buckets_of(arguments)
    expected = None
    for threads in (1, 2, 3, 5):
        with threads_of_torch(threads):
            prepared = NativeVote(**arguments, device=CPU)
            found = *prepared.round(4, earlier, False, buckets), *prepared.deviations(earlier, buckets)
            shares = buckets[:3], buckets[3:4], buckets[4:]
            parts = [prepared.round(4, earlier, False, some) for some in shares]
        expected = expected or found
        assert all(torch.equal(one, other) for one, other in zip(found, expected, strict=True))
        assert torch.equal(torch.cat([weights for _, weights in parts]), expected[1])


@needs_native
@pytest.mark.parametrize("n_atoms", [24, 600])
def test_of_equal_sums_of_regions_of_one_atom_the_first_is_kept(n_atoms):
    arguments = random_vote(Sizes(n_atoms=n_atoms, k=1), 11)
    arguments["views"] = [
        replace(view, entries=replace(view.entries, weights=np.ones_like(view.entries.weights)))
        for view in arguments["views"]
    ]
    found, expected = (
        backend(**arguments, device=CPU).round(1, None, False, buckets_of(arguments))
        for backend in (NativeVote, ReferenceVote)
    )
    for one, other in zip(found, expected, strict=True):
        assert torch.equal(one, other)


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
    else:
        rows *= {"zero": 0.0, "large": 1e30, "small": 1e-30}[kind]
    atoms = torch.arange(n_atoms).expand(50, n_atoms).to(index_dtype(n_atoms)).contiguous()
    (view,) = arguments["views"]
    entries = replace(
        view.entries,
        starts=np.array([0, 50], np.uint32),
        places=np.arange(50, dtype=np.uint8),
        combinations=np.arange(50, dtype=np.uint16),
        weights=np.ones(50, np.float32),
    )
    arguments["views"] = [replace(view, entries=entries, regions=np.arange(50)[:, None])]
    arguments["codes"] = [SparseCodes(atoms, rows, n_atoms)]
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
    good = earlier_of(arguments, 4)
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


# Rounds: regions count by their agreement with what the round before has found.


on_every_backend = pytest.mark.parametrize("backend", ["native", "reference"])


def codes_of(dense: Tensor, k: int = 3) -> SparseCodes:
    return SparseCodes.from_dense(dense, k)


def sums_of(weights: Tensor) -> RegionSums:
    """One level, one view: what each Gaussian contributes to each region [N, R]."""
    count, regions = weights.shape
    sums = RegionSums("", torch.arange(count), ["m"])
    gaussian, region = weights.nonzero(as_tuple=True)
    table = torch.arange(regions, dtype=torch.int32)[:, None]
    sums.append("v", ViewSums(*merge(gaussian, region, weights[gaussian, region], regions), table))
    sums.rows = [{"v": slice(0, regions)}]
    return sums


@on_every_backend
@pytest.mark.parametrize("rounds", [1, 2, 3])
def test_rounds_are_what_the_equations_say(backend, rounds):
    """Worked out Gaussian by Gaussian in float64."""
    generator = torch.Generator().manual_seed(3)
    n, regions, atoms = 300, 12, 9
    codebook = torch.randn(1, atoms, 6, generator=generator)
    dense = torch.rand(regions, atoms, generator=generator)
    dense[::5] = 0
    codes = codes_of(dense)
    weight = torch.rand(n, regions, generator=generator)
    weight[torch.rand(n, regions, generator=generator) < 0.6] = 0
    found = vote(sums_of(weight), [codes], codebook, rounds, 4, backend=backend)
    W, C, sharpness = codes.to_dense().double(), codebook[0].double(), None
    expected = codes_of((weight.double() @ W).float(), 4)
    for _ in range(1, rounds):
        before = expected.to_dense().double()
        cosines = unit(before @ C) @ unit(W @ C).T
        cosines[~before.any(1)] = 1
        if sharpness is None:
            sharpness = 3 / (1 - cosines)[weight > 0].median().clamp(min=1e-3)
        factors = torch.exp(sharpness * (cosines - 1).clamp(max=0)).clamp(min=1e-6)
        expected = codes_of(((weight.double() * factors) @ W).float(), 4)
    assert (found.sharpness is None) == (sharpness is None)
    if found.sharpness is not None and sharpness is not None:
        assert float(found.sharpness[0]) == pytest.approx(float(sharpness), rel=1e-4)
    assert torch.equal(found.indices[:, 0], expected.indices)
    torch.testing.assert_close(found.weights[:, 0], expected.weights, atol=1e-4, rtol=0)


@on_every_backend
def test_a_gaussian_keeps_a_code_however_odd_its_regions_are(backend):
    """No region agrees with the mixture that the first round hands on, and yet nobody ends without a code."""
    codebook = torch.eye(8)[None]
    sums = sums_of(torch.stack([torch.arange(1.0, 9), torch.eye(8)[0]]))
    found = vote(sums, [codes_of(torch.eye(8), 1)], codebook, 3, 1, backend=backend)
    assert found.weights[:, 0].tolist() == [[1.0], [1.0]]
    assert found.indices[:, 0].tolist() == [[7], [0]]


def test_sharpness_is_set_by_the_usual_deviation():
    found = scene_sharpness([torch.tensor([0.1, 0.2, 0.9]), torch.zeros(0), torch.zeros(5)])
    assert found.tolist() == pytest.approx([3 / 0.2, 3, 3 / 1e-3])


@on_every_backend
def test_what_does_not_fit_is_refused(backend):
    codebook = torch.eye(4)[None]
    codes = [codes_of(torch.eye(4), 1)]
    sums = sums_of(torch.eye(4)[3:])
    for changes in ({"rounds": 0}, {"keep": 0}, {"codes": codes * 2}, {"codebook": torch.eye(5)[None]}):
        given = {"codes": codes, "codebook": codebook, "rounds": 1, "keep": 1, **changes}
        with refuses():
            vote(sums, backend=backend, **given)
    of_three = sums.select(["v"], [{"v": slice(0, 3)}])
    with refuses():
        vote(of_three, [codes_of(torch.eye(4)[:3], 1)], codebook, backend=backend)
    with refuses():
        sums.select(["w"], [{"w": slice(0, 4)}])
    for rows in ([{"w": slice(0, 4)}], None):
        sums.rows = rows
        with refuses():
            vote(sums, codes, codebook, backend=backend)
