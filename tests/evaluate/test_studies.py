"""Every study on scenes of random regions, in memory: which rows there are, and what must be equal.

All of them compare with the four canonical phrases and nothing else, however many other words there are.
"""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import product
from pathlib import Path
from statistics import fmean
from typing import Any

import pytest
import torch
from torch import Tensor

from messages import refuses
from scoup.base import UnknownNameError
from scoup.models import CANONICAL_PHRASES, WordTable
from scoup.query import build
from scoup.uplift import BuildSettings
from scoup_lab.baselines.autoencoder import AutoencoderSettings
from scoup_lab.baselines.fitted import FittedField, FittedMethod
from scoup_lab.baselines.method import Method, MethodSettings
from scoup_lab.baselines.methods import METHODS
from scoup_lab.baselines.rasterised_scene import RasterisedScene, UpliftInputs
from scoup_lab.baselines.sparse import SparseUplift
from scoup_lab.bench.measure import Stopwatch
from scoup_lab.data.labels import LabelledFrame
from scoup_lab.evaluate.label_vectors import encode_labels
from scoup_lab.evaluate.protocols.lerf_ovs import PROTOCOL
from scoup_lab.evaluate.protocols.pixels import LabelledScene
from scoup_lab.evaluate.published import ABLATIONS as PUBLISHED
from scoup_lab.evaluate.report import Report
from scoup_lab.evaluate.rules import MASK_RULES
from scoup_lab.evaluate.studies.ablation_rows import (
    ABLATIONS,
    BASE,
    BESIDE_EVERYDAY,
    Ablation,
    find_ablations,
)
from scoup_lab.evaluate.studies.ablations import Ablations
from scoup_lab.evaluate.studies.comparison import Comparison, comparison_table
from scoup_lab.evaluate.studies.consistency import Consistency
from scoup_lab.evaluate.studies.study_scene import ScoringRule, StudyScene
from support import small_scene

LABELS = ("cup", "pot")
OTHER_WORDS = (*(f"word {number}" for number in range(30)), *CANONICAL_PHRASES)
RULE = MASK_RULES["scoup"]
QUICK = AutoencoderSettings(epochs=2, encoder=(8, 3), decoder=(8,))
SETTINGS = MethodSettings(build=BuildSettings(n_atoms=8, effort="fast", epochs=3), autoencoder=QUICK)


def make_study_scene(seed: int, folder: Path) -> StudyScene:
    """Four views, two of them labelled: each label is a region of the middle level and has its vector."""
    gaussians, cameras, regions = small_scene(120, seed=seed)
    frames = []
    for camera in list(cameras)[:2]:
        found = regions.load(camera.name, "m").labels
        masks = {label: found == number for number, label in enumerate(LABELS)}
        boxes = {label: torch.tensor([[0.0, 0.0, 39.0, 29.0]]) for label in LABELS}
        frames.append((LabelledFrame(camera.name, 40, 30, masks, boxes), camera))
    of_regions = regions.load(cameras[0].name, "m").embeddings[:2]
    others = torch.randn(len(OTHER_WORDS), 16, generator=torch.Generator().manual_seed(seed))
    WordTable.save(folder / "text.npz", (*LABELS, *OTHER_WORDS), torch.cat([of_regions, others]))
    labelled = LabelledScene(f"scene {seed}", folder, folder, folder, cameras, PROTOCOL, frames)
    vectors = encode_labels(labelled, str(folder / "text.npz"))
    return StudyScene(labelled, vectors, RasterisedScene(gaussians, cameras, regions))


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> list[StudyScene]:
    return [make_study_scene(seed, tmp_path_factory.mktemp(f"scene{seed}")) for seed in (0, 1)]


class Recorder:
    """A ``FittedMethod`` that keeps what it was compared with."""

    def __init__(self, fitted: FittedMethod, given: list[Tensor]) -> None:
        self.fitted, self.given = fitted, given

    def __getattr__(self, name: str) -> Any:
        if name not in ("relevancy", "gaussian_relevancy"):
            return getattr(self.fitted, name)

        def recorded(*arguments: Any) -> Tensor:
            self.given.append(arguments[2 if name == "relevancy" else 1])
            return getattr(self.fitted, name)(*arguments)

        return recorded


def recording(method: Method) -> tuple[Method, list[Tensor]]:
    """The method, and what it will be compared with."""
    given: list[Tensor] = []

    def uplift(inputs: UpliftInputs, settings: MethodSettings) -> Any:
        return Recorder(method.uplift(inputs, settings), given)

    return replace(method, uplift=uplift), given


