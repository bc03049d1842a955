"""Rounds of the vote: regions count by their agreement with what the round before has found."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from messages import refuses
from scoup.scene import SparseCodes
from scoup.uplift.reweighting import scene_sharpness
from scoup.uplift.stored_sums import RegionSums
from scoup.uplift.voting import vote
from uplift.random_votes import sums_of_triplets

pytestmark = pytest.mark.parametrize("backend", ["native", "reference"])


def codes_of(dense: Tensor, k: int = 3) -> SparseCodes:
    return SparseCodes.from_dense(dense, k)


def sums_of(triplets: list[tuple[int, int, float]], n_gaussians: int, n_regions: int) -> RegionSums:
    """One level, one view: (Gaussian, region, weight)."""
    gaussian, region, weight = zip(*triplets, strict=True)
    sums = RegionSums("", torch.arange(n_gaussians), ["m"])
    level = torch.zeros(len(gaussian), dtype=torch.int64)
    view = sums_of_triplets(torch.tensor(gaussian), level, torch.tensor(region), torch.tensor(weight), 1)
    sums.append("v", view)
    sums.rows = [{"v": slice(0, n_regions)}]
    return sums


def test_a_region_that_disagrees_loses_its_say(backend):
    """Three masks say one thing, one bleeds over from another: after a second round hardly anything of it is left."""
    codebook = torch.eye(4)[None]
    codes = [codes_of(torch.eye(4)[[0, 0, 0, 1]], 2)]
    sums = sums_of([(0, 0, 1.0), (0, 1, 1.0), (0, 2, 1.0), (0, 3, 2.0), (1, 3, 1.0)], 3, 4)
    once, twice, thrice = (vote(sums, codes, codebook, rounds, 2, backend=backend) for rounds in (1, 2, 3))
    assert once.weights[0, 0].tolist() == pytest.approx([3 / 5, 2 / 5])
    assert once.indices[0, 0].tolist() == [0, 1]
    assert once.sharpness is None
    assert twice.sharpness is not None
    share = float(twice.weights[0, 0, 1])
    assert share < 0.3 < 2 / 5
    assert twice.weights[1, 0].tolist() == [1, 0]  # what only one region paints keeps its code
    assert not twice.weights[2].any()
    assert float(thrice.weights[0, 0, 1]) < share


def test_the_second_round_is_what_the_equations_say(backend):
    """Worked out Gaussian by Gaussian in float64."""
    generator = torch.Generator().manual_seed(3)
    n, regions, atoms = 300, 12, 9
    codebook = torch.randn(1, atoms, 6, generator=generator)
    dense = torch.rand(regions, atoms, generator=generator)
    dense[::5] = 0
    codes = codes_of(dense)
    weight = torch.rand(n, regions, generator=generator)
    weight[torch.rand(n, regions, generator=generator) < 0.6] = 0
    at = weight.nonzero()
    triplets = [(int(i), int(r), float(weight[i, r])) for i, r in at]
    found = vote(sums_of(triplets, n, regions), [codes], codebook, 2, 4, backend=backend)
    W, C = codes.to_dense().double(), codebook[0].double()
    first = codes_of((weight.double() @ W).float(), 4).to_dense().double()
    cosines = torch.nn.functional.normalize(first @ C, dim=1) @ torch.nn.functional.normalize(W @ C, dim=1).T
    cosines[~first.any(1)] = 1
    deviations = (1 - cosines)[weight > 0]
    sharpness = 3 / deviations.median().clamp(min=1e-3)
    assert found.sharpness is not None
    assert float(found.sharpness[0]) == pytest.approx(float(sharpness), rel=1e-4)
    factors = torch.exp(sharpness * (cosines - 1).clamp(max=0)).clamp(min=1e-6)
    expected = codes_of(((weight.double() * factors) @ W).float(), 4)
    assert torch.equal(found.indices[:, 0], expected.indices)
    torch.testing.assert_close(found.weights[:, 0], expected.weights, atol=1e-4, rtol=0)


def test_a_gaussian_keeps_a_code_however_odd_its_regions_are(backend):
    """No region agrees with the mixture that the first round hands on, and yet nobody ends without a code."""
    codebook = torch.eye(8)[None]
    sums = sums_of([(0, r, 1.0 + r) for r in range(8)] + [(1, 0, 1.0)] * 1, 2, 8)
    found = vote(sums, [codes_of(torch.eye(8), 1)], codebook, 3, 1, backend=backend)
    assert found.weights[:, 0].tolist() == [[1.0], [1.0]]
    assert found.indices[:, 0].tolist() == [[7], [0]]


def test_sharpness_is_set_by_the_usual_deviation(backend):
    found = scene_sharpness([torch.tensor([0.1, 0.2, 0.9]), torch.zeros(0), torch.zeros(5)])
    assert found.tolist() == pytest.approx([3 / 0.2, 3, 3 / 1e-3])


def test_what_does_not_fit_is_refused(backend):
    codebook = torch.eye(4)[None]
    codes = [codes_of(torch.eye(4), 1)]
    sums = sums_of([(0, 3, 1.0)], 1, 4)
    for changes in ({"rounds": 0}, {"keep": 0}, {"codes": codes * 2}, {"codebook": torch.eye(5)[None]}):
        given = {"codes": codes, "codebook": codebook, "rounds": 1, "keep": 1, **changes}
        with refuses():
            vote(sums, backend=backend, **given)
    of_three = sums.select(["v"], [{"v": slice(0, 3)}])
    with refuses():
        vote(of_three, [codes_of(torch.eye(4)[:3], 1)], codebook, backend=backend)
    with refuses():
        sums.select(["w"], [{"w": slice(0, 4)}])
    sums.rows = [{"w": slice(0, 4)}]
    with refuses():
        vote(sums, codes, codebook, backend=backend)
    sums.rows = None
    with refuses():
        vote(sums, codes, codebook, backend=backend)
