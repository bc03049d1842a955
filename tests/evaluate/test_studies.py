"""Every study on scenes of random regions, in memory: which rows there are, and what must be equal."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from statistics import fmean
from typing import Any

import pytest
import torch

from evaluate.study_scenes import LABELS, study_scene
from messages import refuses
from scoup import raster
from scoup.query import TextVectors
from scoup.scene import Regions, SparseCodes
from scoup.uplift import BuildSettings
from scoup_lab.baselines.autoencoder import AutoencoderSettings
from scoup_lab.baselines.fitted import FittedField
from scoup_lab.baselines.method import MethodSettings
from scoup_lab.baselines.methods import METHODS
from scoup_lab.evaluate.protocols.lerf_ovs import PROTOCOL
from scoup_lab.evaluate.protocols.pixels import LabelledScene
from scoup_lab.evaluate.report import Report
from scoup_lab.evaluate.rules import MASK_RULES
from scoup_lab.evaluate.studies.ablation_rows import ABLATIONS, find_ablations
from scoup_lab.evaluate.studies.ablations import Ablations
from scoup_lab.evaluate.studies.comparison import Comparison, comparison_table
from scoup_lab.evaluate.studies.consistency import Consistency
from scoup_lab.evaluate.studies.study_scene import ScoringRule, StudyScene
from support import unit

RULE = MASK_RULES["scoup"]
SETTINGS = MethodSettings(build=BuildSettings(n_atoms=8, effort="fast", epochs=3))


def vectors(*texts: str, seed: int = 0) -> TextVectors:
    """Random unit vectors, with twenty everyday words."""
    generator = torch.Generator().manual_seed(seed)
    queries, canonical, everyday = (
        unit(torch.randn(count, 16, generator=generator)) for count in (len(texts), 4, 20)
    )
    return TextVectors(texts, queries, canonical, everyday, "random")


def make_study_scene(seed: int, folder: Path) -> StudyScene:
    """The vector of each label is that of its region."""

    def of_regions(labelled: LabelledScene, regions: Regions) -> TextVectors:
        rows = regions.load(labelled.frames[0][1].name, "m").embeddings[:2]
        return replace(vectors(*LABELS, seed=seed), queries=unit(rows))

    return study_scene(f"scene {seed}", folder, of_regions, seed)


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> list[StudyScene]:
    return [make_study_scene(seed, tmp_path_factory.mktemp(f"scene{seed}")) for seed in (0, 1)]


def check_report(report: Report, folder: Path) -> dict[str, Any]:
    """All of it can be written, and nothing is empty; the JSON, which holds the tables too."""
    assert all(table.rows for table in report.tables)
    written = report.write(folder)
    assert len(written) == 3
    record = json.loads((folder / f"{report.stem}.json").read_text())
    assert [table["rows"] for table in record["tables"]] == [
        [list(row) for row in t.rows] for t in report.tables
    ]
    return record


def check_pairs(record: dict[str, Any], ious: list[float], miou: float) -> None:
    """The pairs that a record keeps give its mean, each scene counting alike."""
    by_scene: dict[str, list[float]] = {}
    for (scene, _, label), iou in zip(record["pairs"], ious, strict=True):
        assert label in LABELS
        by_scene.setdefault(scene, []).append(iou)
    assert fmean(map(fmean, by_scene.values())) == pytest.approx(miou, abs=1e-3)


def test_comparison(scenes: list[StudyScene], tmp_path: Path) -> None:
    methods = [METHODS[name] for name in ("sparse", "dense", "centre-pixel")]
    study = Comparison(methods, RULE, tmp_path / "kept", SETTINGS, selection=True)
    results = study.results(scenes)
    assert [(result.method, result.score.scene) for result in results] == [
        (method.name, scene.name) for scene in scenes for method in methods
    ]
    for result in results:
        assert result.fit_seconds > 0
        assert result.query_seconds > 0
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
    methods = [METHODS["centre-pixel"], METHODS["autoencoder"]]
    quick = AutoencoderSettings(epochs=2, encoder=(8, 3), decoder=(8,))
    study = Comparison(methods, RULE, tmp_path, replace(SETTINGS, autoencoder=quick), True, lines.append)
    stages: list[str] = []
    first = study.results(scenes[:1], lambda stage, *_: stages.append(stage))
    assert {"compare", "autoencoder"} == set(stages)
    title = "autoencoder (2 of 100 epochs)"
    assert [result.method for result in first] == ["centre-pixel", title]
    assert lines[1].startswith(f"scene 0, {title}: mIoU ")
    assert title in comparison_table(first, "").markdown()
    assert repr(study.results(scenes[:1])) == repr(first)  # NaN differs from itself
    longer = replace(study.settings, autoencoder=replace(quick, epochs=3))
    assert [result.method for result in replace(study, settings=longer).results(scenes[:1])][1] != title
    replace(study, settings=replace(study.settings, seed=1)).results(scenes[:1])
    replace(study, rule=MASK_RULES["langsplat"]).results(scenes[:1])
    moved = replace(scenes[0], vectors=replace(scenes[0].vectors, canonical=-scenes[0].vectors.canonical))
    study.results([moved])
    before = [line.endswith(", kept from before") for line in lines]
    assert before == [False, False, True, True, True, *[False] * 7]


def test_each_method_of_a_comparison_learns_its_own_codes(scenes: list[StudyScene], tmp_path: Path) -> None:
    """Else the second would look cheaper than it is."""
    calls: list[str] = []
    sparse = METHODS["sparse"]

    def uplift(inputs, settings):
        calls.append("kept" if inputs.kept_codes else "new")
        return sparse.uplift(inputs, settings)

    Comparison(
        [replace(sparse, name=name, uplift=uplift) for name in "ab"], RULE, tmp_path, SETTINGS
    ).results(scenes[:1])
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


def test_rules_choose_levels(scenes: list[StudyScene]) -> None:
    scene = scenes[0]
    fitted = METHODS["dense"].fit(scene.rasterised)
    rules = {level: ScoringRule(RULE, (level,)) for level in ("s", "m", "l")}
    scores = scene.scores(fitted, {**rules, "all": ScoringRule(RULE)})
    peaks = [max(scores[level].pairs[0].score for level in rules), scores["all"].pairs[0].score]
    assert peaks[0] == peaks[1]
    assert scores["all"].pairs == scene.score(fitted, RULE).pairs


def test_what_is_dropped_from_blending_hides_nothing(scenes: list[StudyScene]) -> None:
    """Each level is drawn from the Gaussians with a code alone; drawn with the others, these hide some of it."""
    scene = scenes[0]
    row = next(each for each in ABLATIONS if each.name.endswith("highest entropy, dropped from blending"))
    fitted = row.method.fit(scene.rasterised, SETTINGS)
    rules = {"kept": ScoringRule(RULE), "dropped": row.rule(RULE)}
    assert isinstance(fitted, FittedField)
    gaussians, codebook = scene.rasterised.gaussians, fitted.field.codebook
    for (frame, maps), (_, camera) in zip(
        scene.maps(fitted, rules.values()), scene.labelled.frames, strict=True
    ):
        queries, canonical = scene.vectors.of(frame.labels), scene.vectors.canonical
        for level, coded in enumerate(fitted.coded()):
            assert 0 < int(coded.sum()) < len(gaussians)
            indices, weights = (
                part[coded, level] for part in (fitted.field.code_indices, fitted.field.code_weights)
            )
            codes = SparseCodes(indices, weights.float(), codebook.shape[1])
            projection = raster.project(gaussians.select(coded), camera)
            image = raster.render_channels(projection, codes.to_dense() @ codebook[level])[0]
            cosines = unit(image) @ torch.cat([queries, canonical]).T
            expected = torch.sigmoid(10 * (cosines[..., :2, None] - cosines[..., None, 2:])).amin(-1)
            expected[image.abs().sum(-1) == 0] = 0.5
            torch.testing.assert_close(maps[False, True][level], expected.permute(2, 0, 1), atol=2e-3, rtol=0)
            assert not torch.allclose(maps[False, False][level], maps[False, True][level], atol=1e-2)
    scores = scene.scores(fitted, rules)
    assert scores["kept"].pairs != scores["dropped"].pairs
    with refuses():
        scene.scores(METHODS["dense"].fit(scene.rasterised), rules)


def test_consistency(scenes: list[StudyScene], tmp_path: Path) -> None:
    quick = AutoencoderSettings(epochs=1, encoder=(8, 3), decoder=(8,))
    study = Consistency(SETTINGS.build, quick)
    report = study.report(study.results(scenes[:1]), PROTOCOL.title, {})
    assert report.record["matched_by"] == {"scene 0": "Gaussians"}
    check_report(report, tmp_path)
