"""benchmarks/answers.py on a tiny scene: scores are those of the protocol, and the pairs kept give all figures."""

from __future__ import annotations

import functools
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from benchmarks import answers
from benchmarks.answer_scenes import SceneSize, make_scene
from benchmarks.left_out import TABLES
from benchmarks.study import run
from benchmarks.ways import WAYS

from messages import refuses
from scoup.base import UnknownNameError
from scoup.coding.exact import EFFORTS, ExactSettings
from scoup.uplift import build_settings, constants
from scoup_lab.baselines import rasterised_scene
from scoup_lab.baselines.method import DEFAULTS
from scoup_lab.baselines.sparse import SparseUplift
from scoup_lab.evaluate.metrics import bootstrap_interval
from scoup_lab.evaluate.protocols.lerf_ovs import PROTOCOL


@pytest.fixture(scope="module", autouse=True)
def one_scene():
    with pytest.MonkeyPatch.context() as patch:
        # The scene is the same for all tests, and takes longer to make than to be asked.
        patch.setattr(answers, "make_scene", functools.cache(make_scene))
        for effort in EFFORTS:  # what codes are best does not matter here
            patch.setitem(EFFORTS, effort, ExactSettings(steps=5, passes=1))
        yield


def tiny(**changes: Any) -> answers.Answers:
    size = SceneSize(2500, 64, 48, n_building=4, n_held_out=2)
    given: dict[str, Any] = {
        "scenes": ("table-0",),
        "ways": ("dense", "default"),
        "seeds": (0, 1),
        "size": size,
    }
    return answers.Answers(**{**given, "epochs": 3, **changes})


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
        if rule == "asked":  # dense uplift is no field, which cannot judge presence
            assert (other, kept["differences"]["default - dense"]["procedural"][rule]) == ([], None)
            continue
        shown = kept["ways"]["default"]["procedural"][rule]
        assert shown == pytest.approx(sum(one) / len(one), abs=1e-4)
        differences = [a - b for a, b in zip(one, other, strict=True)]
        expected = bootstrap_interval(differences, labels, scenes=["a"] * len(one))
        assert kept["differences"]["default - dense"]["procedural"][rule] == [
            pytest.approx(value, abs=1e-4) for value in (expected.mean, expected.low, expected.high)
        ]
    assert set(kept["ways"]["dense"]) == {"procedural"}


def test_what_cannot_be(tmp_path: Path) -> None:
    rows = tmp_path / "rows.json"
    rows.write_text(json.dumps({"settings": {"seeds": [9]}, "rows": {}}))
    with refuses():
        run(tiny(rows=rows), "answers")
    with refuses(UnknownNameError):
        run(tiny(ways=("defalt",)), "answers")


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
    monkeypatch.setattr(answers, "SETTINGS", ("table-0",))
    study = tiny(without=("LEAST_REGIONS", "INSIDE"), seeds=(0,), out=tmp_path / "a.json")
    assert (study.scenes, study.ways) == (
        ("table-0",),
        ("default", "without LEAST_REGIONS", "without INSIDE"),
    )
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
    assert len(answers.Answers(without=("all",)).ways) == 1 + sum(len(table.WITHOUT) for table in TABLES)
    with refuses(UnknownNameError):
        run(tiny(without=("NEAREST",)), "answers")