def check_phrases(given: list[Tensor], scene: StudyScene) -> None:
    canonical = torch.from_numpy(WordTable.load(scene.labelled.splat / "text.npz").vectors[-4:])
    assert given
    for each in given:
        torch.testing.assert_close(each, canonical, atol=1e-6, rtol=0)


def test_evaluation_of_fields(scenes: list[StudyScene]) -> None:
    """In 2D and by selection."""
    scene, rasterised = scenes[0], scenes[0].rasterised
    assert len(scene.vectors.everyday) == len(LABELS) + 30
    assert len(scene.vectors.with_everyday().canonical) == 5  # there are enough words for a fifth
    built = build(rasterised.gaussians, rasterised.cameras, rasterised.regions, settings=SETTINGS.build)
    recorder: Any = Recorder(FittedField(built), [])
    clock, stages = Stopwatch(), []
    scene.scores(recorder, {"": ScoringRule(RULE)}, lambda *told: stages.append(told), clock)
    assert stages == [("scoring frames", done, 2) for done in range(3)]
    assert len(clock.seconds["query"]) == len(recorder.given) == 2
    scene.selection_score(recorder)
    assert len(recorder.given) == 4
    check_phrases([scene.vectors.canonical, *recorder.given], scene)
    for frame, camera in scene.labelled.frames:
        found = scene.relevancy(recorder, frame, camera)
        expected = built.relevancy(camera, scene.vectors.of(frame.labels), scene.vectors.canonical)
        torch.testing.assert_close(found.float(), expected, atol=2e-3, rtol=0)


def test_ablations_but_for_the_row_about_everyday_words(scenes: list[StudyScene]) -> None:
    settings = (RULE, (0,), 2)
    method, given = recording(BASE)
    rows = [replace(each, method=method) for each in find_ablations(["levels"]) if each.method is BASE]
    Ablations(rows, *settings).results(scenes[:1])
    check_phrases(given, scenes[0])
    given.clear()
    Ablations([Ablation("everyday", "phrases", method, BESIDE_EVERYDAY)], *settings).results(scenes[:1])
    assert {len(each) for each in given} == {5}


def check_report(report: Report, folder: Path) -> dict[str, Any]:
    """All of it can be written, and nothing is empty; the JSON, which holds the tables too."""
    assert all(table.rows for table in report.tables)
    assert len(report.write(folder)) == 3
    record = json.loads((folder / f"{report.stem}.json").read_text())
    for written, table in zip(record["tables"], report.tables, strict=True):
        assert written["rows"] == [list(row) for row in table.rows]
    return record


def check_pairs(record: dict[str, Any], ious: list[float], miou: float) -> None:
    """The pairs that a record keeps give its mean, each scene counting alike."""
    by_scene: dict[str, list[float]] = {}
    for (scene, _, label), iou in zip(record["pairs"], ious, strict=True):
        assert label in LABELS
        by_scene.setdefault(scene, []).append(iou)
    assert fmean(map(fmean, by_scene.values())) == pytest.approx(miou, abs=1e-3)


