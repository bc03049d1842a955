"""Large scenes in parts, and the coarse Gaussians that stand for them."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from view_samples import field_with_things, random_field, shown_relevancy, splat_of, table, unpacked

from messages import refuses
from scoup.query import LanguageField
from scoup.view import parts
from scoup.view.decimation import cover, drawable
from scoup.view.parts import Parts
from scoup.view.viewed_field import ViewedField
from support import KINDS, examples, random_gaussians

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


def test_a_scene_of_which_nothing_can_be_drawn() -> None:
    gaussians = random_gaussians(300, 1)
    gaussians.opacities[:] = 0
    cut = Parts(gaussians, 300)
    assert (len(cut), len(cut.part(0).rows), cut.coarse()[1]) == (1, 0, [0])


def test_parts_are_of_about_the_same_number_and_near_their_place() -> None:
    gaussians = random_gaussians(1000, 3)
    cut, merged = Parts(gaussians, 1000), Parts(gaussians, 500)
    shown = [cut.part(number) for number in range(len(cut))]
    assert [len(part.rows) for part in shown] == [100] * 10
    spread = gaussians.means.var(0).sum()
    assert torch.stack([part.gaussians.means.var(0).sum() for part in shown]).mean() < 0.7 * spread
    assert len(merged) == 10
    assert all(40 < len(merged.part(number).rows) <= 50 for number in range(10))


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


def test_a_small_scene_has_no_parts() -> None:
    viewed = ViewedField(random_field(120).with_encoder(table()))
    tensors, metadata = unpacked(viewed.scene())
    assert viewed.n_parts == 0
    assert "parts" not in metadata
    assert len(tensors["opacities"]) == 120
    assert ViewedField(random_field(121).with_encoder(table())).n_parts == 2
