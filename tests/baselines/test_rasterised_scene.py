"""A scene rasterised once: what is kept for the next method, and which views count."""

from __future__ import annotations

from dataclasses import replace
from unittest.mock import Mock

import pytest

from scoup.uplift import BuildSettings
from scoup_lab.baselines import rasterised_scene
from scoup_lab.baselines.method import Method
from scoup_lab.baselines.pixel_rules import CentrePixel
from scoup_lab.baselines.rasterised_scene import RasterisedScene, spread_views
from scoup_lab.baselines.sparse import SparseUplift
from support import small_scene

SETTINGS = BuildSettings(n_atoms=4, k=2, effort="fast")


def test_sums_are_made_once_for_equal_rules() -> None:
    scene = RasterisedScene(*small_scene(views=2))
    assert scene.region_sums() is scene.region_sums()
    assert scene.region_sums(CentrePixel()) is scene.region_sums(CentrePixel())
    assert scene.region_sums(CentrePixel()) is not scene.region_sums()
    assert scene.seconds(CentrePixel()) > 0


def test_codes_are_learned_once_for_settings_that_differ_in_the_vote(monkeypatch: pytest.MonkeyPatch) -> None:
    scene, learn = RasterisedScene(*small_scene(views=2)), Mock(wraps=rasterised_scene.learn_codes)
    monkeypatch.setattr(rasterised_scene, "learn_codes", learn)
    for changes in ({}, {"keep": 0}, {"rounds": 1}):
        scene.inputs().codes(replace(SETTINGS, **changes))
        scene.inputs(CentrePixel()).codes(SETTINGS)
    assert learn.call_count == 1
    scene.inputs(views=0.5).codes(SETTINGS)
    scene.inputs().codes(replace(SETTINGS, seed=1))
    assert learn.call_count == 3
    scene.forget_codes()
    scene.inputs().codes(SETTINGS)
    assert learn.call_count == 4


def test_views_are_spread_evenly_and_keep_their_order() -> None:
    scene = RasterisedScene(*small_scene(views=4))
    names = scene.regions.view_names
    assert spread_views(scene.regions, 0.5).view_names == (names[1], names[3])
    assert spread_views(scene.regions, 0.01).view_names == (names[2],)
    inputs = scene.inputs(views=0.5)
    assert list(inputs.sums.views) == [names[1], names[3]]
    assert [len(rows) for rows in inputs.embeddings] == [
        len(spread_views(scene.regions, 0.5).embeddings(level)[0]) for level in scene.regions.levels
    ]
    fitted = Method("half", SparseUplift(n_atoms=4, k=2), views=0.5).fit(scene)
    assert fitted.coded().any()
