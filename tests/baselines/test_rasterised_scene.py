"""A scene rasterised once: what is kept for the next method, and which views count."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from torch import Tensor

from scoup.uplift.build_settings import BuildSettings
from scoup.uplift.rasterise import region_sums
from scoup_lab.baselines.method import Method
from scoup_lab.baselines.pixel_rules import EveryNthPixel
from scoup_lab.baselines.rasterised_scene import Codes, RasterisedScene, spread_views
from scoup_lab.baselines.sparse import SparseUplift, learn_codes
from support import small_scene

SETTINGS = BuildSettings(n_atoms=4, k=2, effort="fast")


class CountingCoder:
    """Learns codes, and counts how often."""

    def __init__(self) -> None:
        self.calls = 0

    def __call__(self, embeddings: Sequence[Tensor], settings: BuildSettings) -> Codes:
        self.calls += 1
        return learn_codes(embeddings, settings)


def test_sums_are_made_once_for_equal_rules() -> None:
    scene = RasterisedScene(*small_scene(views=2))
    assert scene.region_sums() is scene.region_sums()
    assert scene.region_sums(EveryNthPixel(2)) is scene.region_sums(EveryNthPixel(2))
    assert scene.region_sums(EveryNthPixel(2)) is not scene.region_sums()
    assert scene.seconds(EveryNthPixel(2)) > 0
    assert scene.with_regions(scene.regions).region_sums() is not scene.region_sums()


def test_sums_that_are_given_are_taken() -> None:
    gaussians, cameras, regions = small_scene(views=2)
    sums = region_sums(gaussians, cameras, regions)
    scene = RasterisedScene(gaussians, cameras, regions, sums=sums)
    assert scene.region_sums() is sums
    assert scene.seconds() == 0


def test_codes_are_learned_once_for_settings_that_differ_in_the_vote() -> None:
    scene, coder = RasterisedScene(*small_scene(views=2)), CountingCoder()
    for changes in ({}, {"keep": 0}, {"rounds": 1}):
        scene.inputs().codes(coder, replace(SETTINGS, **changes))
        scene.inputs(EveryNthPixel(2)).codes(coder, SETTINGS)
    assert coder.calls == 1
    scene.inputs(views=0.5).codes(coder, SETTINGS)
    scene.inputs().codes(coder, replace(SETTINGS, seed=1))
    assert coder.calls == 3
    scene.forget_codes()
    scene.inputs().codes(coder, SETTINGS)
    assert coder.calls == 4


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
