"""The whole way on the real scene: photographs' regions, splat and words, of which nothing is simulated."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from benchmarks.things import FACTS, VIEWER

import scoup
from cli_support import run
from scoup.query.phrases import Phrase, parse_phrase
from scoup.query.relation_rules import CONDITIONS, Shapes
from scoup_lab.data.labels import match_frames, read_labels

NAMES: tuple[str, ...] = ("kettle", "laptop computer", "penguin")
CONVERSES = {
    "left of": "right of", "right of": "left of", "in front of": "behind", "above": "under", "on": "under",
}  # fmt: skip
pytestmark = pytest.mark.data


@pytest.fixture(scope="module")
def desk(data_folder: Path) -> Path:
    folder = data_folder / "desk"
    if not folder.is_dir():
        pytest.skip(f"no desk in {data_folder}")
    return folder


@pytest.fixture(scope="module")
def field(desk: Path, tmp_path_factory: pytest.TempPathFactory) -> scoup.LanguageField:
    out = tmp_path_factory.mktemp("desk") / "desk.scoup"
    code, _, error = run("build", desk, "--gaussians", desk / "point_cloud.splat", "--out", out)
    assert code == 0, error
    return scoup.LanguageField.load(out, words=desk / "desk_words.npz")


def test_labelled_objects_are_the_answers_and_the_best_things(desk: Path, field: scoup.LanguageField) -> None:
    assert field.cameras is not None
    best, overlaps = [field.things([name])[0] for name in NAMES], []
    for frame, camera in match_frames(read_labels(desk / "label"), field.cameras):
        truths, view = frame.resized(camera.width, camera.height).masks, field.at(camera)
        for name, answer, thing in zip(NAMES, view.answer(list(NAMES)), best, strict=True):
            for mask in (answer.mask, view.mask_of(thing.gaussians)):
                overlaps.append(float((mask & truths[name]).sum() / (mask | truths[name]).sum()))
    of_objects = np.reshape(overlaps, (-1, len(NAMES), 2))
    assert (of_objects.mean(axis=0) > 0.5).all(), of_objects
    assert all(place.position is not None for place in field.location(list(NAMES)))


def test_relations_agree_with_their_converses(field: scoup.LanguageField) -> None:
    """Over all pairs of things of the middle level, whatever they are called."""
    frame = field.frame(VIEWER)
    things = [thing for thing in field.things() if thing.level == "m"]
    shapes, count = Shapes.of(field, things, frame), len(things)
    holds = {
        name: np.array(
            [[a != b and CONDITIONS[name](shapes, a, (b,)) for b in range(count)] for a in range(count)]
        )
        for name in (*CONVERSES, "behind", "under", "near")
    }
    assert all(relation.sum() > 20 for relation in holds.values())
    for name in ("left of", "right of", "in front of", "behind", "above", "under"):
        assert not (holds[name] & holds[name].T).any(), name
    for one, other in (("left of", "right of"), ("in front of", "behind")):
        assert not (holds[one] & holds[other]).any()
        # Each is measured by the size of what it refers to, so that one may hold where the other is not clear.
        either = holds[one] | holds[other].T
        assert (holds[one] & holds[other].T)[either].mean() > 0.75
    assert np.array_equal(holds["above"], holds["under"].T)
    assert not (holds["on"] & ~holds["under"].T).any()
    assert np.array_equal(holds["near"], holds["near"].T)


def test_facts_and_their_converses_are_answered_alike(field: scoup.LanguageField) -> None:
    frame, told = field.frame(VIEWER), 0
    for fact in FACTS:
        phrase = parse_phrase(fact)
        assert isinstance(phrase, Phrase)
        if phrase.relation in CONVERSES and field.things(field.question(fact, frame=frame)):
            converse = f"{phrase.anchors[0]} {CONVERSES[phrase.relation]} {phrase.text}"
            assert field.things(field.question(converse, frame=frame)), converse
            told += 1
    assert told > 8
