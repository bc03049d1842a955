"""Selections grown, shrunk, made whole, against literal loops."""

from __future__ import annotations

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from messages import refuses
from scoup.query.select import Reshaping, reshaped
from scoup.scene.gaussians import Gaussians
from scoup.scene.neighbours import LONGEST_LINK, NEIGHBOURS
from support import examples, gaussians_at, random_gaussians


def literal(points: np.ndarray, inside: list[bool], wanted: Reshaping) -> list[bool]:
    """Shrink, grow and within, one Gaussian at a time."""
    count = len(points)
    distances = np.linalg.norm(points[:, None] - points[None], axis=2)
    near = [sorted(range(count), key=lambda j: distances[i, j])[: NEIGHBOURS + 1] for i in range(count)]
    usual = np.median([distances[i, near[i][-1]] for i in range(count) if inside[i]]) if any(inside) else 0
    links = [[j for j in near[i] if distances[i, j] <= LONGEST_LINK * usual] for i in range(count)]
    for _ in range(wanted.shrink):
        inside = [inside[i] and all(inside[j] for j in links[i]) for i in range(count)]
    for _ in range(wanted.grow):
        inside = [any(inside[j] for j in links[i]) or inside[i] for i in range(count)]
    if wanted.within and any(inside):
        chosen = [j for j in range(count) if inside[j]]
        inside = [bool(distances[i, chosen].min() <= wanted.within) for i in range(count)]
    return inside


@settings(max_examples=examples(40))
@given(
    st.integers(2, 60),
    st.integers(0, 3),
    st.integers(0, 3),
    st.sampled_from([0.0, 0.4]),
    st.integers(0, 2**31),
)
def test_reshaped_equals_loops(count: int, shrink: int, grow: int, within: float, seed: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    means = torch.randn(count, 3, generator=generator)
    mask = torch.rand(count, generator=generator) < 0.6
    wanted = Reshaping(shrink=shrink, grow=grow, within=within)
    found = reshaped(gaussians_at(means), mask, torch.ones(count), wanted)
    assert found.tolist() == literal(means.double().numpy(), mask.tolist(), wanted)


def test_the_largest_part_is_the_one_that_weighs_most() -> None:
    generator = torch.Generator().manual_seed(0)
    clumps = [torch.rand(40, 3, generator=generator), torch.rand(30, 3, generator=generator) + 20]
    gaussians = gaussians_at(torch.cat(clumps))
    mask, first = torch.ones(70, dtype=torch.bool), torch.arange(70) < 40
    assert reshaped(gaussians, mask, torch.ones(70), Reshaping(largest=True)).equal(first)
    heavier = torch.where(first, 0.5, 1.0)
    assert reshaped(gaussians, mask, heavier, Reshaping(largest=True)).equal(~first)


def test_growing_does_not_leap() -> None:
    """A lone Gaussian far away has nearest neighbours inside, but is none of them."""
    means = torch.cat(
        [torch.rand(50, 3, generator=torch.Generator().manual_seed(1)), torch.full((1, 3), 40.0)]
    )
    mask = torch.arange(51) < 25
    grown = reshaped(gaussians_at(means), mask, torch.ones(51), Reshaping(grow=5))
    assert grown[:50].all()
    assert not grown[50]


def test_ugly_gaussians_are_left_out() -> None:
    gaussians = random_gaussians(30, seed=2)
    means = gaussians.means.clone()
    means[3], means[4] = torch.nan, torch.inf
    ugly = Gaussians(means, gaussians.quats, gaussians.scales, gaussians.opacities, gaussians.sh)
    mask = torch.ones(30, dtype=torch.bool)
    for wanted in (Reshaping(grow=1), Reshaping(shrink=1), Reshaping(largest=True), Reshaping(within=100.0)):
        found = reshaped(ugly, mask, torch.full((30,), torch.nan), wanted)
        assert not found[3:5].any()
    assert not reshaped(ugly, ~mask, torch.ones(30), Reshaping(True, 1, 1, 1.0)).any()


def test_numbers_out_of_range_are_refused() -> None:
    for number in (-1, 1001, -0.1, float("nan"), float("inf")):
        for name in ("grow", "shrink", "within"):
            if name != "within" or number != 1001:
                with refuses():
                    Reshaping(**{name: number})  # pyright: ignore[reportArgumentType]
