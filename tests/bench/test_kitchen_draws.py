"""Draws of the kitchen with the statistics of a kind of embeddings, and the scenes of the study of answers by name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from benchmarks.answer_scenes import DrawName, SceneSize, make_scene
from benchmarks.embedding_kinds import KINDS, draw_hosts, draw_prototypes
from benchmarks.kitchen_draws import Truth, make_draw
from benchmarks.ways import groups_of

from messages import refuses
from scoup.base import UnknownNameError
from scoup.models import CANONICAL_PHRASES
from scoup_lab.synthetic.words import unit

NAMES = [f"thing {number}" for number in range(20)]


def random_words(rng: np.random.Generator, dim: int = 512) -> dict[str, np.ndarray]:
    """Text vectors with the cosines of names in CLIP."""
    words = (*NAMES, *CANONICAL_PHRASES, *(f"word {number}" for number in range(40)))
    rows = unit(0.75 * unit(rng.normal(size=dim)) + 0.66 * unit(rng.normal(size=(len(words), dim))))
    return dict(zip(words, rows, strict=True))


@pytest.mark.parametrize("name", KINDS)
def test_prototypes_have_the_cosines_of_their_kind(name: str) -> None:
    kind = KINDS[name]
    words = random_words(np.random.default_rng(0))
    of_name = {word: (2 * number, 2 * number + 1) for number, word in enumerate(NAMES)}
    prototypes = draw_prototypes(kind, words, of_name, 60, np.random.default_rng(1))
    assert np.linalg.norm(prototypes, axis=1) == pytest.approx(1)
    cosines = prototypes @ np.stack([words[word] for word in NAMES]).T
    mine = np.zeros(cosines.shape, bool)
    for column, numbers in enumerate(of_name.values()):
        mine[list(numbers), column] = True
    for drawn, (mean, spread) in ((cosines[mine], kind.own), (cosines[~mine], kind.others)):
        assert drawn.mean() == pytest.approx(mean, abs=4 * spread / len(drawn) ** 0.5)
        assert drawn.std() == pytest.approx(spread, rel=0.3)
    # Errors are per thing and word: what is left without their means has hardly any common part.
    left = np.where(mine, np.nan, cosines - kind.others[0])
    assert np.nanmean(left, 0).std() < kind.others[1] / 2
    assert np.nanmean(left, 1).std() < kind.others[1] / 2
    phrases = prototypes @ np.stack([words[phrase] for phrase in CANONICAL_PHRASES]).T
    assert phrases.mean() == pytest.approx(kind.phrases, abs=0.005)
    # Words that nothing is called are as near as other names.
    absent = prototypes @ np.stack([words[f"word {number}"] for number in range(40)]).T
    assert absent.mean() == pytest.approx(kind.others[0], abs=0.03)
    between = (prototypes @ prototypes.T)[np.triu_indices(60, 1)]
    assert np.median(between) == pytest.approx(kind.common, abs=0.08)


def test_things_are_swallowed_by_larger_neighbours() -> None:
    shown = np.zeros((12, 12), np.int64)  # 0 around all
    shown[2:10, 2:10] = 1
    shown[4:6, 4:6] = 2
    shown[6:9, 6:9] = 3
    shown[6:7, 8:9] = 4
    rng = np.random.default_rng(0)
    assert draw_hosts([shown], 6, [1, 2, 3, 4], 0.0, rng).tolist() == [0, 1, 2, 3, 4, 5]
    assert draw_hosts([shown], 6, [2, 5], 1.0, rng).tolist() == [0, 1, 1, 3, 4, 5]  # no view shows 5
    assert draw_hosts([shown], 6, [2, 3, 4], 1.0, rng)[[2, 3, 4]].tolist() == [1, 1, 1]
    for seed in range(5):
        hosts = draw_hosts([shown], 6, [2, 3, 4], 1 / 3, np.random.default_rng(seed))
        assert (hosts != np.arange(6)).sum() == 1


def test_names_of_scenes() -> None:
    assert DrawName.parse("kitchen-3") == DrawName(3, 1.0, None)
    assert DrawName.parse("kitchen-3x2") == DrawName(3, 2.0, None)
    assert DrawName.parse("kitchen-3-desk") == DrawName(3, 1.0, "desk")
    assert DrawName.parse("kitchen-3x1.5-clip") == DrawName(3, 1.5, "clip")
    assert DrawName.parse("kitchen") is DrawName.parse("table-0") is DrawName.parse("desk") is None
    with refuses(UnknownNameError):
        DrawName.parse("kitchen-3-desc")
    scenes = ["kitchen-11", "kitchen-12x2", "kitchen-11-desk", "kitchen-11-clip", "kitchen-12-desk"]
    scenes += ["desk", "desk-all", "table-1"]
    assert groups_of(scenes) == {
        "kitchen draws": ["kitchen-11"],
        "kitchen draws, noise x 2": ["kitchen-12x2"],
        "kitchen draws, desk's statistics": ["kitchen-11-desk", "kitchen-12-desk"],
        "kitchen draws, CLIP's statistics": ["kitchen-11-clip"],
        "desk (real)": ["desk", "desk-all"],
        "procedural": ["table-1"],
    }


@pytest.mark.data
@pytest.mark.slow
def test_draws_of_a_kind_differ_in_their_embeddings_alone(data_folder: Path) -> None:
    if not (data_folder / "kitchen").is_dir():
        pytest.skip(f"no kitchen in {data_folder}")
    truth = Truth.open(data_folder, 0.25)
    plain = make_draw(truth, 3)
    for kind in (None, *KINDS.values()):
        draw = make_draw(truth, 3, kind=kind)
        for (frame, _), (expected, _) in zip(draw.frames, plain.frames, strict=True):
            assert frame.labels == expected.labels
            assert all(torch.equal(frame.masks[label], expected.masks[label]) for label in frame.labels)
        rows, expected_rows = (of.regions.embeddings("l")[0] for of in (draw, plain))
        assert (rows.shape == expected_rows.shape and torch.equal(rows, expected_rows)) == (kind is None)


@pytest.mark.data
@pytest.mark.slow
def test_the_desk_is_a_scene(data_folder: Path) -> None:
    if not (data_folder / "desk").is_dir():
        pytest.skip(f"no desk in {data_folder}")
    scene = make_scene("desk-all", data_folder, SceneSize())
    assert len(scene.inputs().embeddings) == 3
    assert len(scene.frames) == 8
    assert len(scene.pairs) == 142
    assert set(scene.absent) < set(scene.words)
    assert not set(scene.absent) & {label for _, label in scene.pairs}
    assert len(scene.everyday) == len(scene.words) == 1588
    frame, view = scene.frames[0]
    assert (frame.width, frame.height) == (view.width, view.height)
