"""Gaussians, cameras, regions, codes and directions."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from messages import refuses
from scoup.base import UnknownNameError
from scoup.base.errors import nearest_names
from scoup.raster import cosines_and_norms
from scoup.scene.cameras import Camera, Cameras
from scoup.scene.codes import SparseCodes, index_dtype
from scoup.scene.directions import (
    normalise_embeddings,
    quats_of_rotations,
    query_vectors,
    rotation_matrices,
    unit_rows,
)
from scoup.scene.gaussians import Gaussians
from scoup.scene.regions import RegionMap, Regions, resize_labels
from scoup.scene.sanity_checks import sanity_problems
from support import examples, make_camera, random_gaussians, small_scene, unit

SOME_ROWS = torch.randn(3, 5, generator=torch.Generator().manual_seed(0))
MAP = RegionMap(torch.tensor([[0, 2], [-1, 1]]), SOME_ROWS)


WRONG: list[tuple[Gaussians | Camera | RegionMap, str, list[Any]]] = [
    (random_gaussians(3, 0), "means", [torch.zeros(3, 2)]), (random_gaussians(3, 0), "quats", [torch.zeros(4, 4)]),
    (random_gaussians(3, 0), "opacities", [torch.zeros(3, 1)]), (random_gaussians(3, 0), "sh", [torch.zeros(3, 5, 3)]),
    (random_gaussians(3, 0), "scales", [torch.zeros(3, 3, dtype=torch.float64)]),
    (make_camera(), "width", [0]), (make_camera(), "K", [torch.diag(torch.tensor([-1.0, 1.0, 1.0]))]),
    (make_camera(), "height", [480.5, float("nan"), float("inf"), "480", None, [480]]),
    (make_camera(), "viewmat", [torch.eye(3), torch.full((4, 4), torch.nan), torch.diag(torch.tensor([2.0, 2, 2, 1]))]),
    (MAP, "labels", [MAP.labels.float(), MAP.labels - 1]),
    (MAP, "embeddings", [torch.full((3, 5), torch.inf), torch.full((3, 5), torch.nan), torch.ones(2, 5)]),
]  # fmt: skip


@pytest.mark.parametrize(("made", "part", "values"), WRONG, ids=[part for _, part, _ in WRONG])
def test_wrong_parts_are_refused(made: Any, part: str, values: list[Any]) -> None:
    for value in values:
        with refuses():
            replace(made, **{part: value})


def test_fingerprint_follows_geometry_not_colour():
    gaussians = random_gaussians(10, 0)
    recoloured = replace(gaussians, sh=gaussians.sh + 1)
    assert recoloured.fingerprint() == gaussians.fingerprint()
    moved = replace(gaussians, means=gaussians.means + 1e-6)
    assert moved.fingerprint() != gaussians.fingerprint()
    assert gaussians.select(torch.arange(9)).fingerprint() != gaussians.fingerprint()


def test_finite_rows():
    gaussians = random_gaussians(4, 0)
    gaussians.means[0, 1] = torch.nan
    gaussians.scales[1, 2] = torch.inf
    gaussians.opacities[2] = torch.inf
    assert gaussians.finite().tolist() == [False, False, True, True]


@pytest.mark.parametrize("width", [640, 640.0, np.int32(640), np.float32(640), torch.tensor(640)])
def test_sizes_are_whole_numbers_of_any_type(width):
    made = replace(make_camera(), width=width, height=width)
    assert (made.width, type(made.width), type(made.height)) == (640, int, int)
    assert made.fingerprint() == replace(make_camera(), width=640, height=640).fingerprint()


def test_cameras_are_found_by_position_name_and_stem():
    names = ["a/frame_1.jpg", "a/frame_2.jpg", "cam1/0.png", "cam2/0.png", "K\u00fcche.a.png"]
    cameras = Cameras(make_camera(name=name) for name in names)
    for number, name in enumerate(names):
        assert cameras[number] is cameras[name] is cameras[name.rpartition(".")[0]]
    assert cameras[0] is cameras["frame_1"]
    for name in ("Ku\u0308che.a", "Ku\u0308che.a.png", "Ku\u0308che"):
        assert cameras[name] is cameras[4]
    assert cameras[1:3].names == ("a/frame_2.jpg", "cam1/0.png")
    assert cameras.select(["frame_2"]).names == ("a/frame_2.jpg",)
    assert cameras.select(lambda camera: "frame_1" in camera.name).names == ("a/frame_1.jpg",)
    for unknown in ("frame_3", "0"):
        with refuses(UnknownNameError):
            cameras[unknown]
    with refuses():
        Cameras([make_camera(), make_camera()])


def test_resized_camera_sees_the_same_rays():
    camera = make_camera(40, 30, seed=1)
    half = camera.resized(20, 15)
    point = torch.tensor([0.3, -0.2, 2.0], dtype=torch.float64)
    full, small = camera.K @ point, half.K @ point
    assert torch.allclose(small[:2] / small[2] * 2, full[:2] / full[2])
    assert (Cameras([camera]).scaled(0.5)[0].width, camera.stem) == (20, "view")


def test_pose_in_the_world_gives_the_same_camera():
    camera = make_camera(seed=5)
    pose = torch.linalg.inv(camera.viewmat)
    for given_pose in (pose, pose[:3], pose.tolist()):
        back = Camera.from_c2w("a.png", given_pose, camera.K.float(), camera.width, camera.height)
        assert torch.allclose(back.viewmat, camera.viewmat, atol=1e-12)
        assert torch.allclose(back.position, pose[:3, 3], atol=1e-12)
        assert back.viewmat.dtype == back.K.dtype == torch.float64
    assert torch.equal(back.K, camera.K.float().double())
    for wrong in (pose[:3, :3], pose * 2):
        with refuses():
            Camera.from_c2w("a.png", wrong, camera.K, 4, 4)


def test_look_at_puts_the_target_in_the_middle():
    eye, target = torch.tensor([1.0, -2.0, 1.5]), torch.tensor([0.1, 0.2, 0.8])
    camera = Camera.look_at(eye.tolist(), target.tolist(), "a.png", 40, 30, 35.0)
    assert camera.position.tolist() == pytest.approx(eye.tolist())
    way, up = target - eye, torch.tensor([0, 0, 1.0])
    points = torch.stack([target, eye - way, eye + 0.1 * way + up])
    pixels, depths = camera.pixels(points)
    assert pixels[0].tolist() == pytest.approx((20, 15), abs=1e-4)
    assert depths[:2].tolist() == pytest.approx([float(way.norm()), -float(way.norm())])
    assert camera.shows(points).tolist() == [True, False, False]  # behind it, and beside its image
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (35, 35, 20, 15)


@pytest.mark.parametrize("up", [[0, -1, 0], [0, -7, 0], [0.3, -1, 0.9]])
def test_look_at_turns_up_to_the_top_of_the_image(up):
    camera = Camera.look_at([1, 2, 3], [1, 2, 4], "a.png", 40, 30, 35.0, up)
    rotation = camera.viewmat[:3, :3]
    seen = rotation @ torch.tensor(up, dtype=torch.float64)
    assert seen[0] == pytest.approx(0, abs=1e-12)
    assert seen[1] < 0  # image rows run downwards
    assert torch.allclose(rotation @ rotation.T, torch.eye(3, dtype=torch.float64), atol=1e-12)


def test_look_at_refuses_degenerate_directions():
    for target, up in (
        ([1, 2, 3], [0, 0, 1]), ([1, 2, float("nan")], [0, 0, 1]), ([1, 2, 4], [0, 0, 0]), ([1, 2, 9], [0, 0, 1]),
        ([1, 2, -9], [0, 0, 1]),
    ):  # fmt: skip
        with refuses():
            Camera.look_at([1, 2, 3], target, "a.png", 40, 30, 35.0, up)


def nearest(place: int, size: int, labels: int) -> set[int]:
    """Where the middle of a pixel falls on a border, either side is as near."""
    middle = (2 * place + 1) * labels
    return {middle // (2 * size), -(-middle // (2 * size)) - 1}


@given(st.integers(1, 20), st.integers(1, 20), st.integers(1, 40), st.integers(1, 40))
def test_labels_are_resized_to_the_nearest_pixel(rows, columns, height, width):
    labels = torch.arange(rows * columns, dtype=torch.int32).view(rows, columns)
    resized = resize_labels(labels, width, height)
    for y in range(height):
        for x in range(width):
            row, column = divmod(int(resized[y, x]), columns)
            assert row in nearest(y, height, rows)
            assert column in nearest(x, width, columns)


def test_regions_stack_in_view_order():
    _, cameras, regions = small_scene(views=3, regions=4)
    stacked, rows = regions.embeddings("m")
    assert len(stacked) == 12
    assert rows[cameras[1].name] == slice(4, 8)
    assert torch.equal(stacked[4:8], regions.load(cameras[1].name, "m").embeddings)
    assert len(regions.select([cameras[2].name])) == 1
    for view, level in (("view_09.png", "m"), (cameras[0].name, "xl")):
        with refuses(UnknownNameError):
            regions.load(view, level)


def test_regions_of_two_models_do_not_mix():
    labels = torch.zeros(2, 2, dtype=torch.int32)
    maps = {name: {"m": RegionMap(labels, torch.ones(1, dim))} for name, dim in (("a", 4), ("b", 5))}
    with refuses():
        Regions.from_maps(maps).embeddings("m")


def test_nearest_names():
    assert nearest_names("ketle", ["kettle", "mug", "table"])[0] == "kettle"
    assert nearest_names("x", []) == []


@given(rows=st.integers(0, 20), atoms=st.integers(1, 30), k=st.integers(1, 12), seed=st.integers(0, 999))
def test_top_k_keeps_the_largest_and_sums_to_one(rows, atoms, k, seed):
    generator = torch.Generator().manual_seed(seed)
    dense = (torch.rand(rows, atoms, generator=generator) - 0.4).clamp(min=0)
    codes = SparseCodes.from_dense(dense, k)
    back = codes.to_dense()
    for row, kept in zip(dense, back, strict=True):
        expected = torch.zeros(atoms)
        best = sorted(range(atoms), key=lambda j: (-row[j].item(), j))[: min(k, atoms)]
        total = sum(row[j].item() for j in best)
        if total > 0:
            expected[best] = row[best] / total
        assert torch.allclose(kept, expected, atol=1e-6)
    assert (codes.weights[:, :-1] >= codes.weights[:, 1:]).all()


def test_rows_without_positive_entries_equal_entries_and_many_atoms():
    assert not SparseCodes.from_dense(torch.tensor([[0.0, 0.0], [-1.0, 0.0]]), 2).weights.any()
    assert SparseCodes.from_dense(torch.full((1, 9), 0.25), 3).indices.tolist() == [[0, 1, 2]]
    assert index_dtype(256) == torch.uint8
    assert SparseCodes.from_dense(torch.rand(2, 257), 4).indices.dtype == torch.uint16


def test_wrong_codes_are_refused():
    with refuses():
        index_dtype(70000)
    for kind, columns in ((torch.uint8, 4), (torch.int64, 3)):
        with refuses():
            SparseCodes(torch.zeros(2, 3, dtype=kind), torch.zeros(2, columns), 8)


@given(seed=st.integers(0, 999), scale=st.sampled_from([1e-6, 1.0, 1e4]))
def test_gram_shortcut_equals_decoding(seed, scale):
    generator = torch.Generator().manual_seed(seed)
    weights = torch.rand(3, 5, 8, generator=generator) * scale
    weights[0, 0] = 0
    codebook = torch.randn(8, 32, generator=generator)
    queries = unit(torch.randn(4, 32, generator=generator))
    decoded = unit(weights.double() @ codebook.double()) @ queries.double().T
    found = cosines_and_norms(weights, codebook @ queries.T, codebook @ codebook.T)[0]
    assert torch.allclose(found.double(), decoded, atol=1e-5)


def rows(count: int, seed: int = 0) -> torch.Tensor:
    return unit(torch.randn(count, 5, generator=torch.Generator().manual_seed(seed)))


@settings(max_examples=examples(50))
@given(st.integers(0, 2**31), st.integers(-30, 30))
def test_any_norm_gives_the_same_direction(seed: int, exponent: int) -> None:
    expected = rows(4, seed)
    found = unit_rows(expected * 10.0**exponent)
    torch.testing.assert_close(found, expected, atol=1e-6, rtol=0)
    torch.testing.assert_close(normalise_embeddings(expected * 10.0**exponent), expected, atol=1e-6, rtol=0)


def test_unit_rows_stay_to_the_last_bit() -> None:
    given_rows = rows(6)
    assert unit_rows(given_rows).data_ptr() == given_rows.data_ptr()  # not even copied
    mixed = torch.cat([given_rows, 7 * given_rows, torch.zeros(1, 5)])
    found = unit_rows(mixed)
    assert torch.equal(found[:6], given_rows)
    assert torch.equal(found[-1], torch.zeros(5))
    torch.testing.assert_close(found[6:12], given_rows)
    short = torch.cat([0.3 * given_rows, 3 * given_rows])
    kept = unit_rows(short, lengthen=False)
    assert torch.equal(kept[:6], short[:6])
    torch.testing.assert_close(kept[6:], given_rows)


def test_arrays_and_single_vectors() -> None:
    one = rows(1)[0]
    for same in (one, one.numpy(), one.double() * 3, np.asarray(one, np.float16)):
        found = query_vectors(same, 5)
        assert found.shape == (1, 5)
        assert found.dtype == torch.float32
        torch.testing.assert_close(found[0], one, atol=1e-3, rtol=0)


def test_what_is_no_direction() -> None:
    ones = torch.ones(2, 5)
    nan, zero = ones * torch.tensor([1.0, 1, 1, 1, torch.nan]), ones * torch.tensor([[1.0], [0]])
    for bad in (ones[0, :4], ones[:0], ones.expand(2, 2, 5), ones.to(torch.int64), nan, zero):
        with refuses():
            query_vectors(bad, 5)


def test_region_maps_take_any_norm_and_integer() -> None:
    for integers in (torch.int64, torch.int32, torch.int16, torch.int8):
        made = RegionMap(MAP.labels.to(integers), MAP.embeddings)
        assert made.labels.dtype == torch.int32
        assert made.labels.equal(MAP.labels)
    made = RegionMap(MAP.labels.numpy(), 7 * MAP.embeddings.double().numpy())  # pyright: ignore[reportArgumentType]
    torch.testing.assert_close(made.embeddings, MAP.embeddings)


def test_embeddings_of_regions_have_unit_norm() -> None:
    _, (camera,), regions = small_scene(views=1)
    for factor in (7, torch.nan):
        scaled = lambda name, level, factor=factor: regions.load_embeddings(name, level) * factor  # noqa: E731
        made = Regions(regions.levels, regions.view_names, regions.load, scaled)
        with contextlib.nullcontext() if factor == 7 else refuses():
            torch.testing.assert_close(
                made.load_embeddings(camera.name, "m"), regions.load_embeddings(camera.name, "m")
            )


@settings(max_examples=examples(50), deadline=None)
@given(
    st.lists(st.tuples(*[st.sampled_from([-1.0, -1e-9, 0.0, 1e-9, 0.3, 1.0])] * 4).filter(any), min_size=1)
)
def test_quaternions_of_matrices(quats: list[tuple[float, ...]]) -> None:
    expected = unit(torch.tensor(quats, dtype=torch.float64))
    matrices = rotation_matrices(expected)
    found = quats_of_rotations(matrices)
    torch.testing.assert_close(rotation_matrices(found), matrices, atol=1e-12, rtol=0)
    torch.testing.assert_close((found * expected).sum(1).abs(), torch.ones(len(quats), dtype=torch.float64))


def test_sound_scenes_have_none() -> None:
    kinds = ("plain", "behind", "needle", "tiny", "opacity inf")
    for count in (0, 1, 500):
        assert sanity_problems(random_gaussians(count, 0, kinds[:1] if count < 500 else kinds)) == []


def test_one_splat_is_not_hidden_by_another() -> None:
    gaussians = random_gaussians(400, 0)
    gaussians.means[:15] *= 1e30  # were they counted, the scene would be as large as they are
    gaussians.scales[20] = 1e30
    far, large = sorted(sanity_problems(gaussians), reverse=True)
    assert large.startswith("1 of 400 Gaussians is over 100 times larger")
    assert far.startswith("15 of 400 Gaussians are over 10,000 times")


def test_values_that_are_not_finite_do_not_hide_the_rest() -> None:
    for count, said in ((400, "all 400 Gaussians are transparent"), (1, "the only Gaussian is transparent")):
        gaussians = random_gaussians(count, 0, ("plain", "nan") if count > 1 else ("plain",))
        gaussians.opacities[:] = 0
        gaussians.opacities[3:4] = torch.nan
        (found,) = sanity_problems(gaussians)
        assert found.startswith(said)
