"""World units are arbitrary: a scene of any size gets the same field and answers, and its own near plane."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Sequence
from pathlib import Path

import pytest
import torch

import scoup
from messages import refuses, warns
from scoup.base import InputError, ScoupWarning
from scoup.query import LanguageField
from scoup.scene import Camera, Cameras, Gaussians
from scoup.uplift import BuildSettings
from scoup.uplift.fit import Verdict, measure_fit
from scoup.uplift.near_plane import scene_preset
from scoup_lab.synthetic.folder import write_demo_scene
from scoup_lab.synthetic.scene import make_demo_scene
from uplift.test_fit import photographed, with_photographs_of

SIZES = (0.001, 1000.0)
WORDS = ("teapot", "mug", "elephant")


def resized(gaussians: Gaussians, cameras: Sequence[Camera], size: float) -> tuple[Gaussians, list[Camera]]:
    """The same scene in other units."""
    larger = dataclasses.replace(gaussians, means=gaussians.means * size, scales=gaussians.scales * size)
    return larger, [camera.moved(torch.eye(3), torch.zeros(3), size) for camera in cameras]


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    scene = make_demo_scene(0, 4000, 96, 72, 6, 1)
    return write_demo_scene(scene, tmp_path_factory.mktemp("demo") / "scene")


def built(folder: Path, size: float) -> LanguageField:
    gaussians, cameras = resized(
        scoup.load_gaussians(folder / "point_cloud.ply"), list(scoup.load_cameras(folder)), size
    )
    regions = scoup.load_regions(folder, Cameras(cameras))
    sources = scoup.FieldSources(words=folder / "text.npz")
    return scoup.build(gaussians, Cameras(cameras), regions, BuildSettings(n_atoms=16), sources=sources)


@pytest.fixture(scope="module")
def usual(demo: Path) -> LanguageField:
    return built(demo, 1.0)


@pytest.mark.parametrize("size", SIZES)
def test_a_scene_of_any_size_gets_the_same_answers(demo: Path, usual: LanguageField, size: float) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error", ScoupWarning)
        field = built(demo, size)
    assert usual.raster_preset == "inria"
    assert int(usual.coded().sum()) > 3000
    assert (":" in field.raster_preset) == (size < 1)
    assert int(field.coded().sum()) == pytest.approx(int(usual.coded().sum()), abs=5)
    fit, same = (measure_fit(each.gaussians, list(each.cameras or ())) for each in (field, usual))
    assert fit.coverage == pytest.approx(same.coverage, abs=1e-3)
    for one, other in zip(field.location(list(WORDS)), usual.location(list(WORDS)), strict=True):
        assert (one.presence, one.answer.score) == (
            other.presence,
            pytest.approx(other.answer.score, abs=0.02),
        )
        if other.position is not None:
            assert one.position is not None
            assert (one.position / size - other.position).norm() < 0.01
    for camera in usual.cameras or ():
        views = (each.at(camera.name).answer(list(WORDS)) for each in (field, usual))
        for one, other in zip(*views, strict=True):
            assert int((one.mask != other.mask).sum()) <= 4


def scene(folder: Path, nearest: float) -> tuple[Gaussians, list[Camera]]:
    """A wall at a depth of 4 before cameras beside each other, with something opaque at a depth; seen by all."""
    generator = torch.Generator().manual_seed(0)
    wall = torch.rand(3000, 3, generator=generator) * torch.tensor([8.0, 6.0, 0.1]) - torch.tensor(
        [4.0, 3.0, -4.0]
    )
    before = torch.rand(400, 3, generator=generator) * 0.3 * nearest + torch.tensor([0.0, 0.0, nearest])
    means = torch.cat([wall, before])
    count = len(means)
    quats = torch.tensor([1.0, 0, 0, 0]).expand(count, 4).contiguous()
    scales = torch.cat([torch.full((3000, 3), 0.1), torch.full((400, 3), 0.02 * nearest)])
    colors = torch.rand(count, 1, 3, generator=generator) * 3 - 1.5
    gaussians = Gaussians(means, quats, scales, torch.full((count,), 0.9), colors)
    eyes = [(0.03 * number * nearest, 0.0, 0.0) for number in range(4)]
    return gaussians, [
        Camera.look_at(eye, (eye[0], 0, 4), f"{number}.png", 160, 120, 120.0, up=(0, -1, 0))
        for number, eye in enumerate(eyes)
    ]


def test_photographs_tell_floaters_from_what_a_near_plane_cuts(tmp_path: Path) -> None:
    gaussians, cameras = scene(tmp_path, 0.15)
    # Renders with Inria's plane show no floaters, as the photographs of a capture.
    floating = photographed(gaussians, cameras, tmp_path)
    assert scene_preset(gaussians, floating) == "inria"
    assert measure_fit(gaussians, floating).verdict is Verdict.FITS
    larger = photographed(*resized(gaussians, cameras, 10), tmp_path / "larger")
    real = with_photographs_of(cameras, larger)
    assert scene_preset(gaussians, real) == "inria:0.05"
    assert scene_preset(gaussians, real, "inria:0.2") == "inria:0.2"
    assert scene_preset(gaussians, real, "gsplat") == "gsplat"
    fit = measure_fit(gaussians, real)
    assert (fit.verdict, fit.describe()["raster_preset"]) == (Verdict.FITS, "inria:0.05")


def test_without_photographs_a_small_cut_is_said(tmp_path: Path) -> None:
    gaussians, cameras = scene(tmp_path, 0.15)
    few = gaussians.select(torch.arange(3020))
    with warns(ScoupWarning):
        assert scene_preset(few, cameras) == "inria"
    assert scene_preset(gaussians, cameras) == "inria:0.05"


@pytest.mark.parametrize("preset", ["inria:", "inria:x", "inria:-1", "gsplat:inf", "other:0.1"])
def test_a_preset_with_a_wrong_near_plane_is_refused(preset: str) -> None:
    with refuses(InputError):
        BuildSettings(raster_preset=preset)
