"""The study of chosen cameras: observations from any camera, renders that wait for models, and its rows."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from benchmarks.answer_scenes import SceneSize
from benchmarks.study import run
from benchmarks.view_scenes import REGIONS, NotObserved, make_view_scene, observe_desk, observe_procedural
from benchmarks.views import Views, given_half, ring

import scoup
from scoup.base.errors import InputError
from scoup.io import save_regions
from scoup_lab.synthetic.scene import DemoScene, make_demo_scene

SIZE = SceneSize(4000, 160, 120, 6, 2)


@pytest.fixture(scope="module")
def demo() -> DemoScene:
    return make_demo_scene(0, 3000, 64, 48, 4, 2)


def test_its_own_cameras_observe_what_the_scene_has(demo: DemoScene) -> None:
    found = observe_procedural(demo, 0, demo.building)
    for name in demo.building.names:
        for level in demo.regions.levels:
            theirs, ours = demo.regions.load(name, level), found.load(name, level)
            assert torch.equal(theirs.labels, ours.labels)
            assert torch.equal(theirs.embeddings, ours.embeddings)
    elsewhere = observe_procedural(demo, 0, demo.held_out)
    assert elsewhere.view_names == demo.held_out.names


def test_renders_wait_for_the_regions_of_models(demo: DemoScene, tmp_path: Path) -> None:
    cameras = demo.building
    with pytest.raises(NotObserved, match="--observed"):
        observe_desk(demo.gaussians, cameras, "own", None)
    with pytest.raises(NotObserved, match=REGIONS):
        observe_desk(demo.gaussians, cameras, "own", tmp_path)
    assert sorted(path.name for path in (tmp_path / "own" / "images").iterdir()) == sorted(cameras.names)
    save_regions(demo.regions, tmp_path / "own" / REGIONS)
    found = observe_desk(demo.gaussians, cameras, "own", tmp_path)
    name = cameras.names[0]
    assert torch.equal(found.load(name, "m").labels, demo.regions.load(name, "m").labels)
    turned = scoup.Cameras(replace(each, viewmat=cameras[0].viewmat) for each in cameras)
    with pytest.raises(InputError, match="not those chosen"):
        observe_desk(demo.gaussians, turned, "own", tmp_path)


def test_half_of_the_cameras_stands_on_one_side() -> None:
    scene = make_view_scene("yard-0", Path(), SIZE, None)
    half = given_half(scene)
    assert len(half) == len(scene.given) // 2
    middle = np.mean([camera.position.numpy() for camera in scene.given], axis=0)
    ways = np.stack([camera.position.numpy() - middle for camera in half])
    assert (ways @ ways.mean(0) > 0).all()
    around = np.stack([camera.position.numpy() for camera in ring(scene)])
    np.testing.assert_allclose(np.linalg.norm(around - around.mean(0), axis=1).std(), 0, atol=1e-6)


@pytest.mark.slow
def test_rows_of_the_study() -> None:
    choices = ("given", "own", "ring", "given-half", "half-beside")
    record = run(Views(scenes=("table-0",), choices=choices, size=SIZE), "views")
    means = record["means"]["procedural"]
    assert {choice: means[choice]["views"] for choice in choices} == {
        "given": 6, "own": 6, "ring": 6, "given-half": 3, "half-beside": 6
    }  # fmt: skip
    assert all(0 < means[choice]["always"] < 1 for choice in choices)
    found = record["differences"]["procedural"]["own - given"]["always"][0]
    assert found == pytest.approx(means["own"]["always"] - means["given"]["always"], abs=1e-3)
    assert "| procedural | own" in Views.table(record)
