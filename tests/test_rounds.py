"""Rounds of the vote: regions count by their agreement with what the round before has found."""

from __future__ import annotations

import dataclasses

import pytest
import torch
from torch import Tensor

import scoup
from scoup import raster
from scoup.agreement import LEAST_AGREEMENT, Agreement
from scoup.codes import SparseCodes
from scoup.errors import InputError, UnknownNameError
from scoup.pipeline import BUILD_PRESETS, BuildSettings, build, build_settings
from scoup.rounds import SAMPLED_VIEWS, SHARPNESS, accumulate, outcome, sharpness_of, spread
from scoup.uplifting import RegionSums, ViewSums, region_sums, top_k, uplift
from support import make_camera, random_gaussians, small_scene

SMALL = BuildSettings(n_atoms=8, k=3, rounds=2)


def codes_of(dense: Tensor, k: int = 3) -> SparseCodes:
    return SparseCodes.from_dense(dense, k)


def random_problem(seed: int, n_gaussians: int = 20, n_regions: int = 12, n_atoms: int = 9):
    """Codes, codebook and an agreement of two levels, some Gaussians and regions without a code."""
    generator = torch.Generator().manual_seed(seed)
    codebook = torch.randn(2, n_atoms, 6, generator=generator)
    codes = []
    for _ in range(2):
        dense = torch.rand(n_regions, n_atoms, generator=generator)
        dense[::5] = 0
        codes.append(codes_of(dense))
    voted = torch.rand(n_gaussians, 2, n_atoms, generator=generator)
    voted[::4, 0] = 0
    sharpness = torch.tensor([3.0, 20.0])
    indices, weights = top_k(voted, 4)
    return codes, codebook, Agreement.with_codes(indices, weights, codebook, sharpness), voted


@pytest.mark.parametrize("seed", range(5))
def test_factors_are_those_of_the_decoded_codes(seed):
    codes, codebook, agreement, voted = random_problem(seed)
    gaussian = torch.arange(20).repeat_interleave(24)
    key = torch.arange(24).repeat(20)  # 12 regions at two levels
    found = agreement.factors(gaussian, key, 12, codes)
    for i, r, factor in zip(gaussian.tolist(), key.tolist(), found.tolist(), strict=True):
        level, region = divmod(r, 12)
        kept = codes_of(voted[i, level][None], 4).to_dense()[0]
        own, theirs = kept @ codebook[level], codes[level].to_dense()[region] @ codebook[level]
        if not kept.any():
            assert factor == 1
            continue
        cosine = float(torch.nn.functional.cosine_similarity(own, theirs, dim=0)) if theirs.any() else 0.0
        expected = max(LEAST_AGREEMENT, float(torch.exp(agreement.sharpness[level] * (cosine - 1))))
        assert factor == pytest.approx(expected, rel=1e-4)


def sums_of(triplets: list[tuple[int, int, float]], n_gaussians: int, n_regions: int) -> RegionSums:
    """One level, one view."""
    gaussian, key, weight = zip(*triplets, strict=True)
    view = ViewSums("v", torch.tensor(gaussian), torch.tensor(key), torch.tensor(weight), n_regions)
    return RegionSums(n_gaussians, ("m",), [view], [{"v": slice(0, n_regions)}])


def test_a_region_that_disagrees_loses_its_say():
    """Three masks say one thing, one bleeds over from another: after a second round hardly anything of it is left."""
    codebook = torch.eye(4)[None]
    codes = [codes_of(torch.eye(4)[[0, 0, 0, 1]], 2)]
    sums = sums_of([(0, 0, 1.0), (0, 1, 1.0), (0, 2, 1.0), (0, 3, 2.0), (1, 3, 1.0)], 3, 4)
    once, twice = (accumulate(sums, codes, codebook, rounds, keep=2) for rounds in (1, 2))
    assert once[0, 0].tolist() == [3, 2, 0, 0]
    share = twice[0, 0, 1] / twice[0, 0].sum()
    assert share < 0.3 < 2 / 5
    assert twice[1, 0, 1] > 0  # what only one region paints keeps its code
    assert not twice[2].any()
    thrice = accumulate(sums, codes, codebook, 3, keep=2)
    assert thrice[0, 0, 1] / thrice[0, 0].sum() < share


def test_a_gaussian_keeps_a_code_however_odd_its_regions_are():
    codebook = torch.eye(4)[None]
    codes = [codes_of(torch.eye(4), 1)]
    agreement = Agreement.with_codes(
        torch.zeros(1, 1, 1, dtype=torch.uint8), torch.ones(1, 1, 1), codebook, torch.tensor([1e6])
    )
    out = uplift(sums_of([(0, 2, 1.0)], 1, 4), codes, agreement)
    assert out[0, 0, 2] == pytest.approx(LEAST_AGREEMENT)
    indices, weights = top_k(out, 1)
    assert (int(indices), float(weights)) == (2, 1.0)


def test_sharpness_is_set_by_the_usual_deviation():
    codes, codebook, agreement, _ = random_problem(1)
    view = ViewSums(
        "v", torch.arange(20).repeat(12), torch.arange(12).repeat_interleave(20), torch.ones(240), 12
    )
    found = sharpness_of(agreement, [view], lambda _: codes)
    table = agreement.region_cosines(codes)[0]
    deviations = 1 - agreement.cosines(0, view.gaussian, view.key, table)
    assert float(found[0]) == pytest.approx(SHARPNESS / float(deviations.median()), rel=1e-6)
    assert found[1] == SHARPNESS  # a level that no view shows
    # Where nothing deviates it stays finite.
    same = outcome(codes[0].to_dense()[1].repeat(20, 2, 1), codebook, 3, torch.zeros(2))
    alone = ViewSums("v", torch.arange(20), torch.ones(20, dtype=torch.long), torch.ones(20), 12)
    assert torch.isfinite(sharpness_of(same, [alone], lambda _: codes)).all()


