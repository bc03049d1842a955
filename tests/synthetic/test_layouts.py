"""Every layout: the same scene each time, every object in sight, no camera inside a thing."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
import torch
from benchmarks.scenes import LAYOUTS
from benchmarks.scenes.alterations import called, painted, several

from scoup.base.errors import InputError
from scoup.scene.regions import LEVELS
from scoup_lab.synthetic import TABLE, DemoScene, make_demo_scene
from scoup_lab.synthetic.art.things import Parts, Surface, Thing
from scoup_lab.synthetic.masks import piece_boxes
from scoup_lab.synthetic.words import CANONICAL
from synthetic.small_scenes import well_lit_scene

SIZES: dict[str, Any] = {"n_gaussians": 5000, "width": 160, "height": 120, "n_building": 10, "n_held_out": 3}
# Of the table: figures in the documents rest on it.
GOLDEN = {
    "means": 7054.8336,
    "scales": 182.20105,
    "colours": 12245.043,
    "cameras": 51.843866,
    "words": 2249.5792,
    "truth": 499158,
    "regions": 7822.3353,
}
STUDY_LAYOUTS = [name for name in LAYOUTS if name != "table"]


@cache
def things_of(layout: str) -> tuple[Thing, ...]:
    return LAYOUTS[layout].things()


@pytest.fixture(scope="module", params=STUDY_LAYOUTS)
def made(request: pytest.FixtureRequest) -> DemoScene:
    return make_demo_scene(layout=LAYOUTS[request.param], **SIZES)


def test_the_table_is_what_it_always_was():
    scene = well_lit_scene(0, 4000, 96, 72, 4, 2)
    assert scene.layout is TABLE
    found = {
        "means": scene.gaussians.means.double().square().sum(),
        "scales": scene.gaussians.scales.double().sum(),
        "colours": scene.gaussians.sh.double().square().sum(),
        "cameras": torch.stack([camera.viewmat for camera in scene.cameras]).square().sum(),
        "words": np.abs(scene.words.vectors).sum(),
        "truth": sum(int(view.astype(np.int64).sum()) for view in scene.part_maps.values()),
        "regions": sum(float(scene.regions.embeddings(level)[0].double().abs().sum()) for level in LEVELS),
    }
    assert {name: float(value) for name, value in found.items()} == pytest.approx(GOLDEN, rel=1e-4)


@pytest.mark.parametrize("name", STUDY_LAYOUTS)
def test_the_same_seed_gives_the_same_scene(name: str):
    sizes: dict[str, Any] = {"n_gaussians": 2000, "width": 48, "height": 36, "n_building": 1, "n_held_out": 1}
    first, again = (make_demo_scene(5, layout=LAYOUTS[name], **sizes) for _ in range(2))
    assert first.gaussians.fingerprint() == again.gaussians.fingerprint()
    assert torch.equal(first.gaussians.sh, again.gaussians.sh)
    for view, truth in first.part_maps.items():
        assert np.array_equal(truth, again.part_maps[view])
    for level in LEVELS:
        assert torch.equal(first.regions.embeddings(level)[0], again.regions.embeddings(level)[0])


def test_every_object_is_visible_and_can_be_queried(made: DemoScene):
    in_building = [made.labelled_frame(name) for name in made.building.names]
    views = {name: sum(name in frame.labels for frame in in_building) for name in made.parts.objects}
    assert np.mean([count > 0 for count in views.values()]) > 0.97
    queried = [label for name in made.held_out.names for label in made.labelled_frame(name).labels]
    assert len(queried) > 20
    # With twice as many views, as in the demo, it is more than nine in ten.
    assert np.mean([views[label] >= 2 for label in queried]) > 0.6
    names = dict.fromkeys(name for level in LEVELS for name in made.parts.names(level))
    assert made.text_vectors([*names, *CANONICAL]).norm(dim=1) == pytest.approx(1, abs=1e-5)
    assert all(made.level_of(name) in LEVELS for name in made.layout.favourites)


def test_every_pixel_shows_something(made: DemoScene):
    for truth in made.part_maps.values():
        assert (truth >= 0).mean() > 0.995


def test_no_camera_stands_in_a_thing(made: DemoScene):
    things = [
        thing
        for thing in things_of(made.layout.name)
        if thing.name not in {"wall", "floor", "lawn", "ceiling"}
    ]
    points = Surface.of(tuple(things), Parts.of(tuple(things))).mesh.vertices
    for camera in made.cameras:
        viewmat = camera.viewmat.numpy()
        eye = -viewmat[:3, :3].T @ viewmat[:3, 3]
        assert np.linalg.norm(points - eye, axis=1).min() > 0.5, camera.name


def test_layouts_differ_in_what_they_are_made_for():
    counts, views = {}, {}
    for name, layout in LAYOUTS.items():
        parts = Parts.of(things_of(name))
        counts[name] = len(parts.objects)
        rng = np.random.default_rng(0)
        building, _ = layout.cameras(24, 6, 48, 36, rng)
        looking = torch.stack([camera.viewmat[2, :3] for camera in building])
        views[name] = float(looking.mean(0).norm())  # 1: all look the same way; 0: every way
    assert counts["shelves"] >= 40 > counts["yard"]
    assert views["shelves"] > 0.9
    assert views["hall"] < 0.3
    assert views["yard"] < 0.45


def test_another_name_goes_to_the_parts_as_well():
    things = {thing.name: thing for thing in things_of("table")}
    mug = called(things["mug"], "green mug")
    assert {piece.part for piece in mug.pieces} == {
        "green mug body",
        "green mug handle",
        "coffee of the green mug",
    }
    bear = called(things["teddy bear"], "white bear")
    assert "white bear head" in {piece.part for piece in bear.pieces}
    assert {piece.part for piece in called(things["apple"], "pippin").pieces} == {"pippin"}


def test_paint_goes_to_the_first_piece_of_a_part():
    bear = next(thing for thing in things_of("table") if thing.name == "teddy bear")
    paint = bear.pieces[-1].paint
    changed = [
        piece.part
        for piece, before in zip(painted(bear, {"bear head": paint}).pieces, bear.pieces, strict=True)
        if piece.paint is not before.paint
    ]
    assert changed == ["bear head"]


def test_several_things_of_one_name_are_one_object():
    pot = things_of("table")[-1]
    parts = Parts.of(several(pot, pot.at(1, 0, 0)))
    assert len(parts.objects) == 1
    assert parts.several == {pot.name}
    with pytest.raises(InputError, match="different groups"):
        Parts.of(several(pot, pot.at(1, 0, 0, group="elsewhere")))
    with pytest.raises(InputError, match="two things"):
        Parts.of((pot, replace(pot, name="another pot")))


def test_several_things_have_a_box_each():
    mask = np.zeros((20, 30), bool)
    mask[2:6, 3:8] = mask[10:15, 20:29] = mask[18, 1] = True
    assert piece_boxes(mask, 5) == [(3, 2, 7, 5), (20, 10, 28, 14)]
