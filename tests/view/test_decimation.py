"""Fewer Gaussians for a page: neighbours are merged."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from scoup import raster
from scoup.scene import SH_C0, Camera, Gaussians, rotation_matrices
from scoup.view.decimation import decimate
from support import KINDS, examples, random_gaussians


def cluster(count: int, seed: int, spread: float = 0.01) -> Gaussians:
    """Small Gaussians of one colour near the origin, and four far corners that make the grid coarse."""
    generator = torch.Generator().manual_seed(seed)
    corners = torch.tensor([[0.0, 0, 0], [8, 0, 0], [0, 8, 0], [0, 0, 8]])
    means = torch.cat([4.1 + spread * torch.rand(count, 3, generator=generator), corners])
    quats = torch.nn.functional.normalize(torch.randn(len(means), 4, generator=generator), dim=1)
    scales = 0.002 + 0.004 * torch.rand(len(means), 3, generator=generator)
    opacities = 0.2 + 0.7 * torch.rand(len(means), generator=generator)
    colors = torch.tensor([0.5, 0.5, 0.5]).expand(len(means), 1, 3) + 0.01 * means[:, None]
    return Gaussians(means, quats, scales, opacities, (colors - 0.5) / SH_C0)


def moments(gaussians: Gaussians) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Cover [N], mean and covariance of all of them together, by the formula."""
    cover = gaussians.opacities.double() * gaussians.scales.double().sort(1).values[:, 1:].prod(1)
    share = cover / cover.sum()
    means = gaussians.means.double()
    mean = (share[:, None] * means).sum(0)
    covariance = torch.zeros(3, 3, dtype=torch.float64)
    for row in range(len(gaussians)):
        axes = rotation_matrices(gaussians.quats[row : row + 1].double())[0] * gaussians.scales[row].double()
        aside = (means[row] - mean)[:, None]
        covariance += share[row] * (axes @ axes.T + aside @ aside.T)
    return cover, mean, covariance


def test_what_fits_is_shown_as_it_is() -> None:
    gaussians = random_gaussians(100, 0)
    shown = decimate(gaussians, 100)
    assert shown.rows.sort().values.tolist() == list(range(100))
    assert shown.gaussians.scales.equal(gaussians.scales[shown.rows])
    assert shown.gaussians.opacities.equal(gaussians.opacities[shown.rows])
    assert shown.gaussians.sh.equal(gaussians.sh[shown.rows, :1])


def test_a_merged_gaussian_has_the_moments_of_its_members() -> None:
    gaussians = cluster(20, 1)
    shown = decimate(gaussians, 5)
    assert len(shown.rows) == 5
    merged = int(((shown.gaussians.means - 4.1).abs().amax(1) < 0.1).nonzero())
    members = gaussians.select(slice(0, 20))
    cover, mean, covariance = moments(members)
    own = shown.gaussians.select(slice(merged, merged + 1))
    _, own_mean, own_covariance = moments(own)
    torch.testing.assert_close(own_mean, mean, atol=1e-6, rtol=0)
    torch.testing.assert_close(own_covariance, covariance, atol=1e-9, rtol=1e-4)
    assert shown.rows[merged] == cover.argmax()
    area = own.scales.double().sort(1).values[0, 1:].prod()
    assert float(own.opacities) == pytest.approx(min(0.99, float(cover.sum() / area)), rel=1e-5)
    color = (cover[:, None] * members.sh[:, 0]).sum(0) / cover.sum()
    torch.testing.assert_close(own.sh[0, 0].double(), color, atol=1e-5, rtol=0)


def test_large_ones_and_other_colours_are_not_merged() -> None:
    gaussians = cluster(20, 2)
    gaussians.scales[3] = 3.0
    gaussians.sh[7] = -0.5 / SH_C0  # black
    shown = decimate(gaussians, 7)
    assert {3, 7} <= set(shown.rows.tolist())
    for row in (3, 7):
        place = int((shown.rows == row).nonzero())
        assert shown.gaussians.means[place].equal(gaussians.means[row])
        assert shown.gaussians.scales[place].equal(gaussians.scales[row])


def test_different_things_are_not_merged() -> None:
    gaussians = cluster(20, 3)
    owners = torch.arange(24) % 2
    shown = decimate(gaussians, 6, owners)
    near = (shown.gaussians.means - 4.1).abs().amax(1) < 0.1
    assert sorted(owners[shown.rows[near]].tolist()) == [0, 1]
    assert int((decimate(gaussians, 5).gaussians.means - 4.1).abs().amax(1).lt(0.1).sum()) == 1


@settings(max_examples=examples(30), deadline=None)
@given(st.integers(0, 60), st.integers(0, 2**31), st.integers(1, 50))
def test_any_gaussians(count: int, seed: int, most: int) -> None:
    gaussians = random_gaussians(count, seed, kinds=KINDS)
    drawable = gaussians.finite() & (gaussians.opacities > 0) & gaussians.quats.any(1)
    shown = decimate(gaussians, most)
    assert len(shown.gaussians) == len(shown.rows) <= most
    assert (len(shown.rows) > 0) == bool(drawable.any())
    assert drawable[shown.rows].all()
    assert len(set(shown.rows.tolist())) == len(shown.rows)
    assert shown.gaussians.finite().all()
    again = decimate(gaussians, most)
    assert again.rows.equal(shown.rows)
    assert again.gaussians.means.equal(shown.gaussians.means)


def test_the_picture_is_nearer_than_without_the_smallest() -> None:
    """On a wall of small discs: leaving most of them out leaves holes."""
    generator = torch.Generator().manual_seed(0)
    count = 4000
    means = torch.cat([torch.rand(count, 2, generator=generator), torch.zeros(count, 1)], 1)
    quats = torch.tensor([1.0, 0, 0, 0]).expand(count, 4).clone()
    scales = torch.tensor([0.008, 0.008, 1e-4]) * (0.5 + torch.rand(count, 1, generator=generator))
    sh = (torch.cat([means[:, :2], means[:, :1]], 1)[:, None] - 0.5) / SH_C0
    gaussians = Gaussians(means, quats, scales, torch.full((count,), 0.8), sh)
    camera = Camera.look_at((0.5, 0.5, -1.5), (0.5, 0.5, 0.0), "front", 96, 96, 120.0, up=(0.0, 1.0, 0.0))

    def error(some: Gaussians) -> float:
        wanted, found = (
            raster.render_colors(part, camera, raster.project(part, camera)) for part in (gaussians, some)
        )
        return float((wanted - found).square().mean())

    cover = gaussians.opacities * gaussians.scales[:, :2].prod(1)
    largest = gaussians.select(cover.argsort(descending=True)[: count // 10])
    assert error(decimate(gaussians, count // 10).gaussians) < 0.3 * error(largest)