def test_sampled_views_are_spread():
    assert spread(range(3)) == [0, 1, 2]
    assert len(spread(range(200))) == SAMPLED_VIEWS
    assert spread(range(16)) == [1, 3, 5, 7, 9, 11, 13, 15]


@pytest.fixture(scope="module")
def scene():
    return small_scene()


def test_build_from_region_sums_votes_as_accumulate_does(scene):
    gaussians, cameras, regions = scene
    sums = region_sums(gaussians, cameras, regions)
    for rounds in (1, 2, 3):
        settings = dataclasses.replace(SMALL, rounds=rounds)
        field = build(*scene, settings=settings, sums=sums, keep_accumulators=True)
        books = [scoup.fit_codes(regions.embeddings(level)[0], 8, 3) for level in regions.levels]
        codebook = torch.stack([book.atoms for book in books])
        expected = accumulate(sums, [book.codes for book in books], codebook, rounds, keep=3)
        assert field.accumulators is not None
        torch.testing.assert_close(field.accumulators, expected)
        assert ("sharpness" in field.info.provenance) == (rounds > 1)


@pytest.mark.parametrize("backend", ["reference", None])
def test_later_rounds_only_take_away(scene, backend):
    gaussians, cameras, regions = scene
    streamed, once = (
        build(
            *scene,
            settings=dataclasses.replace(SMALL, rounds=rounds),
            keep_accumulators=True,
            backend=backend,
        )
        for rounds in (2, 1)
    )
    assert streamed.accumulators is not None
    assert once.accumulators is not None
    painted = once.accumulators.any(2)
    assert bool((streamed.accumulators.any(2) == painted).all())  # nobody loses its code
    assert bool(
        (streamed.accumulators <= once.accumulators * (1 + 1e-5) + 1e-6).all()
    )  # regions count at most in full
    assert not torch.allclose(streamed.accumulators, once.accumulators)
    kept = build(
        *scene,
        settings=SMALL,
        keep_accumulators=True,
        sums=region_sums(gaussians, cameras, regions, backend=backend),
    )
    torch.testing.assert_close(kept.accumulators, streamed.accumulators)


def test_the_same_bytes_for_any_number_of_threads(scene, tmp_path):
    before = torch.get_num_threads()
    try:
        for threads in (1, 2, 3):
            torch.set_num_threads(threads)
            build(*scene, settings=SMALL).save(tmp_path / f"{threads}.scoup")
    finally:
        torch.set_num_threads(before)
    assert len({path.read_bytes() for path in tmp_path.iterdir()}) == 1


@pytest.mark.filterwarnings("ignore:.*badly explained")  # its regions are random
def test_a_view_added_later_must_agree_too(scene):
    gaussians, cameras, regions = scene
    field = build(gaussians, cameras[:3], regions, settings=SMALL, keep_accumulators=True)
    grown = field.update(cameras[3], regions)
    lenient = dataclasses.replace(
        field.info,
        provenance={key: value for key, value in field.info.provenance.items() if key != "sharpness"},
    )
    field.info = lenient
    in_full = field.update(cameras[3], regions)
    assert grown.accumulators is not None
    assert in_full.accumulators is not None
    assert bool((grown.accumulators <= in_full.accumulators * (1 + 1e-5) + 1e-6).all())
    assert not torch.allclose(grown.accumulators, in_full.accumulators)


def test_presets():
    assert BUILD_PRESETS["default"] == BuildSettings()
    paper = BUILD_PRESETS["paper"]
    assert (paper.n_atoms, paper.k, paper.keep, paper.solver, paper.epochs) == (64, 4, 4, "adam", 4000)
    assert (paper.rounds, paper.consensus) == (1, False)
    assert build_settings("paper", k=2).keep == 2
    assert build_settings("paper", k=2, keep=0).keep == 0
    assert build_settings(seed=3) == BuildSettings(seed=3)
    with pytest.raises(UnknownNameError, match="paper"):
        build_settings("papers")
    with pytest.raises(InputError, match="at least one round"):
        BuildSettings(rounds=0)


def test_what_does_not_fit_is_refused():
    codes, _, agreement, _ = random_problem(0)
    with pytest.raises(InputError, match="do not fit an earlier round"):
        raster.Uplift(torch.zeros(20, 2, 8), agreement=agreement)
    with pytest.raises(InputError, match="the earlier round had 9"):
        agreement.region_cosines([codes_of(torch.rand(3, 5)) for _ in range(2)])
    with pytest.raises(InputError, match="2 levels"):
        Agreement(agreement.indices, agreement.weights, agreement.grams[:1], agreement.sharpness)
    with pytest.raises(InputError, match="uint8"):
        Agreement(agreement.indices.int(), agreement.weights, agreement.grams, agreement.sharpness)
    view = raster.look(random_gaussians(20, 0), make_camera(8, 6))
    uplift_of = raster.Uplift(torch.zeros(20, 2, 9), view.backend, agreement)
    with pytest.raises(InputError, match="no code"):
        uplift_of.add(view, torch.full((2, 6, 8), 30, dtype=torch.int32), codes)
