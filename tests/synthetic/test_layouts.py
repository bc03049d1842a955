"""Every layout: the same scene each time, every object in sight, and words with the statistics of the documents."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from benchmarks.scenes import LAYOUTS

from messages import refuses
from scoup.scene import LEVELS
from scoup_lab.synthetic import TABLE, DemoScene, make_demo_scene
from scoup_lab.synthetic.art.things import Parts
from scoup_lab.synthetic.masks import piece_boxes
from scoup_lab.synthetic.words import CANONICAL, DISTRACTORS, Words, make_words

SIZES: dict[str, Any] = {"n_gaussians": 5000, "width": 160, "height": 120, "n_building": 10, "n_held_out": 3}
SEEDS = {name: seed for seed, name in enumerate(LAYOUTS)}
MASKS = {
    "table": "1220221db0625b6c", "shelves": "fb69e8d6ba10f43f", "hall": "257f88c28da90200", "yard": "7c1e688251f5da20",
}  # fmt: skip
"""Hashes of the masks of every layout, each of another seed, as the program made them from which the meshes were kept
(``scoup_lab.synthetic.art.baked``)."""
COLORS = {"table": 17008.3065, "shelves": 17574.4468, "hall": 15869.774, "yard": 16048.4729}
"""The sum of squares of the colours of these scenes."""


def hash_of_masks(scene: DemoScene) -> str:
    digest = hashlib.sha256()
    for view in scene.part_maps.values():
        digest.update(view.astype("<i4").tobytes())
    return digest.hexdigest()[:16]


@pytest.fixture(scope="module", params=LAYOUTS)
def made(request: pytest.FixtureRequest) -> DemoScene:
    return make_demo_scene(SEEDS[request.param], layout=LAYOUTS[request.param], **SIZES)


def test_scenes_are_what_they_always_were(made: DemoScene):
    assert hash_of_masks(made) == MASKS[made.layout.name]
    colors = float(made.gaussians.sh.double().square().sum())
    assert colors == pytest.approx(COLORS[made.layout.name], rel=1e-4)


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


def test_several_things_of_one_name_are_one_object():
    pot = replace(TABLE.things()[-1], several=True)
    parts = Parts.of((pot, replace(pot, place=np.array([1.0, 0, 0]))))
    assert len(parts.objects) == 1
    assert parts.several == {pot.name}
    for change in ({"group": "elsewhere"}, {"name": "another pot"}):
        with refuses():
            Parts.of((pot, replace(pot, **change)))
    # Each thing has a box.
    mask = np.zeros((20, 30), bool)
    mask[2:6, 3:8] = mask[10:15, 20:29] = mask[18, 1] = True
    assert piece_boxes(mask, 5) == [(3, 2, 7, 5), (20, 10, 28, 14)]


PARTS = {name: Parts.of(layout.things()) for name, layout in LAYOUTS.items()}


@pytest.fixture(scope="module", params=LAYOUTS)
def vocabulary(request: pytest.FixtureRequest) -> tuple[Parts, Words]:
    parts = PARTS[request.param]
    return parts, make_words(parts, np.random.default_rng(SEEDS[request.param]))


def meetings(parts: Parts, words: Words) -> tuple[np.ndarray, list[str], np.ndarray]:
    """Cosines [names, texts], the names, and the prototypes [names, D]."""
    first = {name: (level, row) for level in reversed(LEVELS) for row, name in enumerate(parts.names(level))}
    names = list(first)
    prototypes = np.stack([words.prototypes[level][row] for level, row in first.values()])
    return prototypes @ words.vectors.T, names, prototypes


def test_everything_is_there_and_unit(vocabulary: tuple[Parts, Words]):
    parts, words = vocabulary
    for level in LEVELS:
        assert words.prototypes[level].shape == (len(parts.names(level)), 512)
        assert np.linalg.norm(words.prototypes[level], axis=1) == pytest.approx(1)
    assert np.linalg.norm(words.vectors, axis=1) == pytest.approx(1)
    assert len(set(words.texts)) == len(words.texts)
    assert {*CANONICAL, *DISTRACTORS, *parts.objects, *parts.parts, *parts.groups} == set(words.texts)
    assert not set(DISTRACTORS) & {*parts.objects, *parts.parts, *parts.groups}


def test_each_name_finds_its_own_prototype(vocabulary: tuple[Parts, Words]):
    parts, words = vocabulary
    cosines, names, _ = meetings(parts, words)
    own = np.array([words.texts.index(name) for name in names])
    right = cosines[np.arange(len(names)), own]
    assert right.min() > 0.25
    assert right.max() < 0.32
    among = cosines[:, own]
    assert (among.argmax(0) == np.arange(len(names))).all()
    others = among[~np.eye(len(names), dtype=bool)]
    assert 0.14 < np.median(others) < 0.21
    assert np.quantile(others, 0.95) < 0.25
    canonical = cosines[:, [words.texts.index(phrase) for phrase in CANONICAL]]
    assert 0.14 < np.median(canonical) < 0.22
    assert canonical.max() < right.min()
    absent = cosines[:, [words.texts.index(word) for word in DISTRACTORS]]
    assert 0.14 < np.median(absent) < 0.21
    assert absent.max() < right.min() - 0.03


def test_texts_and_images_are_as_alike_as_in_clip(vocabulary: tuple[Parts, Words]):
    parts, words = vocabulary
    _, names, prototypes = meetings(parts, words)
    upper = np.triu_indices(len(names), 1)
    texts = np.stack([words.vector(name) for name in names])
    assert 0.52 < np.median((texts @ texts.T)[upper]) < 0.62
    assert 0.48 < np.median((prototypes @ prototypes.T)[upper]) < 0.62
    phrases = np.stack([words.vector(phrase) for phrase in CANONICAL])
    assert 0.68 < (phrases @ phrases.T)[np.triu_indices(4, 1)].mean() < 0.82
    if "teapot" in words.texts:  # kin are closer than strangers
        kin, stranger = (
            words.vector("teapot") @ words.vector(other) for other in ("teapot lid", "duck beak")
        )
        assert kin > stranger + 0.1
