"""The study of answers on a tiny scene: scores, pairs that are kept, and draws of the kitchen."""

from __future__ import annotations

import functools
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from benchmarks import answers
from benchmarks.answer_scenes import DrawName, SceneSize, make_scene
from benchmarks.embedding_kinds import KINDS, draw_hosts, draw_prototypes
from benchmarks.kitchen_draws import Truth, make_draw
from benchmarks.left_out import LEFT_OUT
from benchmarks.study import run
from benchmarks.ways import WAYS, groups_of

from messages import refuses
from scoup.base import UnknownNameError
from scoup.coding.exact import EFFORTS, ExactSettings
from scoup.models import CANONICAL_PHRASES
from scoup.uplift import build_settings, constants
from scoup_lab.baselines import rasterised_scene
from scoup_lab.baselines.method import DEFAULTS
from scoup_lab.baselines.sparse import SparseUplift
from scoup_lab.evaluate.metrics import bootstrap_interval
from scoup_lab.evaluate.protocols.lerf_ovs import PROTOCOL
from scoup_lab.synthetic.words import unit


@pytest.fixture(scope="module", autouse=True)
def one_scene():
    with pytest.MonkeyPatch.context() as patch:
        # The scene is the same for all tests, and takes longer to make than to be asked.
        patch.setattr(answers, "make_scene", functools.cache(make_scene))
        for effort in EFFORTS:  # what codes are best does not matter here
            patch.setitem(EFFORTS, effort, ExactSettings(steps=5, passes=1))
        yield


def tiny(**changes: Any) -> answers.Answers:
    given: dict[str, Any] = {
        "scenes": ("table-0",), "ways": ("dense", "default"), "seeds": (0, 1), "epochs": 3,
        "size": SceneSize(2500, 64, 48, n_building=4, n_held_out=2),
    }  # fmt: skip
    return answers.Answers(**{**given, **changes})


def test_scores_are_those_of_the_protocol() -> None:
    study = tiny()
    scene = answers.make_scene("table-0", study.data, study.size)
    fitted = WAYS["default"].uplift(scene.inputs(), DEFAULTS)
    found = answers.score(scene, fitted)
    expected = []
    for frame, view in scene.frames:
        queries = torch.stack([scene.queries[label] for label in frame.labels])
        maps = fitted.relevancy(view, queries, scene.canonical)
        expected += PROTOCOL.score_frame(frame, maps)
    assert found["peak"] == [pair.iou for pair in expected]
    assert found["localisation"] == [float(bool(pair.hit)) for pair in expected]
    assert scene.pairs == [(pair.frame, pair.label) for pair in expected]
    assert len(found["always"]) == len(found["asked"]) == len(scene.pairs)
    assert all(asked in (0, always) for asked, always in zip(found["asked"], found["always"], strict=True))


