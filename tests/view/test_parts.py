"""Large scenes: fewer Gaussians, which stand for neighbours, and in parts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from view_samples import (
    field_with_things,
    random_field,
    shown_relevancy,
    splat_of,
    table,
    unpacked,
    viewed_field,
)

from messages import refuses
from scoup import raster
from scoup.query import LanguageField
from scoup.scene import SH_C0, Camera, Gaussians, rotation_matrices
from scoup.view import parts
from scoup.view.decimation import cover, decimate, drawable
from scoup.view.parts import Parts
from scoup.view.viewed_field import ViewedField
from support import KINDS, examples, gaussians_at, random_gaussians

CLUSTERS = 4


@pytest.fixture(autouse=True)
def small_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parts, "PART_GAUSSIANS", 100)
    monkeypatch.setattr(parts, "COARSE_GAUSSIANS", 60)


@settings(max_examples=examples(30), deadline=None)
@given(st.integers(1, 700), st.integers(0, 2**31), st.integers(1, 900))
def test_parts_together_are_the_scene(count: int, seed: int, most: int) -> None:
    gaussians = random_gaussians(count, seed, kinds=KINDS)
    cut = Parts(gaussians, most)
    assert 1 <= len(cut) <= -(-count // 100)
    shown = [cut.part(number) for number in range(len(cut))]
    rows = torch.cat([part.rows for part in shown])
    assert len(rows.unique()) == len(rows) <= most + len(cut)
    can = drawable(gaussians)
    assert can[rows].all()
    whole = [cut.part(number, whole=True) for number in range(len(cut))]
    assert sorted(torch.cat([part.rows for part in whole]).tolist()) == np.flatnonzero(can).tolist()
    for part, own in zip(shown, whole, strict=True):
        assert own.gaussians.means.equal(gaussians.means[own.rows])
        assert set(part.rows.tolist()) <= set(own.rows.tolist())
        assert count > most or part.rows.equal(own.rows)
    coarse, counts = cut.coarse()
    assert len(counts) == len(cut)
    assert sum(counts) == len(coarse.rows) <= max(60, len(cut))
    starts = np.cumsum([0, *counts])
    for number, part in enumerate(shown):
        own = coarse.rows[starts[number] : starts[number + 1]]
        if count <= most:
            assert set(own.tolist()) <= set(part.rows.tolist())
        assert bool(counts[number]) == bool(len(part.rows))


def test_parts_are_of_about_the_same_number_and_near_their_place() -> None:
    gaussians = random_gaussians(1000, 3)
    cut, merged = Parts(gaussians, 1000), Parts(gaussians, 500)
    shown = [cut.part(number) for number in range(len(cut))]
    assert [len(part.rows) for part in shown] == [100] * 10
    spread = gaussians.means.var(0).sum()
    assert torch.stack([part.gaussians.means.var(0).sum() for part in shown]).mean() < 0.7 * spread
    assert len(merged) == 10
    assert all(40 < len(merged.part(number).rows) <= 50 for number in range(10))
    gaussians.opacities[:] = 0  # nothing can be drawn
    nothing = Parts(gaussians, 300)
    assert (len(nothing), len(nothing.part(0).rows), nothing.coarse()[1]) == (1, 0, [0])


def test_coarse_gaussians_of_a_sample_cover_as_much(monkeypatch: pytest.MonkeyPatch) -> None:
    gaussians = random_gaussians(2000, 5)
    gaussians.scales[3] = gaussians.scales[1234] = 3.0
    wanted = Parts(gaussians, 2000).coarse()[0].gaussians
    monkeypatch.setattr(parts, "_SAMPLE", 400)
    coarse = Parts(gaussians, 2000).coarse()[0]
    assert {3, 1234} <= set(coarse.rows.tolist())  # though the sample is of every fifth
    sums = [cover(some.scales.numpy(), some.opacities.numpy()).sum() for some in (coarse.gaussians, wanted)]
    assert sums[0] == pytest.approx(sums[1], rel=0.3)
    again = Parts(gaussians, 2000).coarse()[0]
    assert again.rows.equal(coarse.rows)
    assert again.gaussians.means.equal(coarse.gaussians.means)


def clustered() -> LanguageField:
    """Gaussians in far places, all of a place with one code."""
    field, apart = random_field(400), torch.tensor([50.0, -50, 25])
    place = torch.arange(400) % CLUSTERS
    field.gaussians.means[:] = 0.1 * field.gaussians.means + place[:, None] * apart
    field.gaussians.scales.clamp_(max=0.01)
    field.code_indices[:] = (place % 9)[:, None, None].to(field.code_indices.dtype)
    field.code_weights[:] = torch.tensor([1.0, 0, 0, 0])
    return field


def test_coarse_gaussians_answer_as_all_do() -> None:
    viewed = ViewedField(clustered().with_encoder(table()))
    first, metadata = unpacked(viewed.scene())
    assert len(metadata["parts"]) == viewed.n_parts == 4
    assert sum(metadata["parts"]) == len(first["opacities"]) <= 60

    def relevancies(tensors: dict[str, np.ndarray], own: dict, scores: np.ndarray) -> dict[int, set[float]]:
        """By the place of the Gaussians."""
        found = shown_relevancy(tensors, own, first["canonical"], scores, 0)
        place = np.rint(splat_of(tensors, own).means[:, 0].numpy() / 50)
        return {int(each): set(found[place == each].round(5)) for each in np.unique(place)}

    for answer in viewed.answers(["thing 1", "thing 2", "thing 7"]):
        scores = answer.scores.numpy()
        wanted: dict[int, set[float]] = {}
        for number in range(viewed.n_parts):
            for place, values in relevancies(*unpacked(viewed.part(number)), scores).items():
                wanted.setdefault(place, set()).update(values)
        assert len(wanted) == CLUSTERS
        assert all(len(values) == 1 for values in wanted.values())
        assert len(set.union(*wanted.values())) > 1
        assert relevancies(first, metadata, scores) == wanted


def test_files_of_parts_have_their_own_ranges_things_and_equal_bytes() -> None:
    field = field_with_things(400)
    viewed, again = ViewedField(field.with_encoder(table())), ViewedField(field.with_encoder(table()))
    assert viewed.scene() == again.scene()
    assert field.thing_table is not None
    cut = Parts(viewed.gaussians, viewed.most, field.thing_table.owners[:, 1])
    for number in range(viewed.n_parts):
        data = viewed.part(number)
        assert again.part(number) == data
        tensors, metadata = unpacked(data)
        shown = cut.part(number)
        ranges = {f"{name}_{end}" for name in ("means", "scales") for end in ("low", "high")}
        assert set(metadata) == {"version", "weights_scale", *ranges}
        extent = float((shown.gaussians.means.amax(0) - shown.gaussians.means.amin(0)).max())
        assert (splat_of(tensors, metadata).means - shown.gaussians.means).abs().max() < 2e-7 * extent
        owners = field.thing_table.owners[shown.rows].T.numpy()
        np.testing.assert_array_equal(tensors["owners"], np.where(owners == -1, 65535, owners))
    for wrong in (-1, viewed.n_parts):
        with refuses():
            viewed.part(wrong)
    small = viewed_field(count=120)
    tensors, metadata = unpacked(small.scene())
    assert small.n_parts == 0
    assert "parts" not in metadata
    assert len(tensors["opacities"]) == 120
    assert viewed_field(count=121).n_parts == 2


# ---- Fewer Gaussians: neighbours are merged


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
    mean = share @ gaussians.means.double()
    axes = rotation_matrices(gaussians.quats.double()) * gaussians.scales.double()[:, None]
    aside = (gaussians.means.double() - mean)[:, :, None]
    return cover, mean, (share[:, None, None] * (axes @ axes.mT + aside @ aside.mT)).sum(0)


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
    # Nor are different things.
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
    scales = torch.tensor([0.008, 0.008, 1e-4]) * (0.5 + torch.rand(count, 1, generator=generator))
    sh = (means[:, None, [0, 1, 0]] - 0.5) / SH_C0
    gaussians = replace(gaussians_at(means, opacity=0.8), scales=scales, sh=sh)
    camera = Camera.look_at((0.5, 0.5, -1.5), (0.5, 0.5, 0.0), "front", 96, 96, 120.0, up=(0.0, 1.0, 0.0))

    def error(some: Gaussians) -> float:
        wanted, found = (raster.render_colors(part, camera) for part in (gaussians, some))
        return float((wanted - found).square().mean())

    cover = gaussians.opacities * gaussians.scales[:, :2].prod(1)
    largest = gaussians.select(cover.argsort(descending=True)[: count // 10])
    assert error(decimate(gaussians, count // 10).gaussians) < 0.3 * error(largest)
