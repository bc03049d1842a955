"""Vectors of words and of things have the statistics that the documentation states."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.scenes import LAYOUTS

from scoup.scene import LEVELS
from scoup_lab.synthetic.art.things import Parts
from scoup_lab.synthetic.words import CANONICAL, DISTRACTORS, Words, make_words

PARTS = {name: Parts.of(layout.things()) for name, layout in LAYOUTS.items()}


@pytest.fixture(scope="module", params=[(name, seed) for name in LAYOUTS for seed in (0, 1)], ids=str)
def made(request: pytest.FixtureRequest) -> tuple[Parts, Words]:
    name, seed = request.param
    return PARTS[name], make_words(PARTS[name], np.random.default_rng(seed))


@pytest.fixture(scope="module")
def words() -> Words:
    return make_words(PARTS["table"], np.random.default_rng(0))


def meetings(parts: Parts, words: Words) -> tuple[np.ndarray, list[str], np.ndarray]:
    """Cosines [names, texts], the names, and the prototypes [names, D]."""
    first = {name: (level, row) for level in reversed(LEVELS) for row, name in enumerate(parts.names(level))}
    names = list(first)
    prototypes = np.stack([words.prototypes[level][row] for level, row in first.values()])
    return prototypes @ words.vectors.T, names, prototypes


def test_everything_is_there_and_unit(made: tuple[Parts, Words]):
    parts, words = made
    for level in LEVELS:
        assert words.prototypes[level].shape == (len(parts.names(level)), 512)
        assert np.linalg.norm(words.prototypes[level], axis=1) == pytest.approx(1)
    assert np.linalg.norm(words.vectors, axis=1) == pytest.approx(1)
    assert len(set(words.texts)) == len(words.texts)
    assert {*CANONICAL, *DISTRACTORS, *parts.objects, *parts.parts, *parts.groups} == set(words.texts)
    assert not set(DISTRACTORS) & {*parts.objects, *parts.parts, *parts.groups}


def test_each_name_finds_its_own_prototype(made: tuple[Parts, Words]):
    parts, words = made
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


def test_texts_and_images_are_as_alike_as_in_clip(made: tuple[Parts, Words]):
    parts, words = made
    _, names, prototypes = meetings(parts, words)
    upper = np.triu_indices(len(names), 1)
    texts = np.stack([words.vector(name) for name in names])
    assert 0.52 < np.median((texts @ texts.T)[upper]) < 0.62
    assert 0.48 < np.median((prototypes @ prototypes.T)[upper]) < 0.62
    phrases = np.stack([words.vector(phrase) for phrase in CANONICAL])
    assert 0.68 < (phrases @ phrases.T)[np.triu_indices(4, 1)].mean() < 0.82


def test_kin_are_closer_than_strangers(words: Words):
    pot = words.vector("teapot") @ words.vector("teapot lid")
    stranger = words.vector("teapot") @ words.vector("duck beak")
    assert pot > stranger + 0.1