def test_kept_pairs_give_the_means_and_differences(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, rows = tmp_path / "answers.json", tmp_path / "rows.json"
    run(tiny(ways=("dense",), rows=rows), "answers")
    before = json.loads(rows.read_text())["rows"]
    run(tiny(rows=rows, out=out), "answers")
    printed, kept = capsys.readouterr().err, json.loads(out.read_text())
    assert printed.count("table-0/dense: peak") == 1  # what was there was not run again
    scores = kept["scores"]["table-0"]
    assert scores["dense"] == before["table-0/dense"]["scores"]
    labels = [label for _, label in kept["pairs"]["table-0"]]
    for rule in answers.RULES:
        one, other = (scores[way][rule] for way in ("default", "dense"))
        if rule == "names":  # of simulated scenes, which have one name for each object
            assert (one, other, kept["differences"]["default - dense"]["procedural"][rule]) == ([], [], None)
            continue
        if rule == "asked":  # dense uplift is no field, which cannot judge presence
            assert (other, kept["differences"]["default - dense"]["procedural"][rule]) == ([], None)
            continue
        shown = kept["ways"]["default"]["procedural"][rule]
        assert shown == pytest.approx(sum(one) / len(one), abs=1e-4)
        differences = [a - b for a, b in zip(one, other, strict=True)]
        groups = sorted(set(labels)) if rule == "scene" else labels
        expected = bootstrap_interval(differences, groups, scenes=["a"] * len(one))
        assert kept["differences"]["default - dense"]["procedural"][rule] == [
            pytest.approx(value, abs=1e-4) for value in (expected.mean, expected.low, expected.high)
        ]
    assert set(kept["ways"]["dense"]) == {"procedural"}


def test_ways_are_what_their_names_say() -> None:
    def build_of(name: str):
        uplift = WAYS[name].uplift
        assert isinstance(uplift, SparseUplift)
        return replace(DEFAULTS.build, **uplift.changes)

    default = build_settings("default")
    assert (build_of("default"), build_of("paper")) == (default, build_settings("paper"))
    assert build_of("votes") == replace(default, things=False)
    assert {name for pair in answers.COMPARED for name in pair} <= set(WAYS)


def test_constants_are_left_out_one_at_a_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    study = tiny(without=("LEAST_REGIONS", "INSIDE"), seeds=(0,), out=tmp_path / "a.json")
    assert study.ways == ("default", "without LEAST_REGIONS", "without INSIDE")
    seen = []
    find_things = rasterised_scene.find_things

    def watched(*given: Any) -> Any:
        seen.append((constants.LEAST_REGIONS, constants.INSIDE))
        return find_things(*given)

    monkeypatch.setattr(rasterised_scene, "find_things", watched)
    record = run(study, "answers")
    assert seen == [(2, 0.5), (1, 0.5), (2, 1.0)]
    assert (constants.LEAST_REGIONS, constants.INSIDE) == (2, 0.5)
    assert set(record["differences"]) == {"default - without LEAST_REGIONS", "default - without INSIDE"}
    assert len(answers.Answers(without=("all",)).ways) == 1 + sum(map(len, LEFT_OUT.values()))
    assert all(
        getattr(table, name) != neutral for table, of in LEFT_OUT.items() for name, neutral in of.items()
    )
    for unknown in ({"without": ("NEAREST",)}, {"ways": ("defalt",)}):
        with refuses(UnknownNameError):
            run(tiny(**unknown), "answers")


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
    assert all(np.nanmean(left, axis).std() < kind.others[1] / 2 for axis in (0, 1))
    phrases = prototypes @ np.stack([words[phrase] for phrase in CANONICAL_PHRASES]).T
    assert phrases.mean() == pytest.approx(kind.phrases, abs=0.005)
    # Words that nothing is called are as near as other names.
    absent = prototypes @ np.stack([words[f"word {number}"] for number in range(40)]).T
    assert absent.mean() == pytest.approx(kind.others[0], abs=0.03)
    between = (prototypes @ prototypes.T)[np.triu_indices(60, 1)]
    assert np.median(between) == pytest.approx(kind.common, abs=0.08)


def test_things_are_swallowed_by_larger_neighbours() -> None:
    shown = np.zeros((12, 12), np.int64)  # 0 around all
    shown[2:10, 2:10], shown[4:6, 4:6], shown[6:9, 6:9], shown[6:7, 8:9] = 1, 2, 3, 4
    rng = np.random.default_rng(0)
    assert draw_hosts([shown], 6, [1, 2, 3, 4], 0.0, rng).tolist() == [0, 1, 2, 3, 4, 5]
    assert draw_hosts([shown], 6, [2, 5], 1.0, rng).tolist() == [0, 1, 1, 3, 4, 5]  # no view shows 5
    assert draw_hosts([shown], 6, [2, 3, 4], 1.0, rng)[[2, 3, 4]].tolist() == [1, 1, 1]
    for seed in range(5):
        hosts = draw_hosts([shown], 6, [2, 3, 4], 1 / 3, np.random.default_rng(seed))
        assert (hosts != np.arange(6)).sum() == 1


def test_names_of_scenes() -> None:
    names = {
        "kitchen-3": DrawName(3, 1.0, None), "kitchen-3-desk": DrawName(3, 1.0, "desk"),
        "kitchen-3x1.5-clip": DrawName(3, 1.5, "clip"), "kitchen": None, "table-0": None, "desk": None,
    }  # fmt: skip
    assert {name: DrawName.parse(name) for name in names} == names
    with refuses(UnknownNameError):
        DrawName.parse("kitchen-3-desc")
    scenes = ["kitchen-11", "kitchen-12x2", "kitchen-11-desk", "kitchen-11-clip", "kitchen-12-desk"]
    scenes += ["desk", "desk-all", "table-1"]
    assert groups_of(scenes) == {
        "kitchen draws": ["kitchen-11"], "kitchen draws, noise x 2": ["kitchen-12x2"],
        "kitchen draws, desk's statistics": ["kitchen-11-desk", "kitchen-12-desk"],
        "kitchen draws, CLIP's statistics": ["kitchen-11-clip"],
        "desk (real)": ["desk", "desk-all"], "procedural": ["table-1"],
    }  # fmt: skip


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
    assert (len(scene.inputs().embeddings), len(scene.frames), len(scene.pairs)) == (3, 8, 142)
    assert set(scene.absent) < set(scene.words)
    assert not set(scene.absent) & {label for _, label in scene.pairs}
    assert len(scene.everyday) == len(scene.words) == 1588
    frame, view = scene.frames[0]
    assert (frame.width, frame.height) == (view.width, view.height)
