"""What a page is told of a scene."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from view_samples import (
    DIM,
    field_with_things,
    random_field,
    shown_relevancy,
    splat_of,
    table,
    unpacked,
    viewed_field,
)

from messages import refuses
from scoup.base import WorldFrame
from scoup.field import relevancy
from scoup.field.code_sums import code_scores
from scoup.scene import SH_C0, Camera, Cameras
from scoup.view.decimation import decimate
from scoup.view.packing import byte_planes, packed
from scoup.view.scene_data import UnitCodes, atom_scores, surroundings
from scoup.view.viewed_field import ViewedField
from support import KINDS, examples, random_gaussians, unit


def test_the_splat_and_its_codes_come_through_within_their_rounding() -> None:
    viewed = viewed_field(count=200, k=5)
    tensors, metadata = unpacked(viewed.scene())
    rows = decimate(viewed.gaussians).rows
    given, shown = viewed.gaussians.select(rows), splat_of(tensors, metadata)
    extent = (given.means.amax(0) - given.means.amin(0)).max()
    assert (shown.means - given.means).abs().max() < 2e-7 * float(extent)
    turned = (shown.quats * torch.nn.functional.normalize(given.quats, dim=1)).sum(1).abs()
    assert turned.min() > math.cos(0.01)
    within = (given.scales.log() > metadata["scales_low"]) & (given.scales.log() < metadata["scales_high"])
    step = (metadata["scales_high"] - metadata["scales_low"]) / 255
    assert within.float().mean() > 0.98
    assert (shown.scales.log() - given.scales.log()).abs()[within].max() < 0.51 * step
    assert (shown.opacities - given.opacities).abs().max() < 0.51 / 255
    colors = (SH_C0 * given.sh[:, 0] + 0.5).clamp(0, 1)
    assert ((SH_C0 * shown.sh[:, 0] + 0.5) - colors).abs().max() < 0.51 / 255
    # Codes and scores give the relevancy of the field.
    scores = viewed.answers(["thing 3"])[0].scores.numpy()
    found = [shown_relevancy(tensors, metadata, tensors["canonical"], scores, level) for level in (0, 1)]
    texts = viewed.question(["thing 3"])
    wanted = viewed.field.gaussian_relevancy(texts.queries, texts.canonical)[:, 0, rows]
    assert np.abs(np.stack(found) - wanted.numpy()).max() < 2e-3
    assert tensors["canonical"].shape == (2, 5, 9)  # four phrases, and the mean of everyday words
    colors = np.stack([tensors["code_colors"][level][:, tensors["code_indices"][level]] for level in (0, 1)])
    assert colors.shape == (2, 3, 5, 200)
    assert np.isfinite(colors).all()
    # A few large Gaussians keep their size.
    viewed = viewed_field(count=3000)
    viewed.gaussians.scales[7] = torch.tensor([50.0, 40.0, 0.1])
    tensors, metadata = unpacked(viewed.scene())
    assert float(splat_of(tensors, metadata).scales.max()) == pytest.approx(50, rel=0.05)


def test_owners_are_those_of_the_gaussians_shown() -> None:
    field = field_with_things(60)
    assert field.thing_table is not None
    viewed = ViewedField(field.with_encoder(table()), most=40)
    tensors, metadata = unpacked(viewed.scene())
    assert metadata["n_things"] == len(field.thing_table)
    middle = field.thing_table.owners[:, 1]
    owners = field.thing_table.owners[decimate(viewed.gaussians, 40, middle).rows].T.numpy()
    assert tensors["owners"].dtype == np.uint16
    assert (owners == -1).any()
    np.testing.assert_array_equal(tensors["owners"], np.where(owners == -1, 65535, owners))
    plain, other = viewed_field(count=60), ViewedField(field_with_things(60).with_encoder(table()))
    tensors, metadata = unpacked(plain.scene())
    assert not {"owners", "n_things"} & {*tensors, *metadata}
    assert other.identity == viewed.identity != plain.identity
    assert other.field.thing_table is not None
    other.field.thing_table.owners[0, 0] = 1 - other.field.thing_table.owners[0, 0].clamp(0, 1)
    assert ViewedField(other.field.with_encoder(table())).identity != viewed.identity


@settings(max_examples=examples(20), deadline=None)
@given(st.integers(0, 30), st.integers(0, 2**31), st.integers(1, 40))
def test_ugly_gaussians_are_left_out_and_the_rest_is_finite(count: int, seed: int, most: int) -> None:
    viewed = viewed_field(count=count, seed=seed, kinds=KINDS, most=most)
    tensors, metadata = unpacked(viewed.scene())
    drawable = viewed.gaussians.finite() & (viewed.gaussians.opacities > 0) & viewed.gaussians.quats.any(1)
    count_shown, count_drawable = len(tensors["opacities"]), int(drawable.sum())
    assert min(1, count_drawable) <= count_shown <= min(most, count_drawable)
    assert count_shown == count_drawable or count_drawable > most
    assert metadata["n_gaussians"] == count
    assert splat_of(tensors, metadata).finite().all()
    assert 0 < metadata["radius"] < math.inf


def cameras_of(eyes: Sequence[tuple[float, ...]], targets: Sequence[tuple[float, ...]]) -> Cameras:
    places = enumerate(zip(eyes, targets, strict=True))
    return Cameras(
        Camera.look_at(eye, target, f"c{number}", 40, 30, 40.0) for number, (eye, target) in places
    )


def test_packing_gives_the_same_bytes_and_bears_one_point() -> None:
    planes, low, high = byte_planes(np.array([[1.0, -2.0, 3.0]]))
    assert (planes == 0).all()
    assert low == high == [1.0, -2.0, 3.0]
    arrays = {"b": np.arange(3.0), "a": np.zeros((2, 2), np.uint16)}
    data = packed(arrays, {"x": "é"})
    assert packed(arrays, {"x": "é"}) == data
    assert unpacked(data)[1] == {"x": "é"}


def test_the_page_has_metres_and_up_of_the_field() -> None:
    plain = random_field(10)
    framed = plain.with_world(WorldFrame(0.5, (0.0, -1.0, 0.0)))
    found = [unpacked(ViewedField(field).scene())[1] for field in (plain, framed)]
    assert [each["metres_per_unit"] for each in found] == [None, 0.5]
    assert found[1]["up"] == [0, -1, 0] != found[0]["up"]


def test_the_cameras_say_where_to_look() -> None:
    target = (1.0, 2.0, 0.5)
    cameras = cameras_of([(4, 2, 2), (1, 6, 2), (-2, 2, 1.5), (1, -2, 2)], [target] * 4)
    centre, radius = surroundings(random_gaussians(50, 0), cameras)
    np.testing.assert_allclose(centre, target, atol=1e-6)
    assert 3 < radius < 5
    assert np.isfinite(surroundings(random_gaussians(50, 0), Cameras([cameras[0]]))[0]).all()
    assert np.isfinite(surroundings(random_gaussians(0, 0), None)[1])
    # Cameras that turn on the spot, and a single Gaussian, have a scale.
    gaussians = random_gaussians(200, 0)
    eyes = [(0.001 * number, 0.0, 0.0) for number in range(4)]
    cameras = cameras_of(eyes, [(1.0, 0.1, 5.0), (-5.0, 0.0, 1.0), (5.0, 0.0, 1.0), (0.0, 1.0, -5.0)])
    assert surroundings(gaussians, cameras)[1] > 0.05
    single = gaussians.select(slice(0, 1))
    assert surroundings(single, None)[1] >= float(single.scales.max())


def test_a_field_whose_texts_cannot_be_encoded_is_shown_all_the_same() -> None:
    viewed = ViewedField(random_field(10))
    assert "names no embedding model" in (viewed.words_problem or "")
    tensors, metadata = unpacked(viewed.scene())
    assert "canonical" not in tensors
    assert metadata["words_problem"] == viewed.words_problem
    assert viewed.vocabulary() is None
    with refuses():
        viewed.answers(["thing 1"])


# ---- Codes of unit norm: sums of a few products are cosines


@settings(max_examples=examples(30), deadline=None)
@given(st.integers(0, 40), st.integers(0, 2**31), st.sampled_from([1, 9, 300]), st.sampled_from([1, 3, 4, 9]))
def test_cosines_are_those_of_the_field(count: int, seed: int, n_atoms: int, k: int) -> None:
    field = random_field(count, seed, n_atoms, k)
    queries = unit(torch.randn(3, DIM, generator=torch.Generator().manual_seed(seed)))
    canonical = unit(torch.randn(2, DIM, generator=torch.Generator().manual_seed(seed + 1)))
    codes = UnitCodes.of(field)
    of_queries, of_canonical = (
        code_scores(codes.indices, codes.weights, atom_scores(field, vectors)).permute(1, 2, 0)
        for vectors in (queries, canonical)
    )
    found = relevancy(of_queries, of_canonical)
    torch.testing.assert_close(found, field.gaussian_relevancy(queries, canonical), atol=2e-5, rtol=0)


def test_confidence_is_one_where_all_regions_agree_and_less_the_more_they_differ() -> None:
    field = random_field(3, k=2, n_atoms=4)
    field.codebook[0, :3] = torch.eye(DIM)[:3]
    field.codebook[0, 1] = unit(torch.eye(DIM)[0] + 0.2 * torch.eye(DIM)[1])
    field.code_indices[:, 0] = torch.tensor([[0, 3], [0, 1], [0, 2]], dtype=torch.uint8)
    field.code_weights[:, 0] = torch.tensor([[1.0, 0.0], [0.5, 0.5], [0.5, 0.5]]).half()
    confidence = UnitCodes.of(field).confidence[:, 0]
    assert confidence[0] == 1
    assert 0.99 < float(confidence[1]) < 1
    assert abs(float(confidence[2]) - 0.5**0.5) < 1e-3  # two that are at right angles
    field.code_weights[0] = 0
    nothing = UnitCodes.of(field)
    assert nothing.confidence[0].tolist() == [0, 0]
    assert not nothing.weights[0].any()