def test_comparison(scenes: list[StudyScene], tmp_path: Path) -> None:
    names = ("sparse", "dense", "centre-pixel", "top-45-contributors")
    methods, given = zip(*(recording(METHODS[name]) for name in names), strict=True)
    study = Comparison(methods, RULE, tmp_path / "kept", SETTINGS, selection=True)
    results = study.results(scenes)
    assert [(result.score.scene, result.method) for result in results] == [
        *product(("scene 0", "scene 1"), names)
    ]
    for each in given:
        check_phrases(each[: len(each) // 2], scenes[0])
        check_phrases(each[len(each) // 2 :], scenes[1])
    for result in results:
        assert min(result.fit_seconds, result.query_seconds) > 0
        assert result.selected is not None
    report = study.report(results, PROTOCOL.title, {"seed": 0})
    assert len(report.tables) == 3
    assert report.record["methods"]["dense"]["bytes_per_gaussian"] == 3 * 16 * 4
    assert report.record["seed"] == 0
    record = check_report(report, tmp_path)
    for row in record["methods"].values():
        check_pairs(record, row["iou"], row["miou"])
        check_pairs(record, row["selection_iou"], row["selection_miou"])


def test_results_are_kept_until_something_changes(scenes: list[StudyScene], tmp_path: Path) -> None:
    lines: list[str] = []
    autoencoder, given = recording(METHODS["autoencoder"])
    methods = [METHODS["centre-pixel"], autoencoder]
    study = Comparison(methods, RULE, tmp_path, SETTINGS, True, lines.append)
    stages: list[str] = []
    first = study.results(scenes[:1], lambda stage, *_: stages.append(stage))
    check_phrases(given, scenes[0])
    assert {"compare", "autoencoder", "scoring frames"} == set(stages) - {"region sums"}  # which are kept
    title = "autoencoder (2 of 100 epochs)"
    assert [result.method for result in first] == ["centre-pixel", title]
    assert lines[1].startswith(f"scene 0, {title}: mIoU ")
    assert title in comparison_table(first, "").markdown()
    assert repr(study.results(scenes[:1])) == repr(first)  # NaN differs from itself
    longer = replace(SETTINGS, autoencoder=replace(QUICK, epochs=3))
    assert [result.method for result in replace(study, settings=longer).results(scenes[:1])][1] != title
    replace(study, settings=replace(SETTINGS, seed=1)).results(scenes[:1])
    replace(study, rule=MASK_RULES["langsplat"]).results(scenes[:1])
    moved = replace(scenes[0], vectors=replace(scenes[0].vectors, canonical=-scenes[0].vectors.canonical))
    study.results([moved])
    before = [line.endswith(", kept from before") for line in lines]
    assert before == [False, False, True, True, True, *[False] * 7]


def test_each_method_of_a_comparison_learns_its_own_codes(scenes: list[StudyScene], tmp_path: Path) -> None:
    """Else the second would look cheaper than it is."""
    calls: list[str] = []
    sparse = METHODS["sparse"]

    def uplift(inputs: UpliftInputs, settings: MethodSettings) -> Any:
        calls.append("kept" if inputs.kept_codes else "new")
        return sparse.uplift(inputs, settings)

    methods = [replace(sparse, name=name, uplift=uplift) for name in "ab"]
    Comparison(methods, RULE, tmp_path, SETTINGS).results(scenes[:1])
    assert calls == ["new", "new"]


def test_ablations(scenes: list[StudyScene], tmp_path: Path) -> None:
    rows = find_ablations(["vote", "levels", "phrases"])
    study = Ablations(rows, RULE, (0, 1), 2)
    results = {each.ablation.name: each for each in study.results(scenes[:1])}
    base = results[ABLATIONS[0].name]
    assert list(base.scores) == [0, 1]
    assert list(results["dense uplift"].scores) == [0]
    assert results["level by mask"].by_seed() != base.by_seed()
    report = study.report(list(results.values()), PROTOCOL.title, {})
    assert list(report.record["rows"]) == [row.name for row in rows]
    record = check_report(report, tmp_path)
    for row in record["rows"].values():
        check_pairs(record, row["iou"], row["miou"])
        assert row["minus_base"][0] == pytest.approx(row["miou"] - base.interval().mean)


@pytest.mark.slow
def test_all_ablations(scenes: list[StudyScene], tmp_path: Path) -> None:
    study = Ablations(ABLATIONS, RULE, (0,), 3)
    check_report(study.report(study.results(scenes), PROTOCOL.title, {}), tmp_path)


def test_consistency(scenes: list[StudyScene], tmp_path: Path) -> None:
    study = Consistency(SETTINGS.build, QUICK)
    report = study.report(study.results(scenes[:1]), PROTOCOL.title, {})
    assert report.record["matched_by"] == {"scene 0": "Gaussians"}
    check_report(report, tmp_path)


def test_rows_of_the_ablations_and_their_rules() -> None:
    rules = {each.name: each.rule(RULE) for each in ABLATIONS}
    assert [name for name, rule in rules.items() if rule.everyday] == ["beside everyday words"]
    assert rules["level by mask"].mask_rule.level_choice == "mask"
    assert rules["beside everyday words"].mask_rule == RULE
    names = [each.name for each in ABLATIONS]
    assert len(set(names)) == len(names)
    assert {each.published for each in ABLATIONS} - {""} == set(PUBLISHED)
    uplifts = [each.method.uplift for each in ABLATIONS if isinstance(each.method.uplift, SparseUplift)]
    sizes = {(each.changes.get("n_atoms"), each.changes.get("k", 4)) for each in uplifts}
    assert {(32, 4), (64, 4), (128, 4), (64, 2), (64, 8)} <= sizes
    chosen = find_ablations(["atoms"])
    assert chosen[0].name == ABLATIONS[0].name
    assert {each.group for each in chosen[1:]} == {"atoms"}
    assert find_ablations([]) == list(ABLATIONS)
    assert [each.name for each in ABLATIONS if each.is_base] == [ABLATIONS[0].name]
    with refuses(UnknownNameError):
        find_ablations(["atom"])
