"""Whether splat and cameras fit: what stays silent, what is warned of, what is refused."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

import scoup
from scoup.base import InputError, ScoupWarning
from scoup.io import save_png
from scoup.raster import render_colors
from scoup.scene import Camera, Gaussians
from scoup.uplift.fit import Fit, Verdict, check_coded, check_fit, measure_fit, sample_views
from scoup.uplift.similarity import similarities
from support import make_camera, random_gaussians


def cameras_around(count: int = 12) -> list[Camera]:
    """Cameras around the Gaussians of ``random_gaussians``, whose middle is (0, 0, 4)."""
    found = []
    for number in range(count):
        turn = 2 * math.pi * number / count
        eye = 5 * math.cos(turn), 5 * math.sin(turn), 4 + 2 * math.sin(2 * turn)
        found.append(Camera.look_at(eye, (0, 0, 4), f"view_{number:02d}.png", 64, 48, 60.0))
    return found


def photographed(
    gaussians: Gaussians, cameras: Sequence[Camera], folder: Path, background: float = 0.0, gain: float = 1.0
) -> list[Camera]:
    """The cameras with renders as their photographs."""
    for camera in cameras:
        image = gain * render_colors(gaussians, camera, background=background)
        save_png((image * 255 + 0.5).byte(), folder / camera.name)
    return [replace(camera, image_path=folder / camera.name) for camera in cameras]


def scene(folder: Path, **more: float) -> tuple[Gaussians, list[Camera]]:
    gaussians = random_gaussians(600, 0)
    gaussians.scales.clamp_(max=0.3)
    return gaussians, photographed(gaussians, cameras_around(), folder, **more)


def with_photographs_of(cameras: Sequence[Camera], others: Sequence[Camera]) -> list[Camera]:
    return [replace(one, image_path=other.image_path) for one, other in zip(cameras, others, strict=True)]


def with_focal_lengths(cameras: Sequence[Camera], factor: float) -> list[Camera]:
    scale = torch.tensor([[factor, 1, 1], [1, factor, 1], [1, 1, 1]])
    return [replace(camera, K=camera.K * scale) for camera in cameras]


def mirrored(gaussians: Gaussians, axis: int) -> Gaussians:
    signs = torch.ones(3)
    signs[axis] = -1
    quats = torch.cat([gaussians.quats[:, :1], -signs * gaussians.quats[:, 1:]], 1)
    return replace(gaussians, means=gaussians.means * signs, quats=quats)


def refuses_to_fit(said: str):
    return pytest.raises(InputError, match=said)


@pytest.mark.parametrize("shown", [{}, {"background": 1.0}, {"gain": 0.4}, {"background": 0.5, "gain": 0.7}])
def test_a_scene_and_its_own_photographs_fit(shown: dict[str, float], tmp_path: Path):
    gaussians, cameras = scene(tmp_path, **shown)
    fit = measure_fit(gaussians, cameras)
    assert fit.verdict is Verdict.FITS
    assert fit.compared.all()
    assert float(fit.own.min()) > 0.8
    assert not fit.unlike


def test_what_is_refused(tmp_path: Path):
    gaussians, cameras = scene(tmp_path)
    other = random_gaussians(600, 100)
    other.scales.clamp_(max=0.3)
    turned = replace(gaussians, means=gaussians.means[:, [1, 2, 0]])
    shuffled = with_photographs_of(cameras, [*cameras[5:], *cameras[:5]])
    for splat, views in ((other, cameras), (turned, cameras), (gaussians, shuffled)):
        with refuses_to_fit(r"a\.ply: does not fit the cameras: .*median correlation.*check_fit=False"):
            check_fit(splat, views, splat="a.ply")


def test_other_focal_lengths_and_mirrored_splats_are_named(tmp_path: Path):
    gaussians, cameras = scene(tmp_path)
    for factor, found in ((0.9, "110%"), (1.1, "90%")):
        with refuses_to_fit(f"the photographs match focal lengths of {found}; .*check the focal"):
            check_fit(gaussians, with_focal_lengths(cameras, factor))
    with refuses_to_fit("the photographs match the splat with y negated"):
        check_fit(mirrored(gaussians, 1), cameras)


def test_the_camera_of_a_photograph_is_named(tmp_path: Path):
    gaussians, cameras = scene(tmp_path)
    one_off = with_photographs_of(cameras, [*cameras[1:], cameras[0]])
    fit = measure_fit(gaussians, one_off)
    assert fit.verdict is not Verdict.FITS
    # Of a pair of neighbours, the second sees what is on the photograph that the first has.
    assert ("view_01.png", "view_00.png") in fit.mistaken
    assert "the camera of {} sees what is on {}".format(*fit.mistaken[0]) in fit.reason()
    assert "name of its own camera" in fit.remedies()


def test_two_wrong_photographs_of_eight_are_nothing_and_three_are_doubtful(tmp_path: Path):
    gaussians, cameras = scene(tmp_path)
    cameras = cameras[:8]
    wrong = photographed(random_gaussians(600, 7), cameras, tmp_path / "other")
    assert measure_fit(gaussians, [*wrong[:2], *cameras[2:]]).verdict is Verdict.FITS
    with pytest.warns(ScoupWarning, match="may not fit the cameras: 3 of 8 renders tried look unlike"):
        check_fit(gaussians, [*wrong[:3], *cameras[3:]])


def test_cameras_that_see_nothing(tmp_path: Path):
    gaussians, cameras = scene(tmp_path)
    away = [replace(camera, viewmat=torch.diag(torch.tensor([1.0, -1, -1, 1])).double() @ camera.viewmat)
            for camera in cameras]  # fmt: skip
    bare = [replace(camera, image_path=None) for camera in (*away[:3], *cameras[3:8])]
    with pytest.warns(ScoupWarning, match="3 of 8 cameras tried see nothing"):
        check_fit(gaussians, bare)
    check_fit(gaussians, bare[2:])  # one of six
    with refuses_to_fit("the splat does not fit the cameras: 8 of 8 cameras tried see nothing"):
        check_fit(gaussians, away)
    # The photographs of the others decide.
    check_fit(gaussians, [*bare[:3], *cameras[3:8]])
    # Unless nearly all are blind, be they few.
    assert measure_fit(gaussians, [*bare[:3], cameras[3]]).verdict is Verdict.HOPELESS
    assert measure_fit(gaussians, [*bare[:2], *cameras[3:5]]).verdict is Verdict.FITS
    with refuses_to_fit("cameras: the only camera tried sees nothing of the splat"):
        check_fit(gaussians, away[:1])


def test_photographs_that_say_nothing_are_passed_over(tmp_path: Path):
    gaussians, cameras = scene(tmp_path)
    broken = tmp_path / "broken.png"
    broken.write_bytes(b"no image")
    black = tmp_path / "black.png"
    save_png(torch.zeros(48, 64, 3, dtype=torch.uint8), black)
    for path in (None, broken, black, tmp_path / "gone.png"):
        fit = measure_fit(gaussians, [replace(camera, image_path=path) for camera in cameras])
        assert not fit.compared.any()
        assert fit.verdict is Verdict.NOT_JUDGED
    with pytest.warns(ScoupWarning, match="a.ply: whether the cameras fit was not judged: no render"):
        check_fit(gaussians, [replace(camera, image_path=black) for camera in cameras], splat="a.ply")


def test_few_views_are_never_refused_for_their_photographs(tmp_path: Path):
    gaussians, cameras = scene(tmp_path)
    wrong = photographed(random_gaussians(600, 7), cameras[:3], tmp_path / "other")
    with pytest.warns(ScoupWarning, match="the only render tried looks unlike its photograph"):
        check_fit(gaussians, wrong[:1])
    with pytest.warns(ScoupWarning, match="3 of 3 renders tried look unlike their photographs"):
        check_fit(gaussians, wrong)
    assert measure_fit(gaussians, []).verdict is Verdict.NOT_JUDGED


@given(st.integers(1, 60))
def test_sample_views_are_pairs_evenly_spread(count: int):
    cameras = [make_camera(name=f"{number:03d}") for number in range(count)]
    tried = [int(camera.name) for camera in sample_views(cameras)]
    assert tried == sorted(set(tried))
    if count <= 8:
        assert tried == list(range(count))
        return
    assert len(tried) == 8
    assert all(second == first + 1 for first, second in zip(tried[::2], tried[1::2], strict=True))
    assert (tried[0], tried[-1]) == (0, count - 1)
    gaps = np.diff(tried[::2])
    assert gaps.max() - gaps.min() <= 1


@given(st.integers(1, 4), st.integers(0, 1000), st.booleans())
def test_similarity_is_a_correlation_of_structure(count: int, seed: int, see_through: bool):
    rng = np.random.default_rng(seed)
    images = rng.random((count, 24, 32, 3))
    alphas = rng.random((count, 24, 32)) if see_through else np.ones((count, 24, 32))
    same = similarities(images, alphas, images + (1 - alphas)[..., None] * 0.0)
    assert same.shape == (count, count)
    assert np.all(np.abs(same) <= 1 + 1e-9)
    if not see_through:
        np.testing.assert_allclose(np.diagonal(same), 1, atol=1e-9)
    photographs = rng.random((count, 24, 32, 3))
    found = similarities(images, alphas, photographs)
    assert np.all(np.abs(found) <= 1 + 1e-9)
    order = rng.permutation(count)
    if not see_through:  # with holes, the background is estimated from all photographs alike
        np.testing.assert_allclose(similarities(images, alphas, photographs[order]), found[:, order])
        shifted = similarities(images, alphas, 0.5 * photographs + rng.random(3))
        np.testing.assert_allclose(shifted, found, atol=0.02)
    photographs[0] = np.nan
    assert np.isnan(similarities(images, alphas, photographs)[:, 0]).all()


def test_a_build_is_checked_before_the_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    gaussians, cameras = scene(tmp_path)
    map_of_all = scoup.RegionMap(torch.zeros(48, 64, dtype=torch.int32), torch.eye(1, 8))
    regions = scoup.Regions.from_maps({camera.name: {"s": map_of_all} for camera in cameras})
    settings = scoup.BuildSettings(n_atoms=1, k=1, keep=1)
    field = scoup.build(gaussians, scoup.Cameras(cameras), regions, settings)
    wrong = scoup.Cameras(with_photographs_of(cameras, [*cameras[5:], *cameras[:5]]))
    unchecked = scoup.build(gaussians, wrong, regions, replace(settings, check_fit=False))
    assert unchecked.code_weights.equal(field.code_weights)
    sums = scoup.region_sums(gaussians, wrong, regions)
    scoup.build(gaussians, wrong, regions, settings, sums=sums)  # what is continued was checked at its start

    def too_late(*_, **__):
        raise AssertionError("work was done on a scene that does not fit")

    monkeypatch.setattr("scoup.uplift.field_build.code_regions", too_late)
    with refuses_to_fit(r"a\.ply: does not fit the cameras"):
        scoup.build(gaussians, wrong, regions, settings, sources=scoup.FieldSources(geometry_path="a.ply"))


def test_codes_of_hardly_any_gaussian():
    weights = torch.zeros(1000, 3, 2)
    with refuses_to_fit("no Gaussian contributes to a region"):
        check_coded(weights)
    weights[:9, 1, 0] = 1
    with pytest.warns(ScoupWarning, match=r"only 0.90% of the Gaussians"):
        check_coded(weights)
    weights[9:11, 1, 0] = 1
    check_coded(weights)  # a warning would be an error


def test_numbers_behind_a_verdict():
    own = np.array([0.9, 0.8, 0.1, np.nan])
    fit = Fit(tuple("abcd"), np.array([1.0, 0.5, 0.2, 0.0]), np.where(np.eye(4, dtype=bool), own, 0.05))
    assert fit.compared.tolist() == [True, True, True, False]
    assert fit.blind.tolist() == [False, False, False, True]
    assert (fit.unlike, fit.mistaken) == (["c"], [])
    assert fit.verdict is Verdict.DOUBTFUL
    assert fit.reason() == (
        "1 of 4 cameras tried sees nothing of the splat (d), 1 of 3 renders tried looks unlike its photograph "
        "(c; median correlation 0.80)"
    )


def test_cameras_that_see_next_to_nothing_of_another_splat():
    own = np.array([0.0, 0.05, *[np.nan] * 6])
    similarity = np.where(np.eye(8, dtype=bool), own, np.nan)
    for coverage, verdict in ((0.001, Verdict.HOPELESS), (0.5, Verdict.DOUBTFUL)):
        fit = Fit(tuple("abcdefgh"), np.array([0.5, 0.5, *[coverage] * 6]), similarity)
        assert fit.verdict is verdict
