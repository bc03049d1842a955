"""The point-level protocols from data sets on disk to tables: true classes score one, a field's answers much, those of
a shuffled field little."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import mean

import pytest
import torch
from torch import Tensor

from evaluate.known_methods import NothingRendered
from messages import refuses
from scoup.base import MissingFileError, UnknownNameError
from scoup.io import load_gaussians
from scoup.query import LanguageField
from scoup.uplift import build_settings
from scoup_lab.baselines.fitted import FittedField
from scoup_lab.baselines.methods import METHODS
from scoup_lab.data.labelled_points import LabelledPoints, write_labelled_ply
from scoup_lab.evaluate.label_vectors import text_source
from scoup_lab.evaluate.point_evaluation import PointEvaluation
from scoup_lab.evaluate.point_report import PointScores
from scoup_lab.evaluate.protocols import scannet
from scoup_lab.evaluate.protocols.points import NO_CLASS, class_ious, class_mean, class_totals
from scoup_lab.evaluate.report import OURS
from scoup_lab.evaluate.scenes import SceneFiles


def evaluation_of(methods: tuple[str, ...] = ()) -> PointEvaluation:
    return PointEvaluation(
        class_lists=tuple(scannet.find_class_list(classes) for classes in ("19", "10")),
        build=build_settings("default", n_atoms=32),
        methods=tuple(METHODS[method] for method in methods),
    )


def opened(root: Path, scene: str = "table") -> tuple[SceneFiles, str, PointEvaluation]:
    """A scene, its word table, and how it is evaluated."""
    found = scannet.open_scene(root, scene)
    return found, text_source(root, found, None, "none"), evaluation_of()


@dataclass(frozen=True)
class Oracle(NothingRendered):
    """Knows the class of every Gaussian [N] and is asked for the classes by their texts' vectors."""

    classes: Tensor
    queries: Tensor

    def gaussian_relevancy(self, queries: Tensor, canonical: Tensor) -> Tensor:
        # Texts of one vector are one thing: what is asked for is compared, not counted.
        wanted = self.queries[self.classes.clamp(min=0)]
        return (queries @ wanted.T)[None]

    def coded(self) -> Tensor:
        return (self.classes != NO_CLASS)[None]


def test_true_classes_score_one(synthetic_data_sets: Path) -> None:
    scene, source, evaluation = opened(synthetic_data_sets / "scannet")
    vectors = evaluation.vectors(source, scene.name)
    truths = evaluation.truths(scene, load_gaussians(scene.splat))
    for classes in evaluation.class_lists:
        oracle = Oracle(truths[classes.name], vectors.of(classes.classes))
        counts = replace(evaluation, class_lists=(classes,)).count(truths, {OURS: oracle}, vectors)
        assert float(class_mean(class_ious(class_totals(counts[classes.name][OURS])))) == 1


def test_a_field_answers_better_than_a_shuffled_one(synthetic_data_sets: Path, tmp_path: Path) -> None:
    scene, source, evaluation = opened(synthetic_data_sets / "scannet")
    counts = evaluation.scene(scene, source, tmp_path)
    field = LanguageField.load(tmp_path / "fields" / "table.scoup", load_gaussians(scene.splat))
    order = torch.randperm(len(field), generator=torch.Generator().manual_seed(0))
    shuffled = LanguageField(
        field.code_indices[order], field.code_weights[order], field.codebook, field.info, field.gaussians
    )
    truths, vectors = evaluation.truths(scene, field.gaussians), evaluation.vectors(source, scene.name)
    mixed = evaluation.count(truths, {OURS: FittedField(shuffled)}, vectors)
    for classes in evaluation.class_lists:
        ours, chance = (
            float(class_mean(class_ious(class_totals(found[classes.name][OURS]))))
            for found in (counts, mixed)
        )
        assert ours > 0.3
        assert ours > chance + 0.2
    # The same again reads the field that is there; other settings are refused.
    again = evaluation.scene(scene, source, tmp_path)
    assert all(again[key][OURS].equal(counts[key][OURS]) for key in counts)
    with refuses():
        replace(evaluation, build=build_settings(n_atoms=8)).scene(scene, source, tmp_path)
    with refuses():
        replace(evaluation, level="x").scene(scene, source, tmp_path)


def test_tables_of_several_scenes_and_methods(synthetic_data_sets: Path, tmp_path: Path) -> None:
    evaluation = evaluation_of(("dense",))
    root = synthetic_data_sets / "scannet"
    names = scannet.find(root)
    assert names == ["shelves", "table"]
    counts = {}
    for name in names:
        scene, source, _ = opened(root, name)
        counts[name] = evaluation.scene(scene, source, tmp_path)
    classes = evaluation.class_lists[0]
    scores = PointScores.of(classes, {**counts, "yard": {}})
    assert scores.scenes == ("shelves", "table")
    with refuses():
        PointScores.of(classes, {"yard": {}})
    report = scores.report("all")
    report.write(tmp_path)
    record = report.record
    assert json.loads((tmp_path / "all.json").read_text()) == record
    assert list(record["systems"]) == [OURS, "dense"]
    ours = record["systems"][OURS]
    ious = [class_ious(class_totals(torch.tensor(ours["confusion"][name]))) for name in names]
    assert ours["overall"]["mIoU"] == pytest.approx(mean(float(each.nanmean()) for each in ious))
    low, high = ours["intervals"]["mIoU"]
    assert low <= ours["overall"]["mIoU"] <= high
    shown = {each["class"]: each for each in ours["classes"]}
    assert {"wall", "floor"} < set(shown)
    assert "bed" not in shown
    text = (tmp_path / "all.md").read_text()
    assert "Left out, without points of these classes: yard." in text
    text = " ".join(text.split())  # of a table padded to its widest cells
    assert "| dense |" in text
    assert f"| wall | {shown['wall']['scenes']} |" in text
    assert "mAcc" in (tmp_path / "all.tex").read_text()


def test_means_over_scenes_by_hand() -> None:
    classes = scannet.find_class_list("10")
    good, bad = (torch.zeros(10, 11, dtype=torch.int64) for _ in range(2))
    good[0, 0] = 1000
    bad[0, 1], bad[1, 1] = 1, 1  # of class 0 nothing, of class 1 half
    scores = PointScores(classes, ("a", "b"), {OURS: [good, bad]})
    record = scores.report("two").record
    overall = record["systems"][OURS]["overall"]
    assert overall["mIoU"] == pytest.approx((1 + (0 + 0.5) / 2) / 2)
    assert overall["mAcc"] == pytest.approx((1 + (0 + 1) / 2) / 2)
    assert record["systems"][OURS]["scenes"]["b"]["mIoU"] == pytest.approx(0.25)
    assert record["systems"][OURS]["intervals"]["mIoU"] == pytest.approx([0.25, 1])
    one = replace(scores, scenes=("b",), matrices={OURS: [bad]})
    record = one.report("one").record
    assert record["systems"][OURS]["intervals"]["mIoU"] is None


def test_scenes_that_are_not_there(synthetic_data_sets: Path, tmp_path: Path) -> None:
    for absent in (tmp_path / "absent", tmp_path):
        with refuses(MissingFileError):
            scannet.find(absent)
    with refuses(UnknownNameError):
        scannet.find(synthetic_data_sets / "scannet", ["tabel"])
    with refuses(UnknownNameError):
        scannet.find_class_list("20")


def test_a_scene_without_points_of_a_class_is_left_out(synthetic_data_sets: Path, tmp_path: Path) -> None:
    scene, source, evaluation = opened(synthetic_data_sets / "scannet")
    gaussians = load_gaussians(scene.splat)
    folder = tmp_path / "table"
    labels = torch.full((len(gaussians),), 40)
    write_labelled_ply(LabelledPoints(gaussians.means, labels), folder / "table_vh_clean_2.labels.ply")
    said: list[str] = []
    bare = replace(scene, folder=folder)
    assert evaluation.scene(bare, source, tmp_path, say=said.append) == {}
    assert said == ["table: none of its points is of a class that is scored; left out"]
    assert not (tmp_path / "fields").exists()
