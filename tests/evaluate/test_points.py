"""Points of scans: counting and scores by hand, ScanNet's classes and positions, data sets from disk to tables."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from statistics import mean
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from torch import Tensor

from messages import refuses
from scoup.io import load_gaussians
from scoup.query import LanguageField, TextVectors
from scoup.uplift import build_settings
from scoup_lab.baselines.fitted import FittedField
from scoup_lab.baselines.methods import METHODS
from scoup_lab.data.labelled_points import NYU40, LabelledPoints, write_labelled_ply
from scoup_lab.evaluate.label_vectors import text_source
from scoup_lab.evaluate.point_evaluation import PointEvaluation
from scoup_lab.evaluate.point_report import PointScores
from scoup_lab.evaluate.protocols import scannet
from scoup_lab.evaluate.protocols.points import (
    NO_CLASS,
    class_accuracies,
    class_ious,
    class_mean,
    class_totals,
    confusion_matrix,
    label_gaussians,
)
from scoup_lab.evaluate.report import OURS
from scoup_lab.evaluate.scenes import SceneFiles
from support import gaussians_at

#                    three of class 0      two of 1  one of 3   two that do not count
TRUTH = torch.tensor([0, 0, 0, 1, 1, 3, NO_CLASS, NO_CLASS])
GIVEN = torch.tensor([0, 0, 1, 1, NO_CLASS, 2, 0, 3])


def test_counts_and_scores_by_hand() -> None:
    matrix = confusion_matrix(TRUTH, GIVEN, 4)
    assert matrix.tolist() == [[2, 1, 0, 0, 0], [0, 1, 0, 0, 1], [0, 0, 0, 0, 0], [0, 0, 1, 0, 0]]
    # found, truly there, given; the two points that do not count are in none of them
    totals = class_totals(matrix)
    assert totals.tolist() == [[2, 1, 0, 0], [3, 2, 0, 1], [2, 2, 1, 0]]
    # 0: 2 of 3 + 2 - 2; 1: 1 of 2 + 2 - 1; 2: not in the truth; 3: 0 of 1
    assert class_ious(totals).tolist() == pytest.approx([2 / 3, 1 / 3, float("nan"), 0], nan_ok=True)
    assert class_accuracies(totals).tolist() == pytest.approx([2 / 3, 1 / 2, float("nan"), 0], nan_ok=True)
    assert float(class_mean(class_accuracies(totals))) == pytest.approx((2 / 3 + 1 / 2) / 3)
    both = torch.stack([totals, class_totals(confusion_matrix(TRUTH, TRUTH, 4))])  # of several scenes at once
    assert class_mean(class_ious(both)).tolist() == pytest.approx([1 / 3, 1])
    for wrong in (torch.tensor([0, *[4] * 7]), GIVEN[:3]):
        with refuses():
            confusion_matrix(TRUTH, wrong, 4)


def fitted_method(relevancy: Callable[[Tensor], Tensor], codes: Tensor) -> Any:
    """A ``FittedMethod`` of known relevancy [S, Q, N] by queries, of which nothing is rendered."""
    return SimpleNamespace(gaussian_relevancy=lambda queries, _: relevancy(queries), coded=lambda: codes)


def known(n_texts: int, relevancy: Tensor, codes: Tensor) -> tuple[Any, TextVectors, list[str]]:
    texts = [str(number) for number in range(n_texts)]
    numbers = torch.arange(n_texts).float()[:, None]
    fitted = fitted_method(lambda queries: relevancy[:, queries[:, 0].long()], codes)
    return fitted, TextVectors(tuple(texts), numbers, numbers, numbers), texts


def test_a_gaussian_takes_the_most_relevant_class_of_all_its_levels() -> None:
    relevancy = torch.tensor(
        [
            #  Gaussians: 0     1     2     3
            [[0.30, 0.90, 0.20, 0.6], [0.40, 0.10, 0.20, 0.6]],  # level 0, classes 0 and 1
            [[0.35, 0.20, 0.50, 0.6], [0.20, 0.95, 0.50, 0.6]],  # level 1
        ]
    )
    # Gaussian 2 has no code at level 1, where its relevancy is a draw; Gaussian 3 has none at all.
    codes = torch.tensor([[True, True, True, False], [True, True, False, False]])
    fitted, vectors, texts = known(2, relevancy, codes)
    assert label_gaussians(fitted, vectors, texts).tolist() == [1, 1, 0, NO_CLASS]
    assert label_gaussians(fitted, vectors, texts, level=1).tolist() == [0, 1, NO_CLASS, NO_CLASS]
    with refuses():
        label_gaussians(fitted, vectors, texts, level=2)


def test_many_classes_are_queried_in_parts() -> None:
    generator = torch.Generator().manual_seed(0)
    relevancy = torch.rand(3, 50, 40, generator=generator)
    fitted, vectors, texts = known(50, relevancy, torch.ones(3, 40, dtype=torch.bool))
    assert label_gaussians(fitted, vectors, texts).equal(relevancy.amax(0).argmax(0))


CLASSES = scannet.CLASS_LISTS
POSITIONS = torch.rand(8, 3, generator=torch.Generator().manual_seed(0))


def test_classes_are_those_of_the_published_script() -> None:
    assert len(NYU40) == 41
    assert (NYU40[1], NYU40[5], NYU40[28], NYU40[40]) == ("wall", "chair", "showercurtain", "otherprop")
    assert CLASSES["19"].classes == (
        "wall", "floor", "cabinet", "bed", "chair", "sofa", "table", "door", "window", "bookshelf", "picture",
        "counter", "desk", "curtain", "refrigerator", "showercurtain", "toilet", "sink", "bathtub",
    )  # fmt: skip
    gone = {"picture", "refrigerator", "showercurtain", "bathtub"}
    assert CLASSES["15"].classes == tuple(name for name in CLASSES["19"].classes if name not in gone)
    assert CLASSES["10"].classes == (
        "wall", "floor", "bed", "chair", "sofa", "table", "door", "window", "bookshelf", "toilet"
    )  # fmt: skip
    assert len(scannet.SCENES) == 10
    assert scannet.labels_path(Path("x/scene0000_00")) == Path(
        "x/scene0000_00/scene0000_00_vh_clean_2.labels.ply"
    )


def test_labels_become_positions_in_the_list() -> None:
    #                       wall floor cabinet sofa toilet otherprop none beyond
    labels = torch.tensor([1, 2, 3, 6, 33, 40, 0, 99])
    points = LabelledPoints(POSITIONS, labels)
    for name, expected in {
        "19": [0, 1, 2, 5, 16, NO_CLASS, NO_CLASS, NO_CLASS],
        "15": [0, 1, 2, 5, 13, NO_CLASS, NO_CLASS, NO_CLASS],
        "10": [0, 1, NO_CLASS, 4, 9, NO_CLASS, NO_CLASS, NO_CLASS],
    }.items():
        assert (
            scannet.gaussian_truth(gaussians_at(POSITIONS), points, CLASSES[name], "x").tolist() == expected
        )
    walls = LabelledPoints(POSITIONS[:3], torch.tensor([1, 1, 1]))
    faint = replace(gaussians_at(POSITIONS[:3]), opacities=torch.tensor([0.0999, 0.1, 0.5]))
    assert scannet.gaussian_truth(faint, walls, CLASSES["19"], "x").tolist() == [NO_CLASS, 0, 0]


def test_splats_of_other_points_are_refused() -> None:
    positions = POSITIONS[:4]
    points = LabelledPoints(positions, torch.ones(4, dtype=torch.int64))
    moved, endless = positions.clone(), positions.clone()
    moved[2] += 0.01
    endless[1] = torch.nan
    for wrong in (positions[:3], moved, positions.flip(0), endless):
        with refuses():
            scannet.gaussian_truth(gaussians_at(wrong), points, CLASSES["19"], "a.ply")


EVALUATION = PointEvaluation(
    class_lists=tuple(scannet.find_class_list(classes) for classes in ("19", "10")),
    build=build_settings("default", n_atoms=32),
)


def opened(root: Path, scene: str = "table") -> tuple[SceneFiles, str, PointEvaluation]:
    """A scene, its word table, and how it is evaluated."""
    found = scannet.open_scene(root, scene)
    return found, text_source(root, found, None, "none"), replace(EVALUATION)


def mean_iou(matrix: Tensor) -> float:
    return float(class_mean(class_ious(class_totals(matrix))))


def test_true_classes_score_one(synthetic_data_sets: Path) -> None:
    scene, source, evaluation = opened(synthetic_data_sets / "scannet")
    vectors = evaluation.vectors(source, scene.name)
    truths = evaluation.truths(scene, load_gaussians(scene.splat))
    for classes in evaluation.class_lists:
        truth = truths[classes.name]
        # Texts of one vector are one thing: what is asked for is compared, not counted.
        wanted = vectors.of(classes.classes)[truth.clamp(min=0)]
        oracle = fitted_method(
            lambda queries, wanted=wanted: (queries @ wanted.T)[None], (truth != NO_CLASS)[None]
        )
        counts = replace(evaluation, class_lists=(classes,)).count(truths, {OURS: oracle}, vectors)
        assert mean_iou(counts[classes.name][OURS]) == 1


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
        ours, chance = (mean_iou(found[classes.name][OURS]) for found in (counts, mixed))
        assert ours > max(0.3, chance + 0.2)
    # The same again reads the field that is there; other settings are refused.
    again = evaluation.scene(scene, source, tmp_path)
    assert all(again[key][OURS].equal(counts[key][OURS]) for key in counts)
    with refuses():
        replace(evaluation, build=build_settings(n_atoms=8)).scene(scene, source, tmp_path)
    with refuses():
        replace(evaluation, level="x").scene(scene, source, tmp_path)


def test_tables_of_several_scenes_and_methods(synthetic_data_sets: Path, tmp_path: Path) -> None:
    evaluation = replace(EVALUATION, methods=(METHODS["dense"],))
    root = synthetic_data_sets / "scannet"
    names = scannet.find(root)
    assert names == ["shelves", "table"]
    counts = {name: evaluation.scene(*opened(root, name)[:2], tmp_path) for name in names}
    classes = evaluation.class_lists[0]
    scores = PointScores.of(classes, {**counts, "yard": {}})
    assert scores.scenes == ("shelves", "table")
    with refuses():
        PointScores.of(classes, {"yard": {}})
    report = scores.report("all")
    report.write(tmp_path)
    assert json.loads((tmp_path / "all.json").read_text()) == report.record
    assert list(report.record["systems"]) == [OURS, "dense"]
    ours = report.record["systems"][OURS]
    ious = [mean_iou(torch.tensor(ours["confusion"][name])) for name in names]
    assert ours["overall"]["mIoU"] == pytest.approx(mean(ious))
    low, high = ours["intervals"]["mIoU"]
    assert low <= ours["overall"]["mIoU"] <= high
    shown = {each["class"]: each for each in ours["classes"]}
    assert {"wall", "floor"} < set(shown)
    assert "bed" not in shown
    text = " ".join((tmp_path / "all.md").read_text().split())  # of a table padded to its widest cells
    left_out = "Left out, without points of these classes: yard."
    for part in (left_out, "| dense |", f"| wall | {shown['wall']['scenes']} |"):
        assert part in text
    assert "mAcc" in (tmp_path / "all.tex").read_text()


def test_means_over_scenes_by_hand() -> None:
    classes = scannet.find_class_list("10")
    good, bad = (torch.zeros(10, 11, dtype=torch.int64) for _ in range(2))
    good[0, 0] = 1000
    bad[0, 1], bad[1, 1] = 1, 1  # of class 0 nothing, of class 1 half
    scores = PointScores(classes, ("a", "b"), {OURS: [good, bad]})
    found = scores.report("two").record["systems"][OURS]
    assert found["overall"]["mIoU"] == pytest.approx((1 + (0 + 0.5) / 2) / 2)
    assert found["overall"]["mAcc"] == pytest.approx((1 + (0 + 1) / 2) / 2)
    assert found["scenes"]["b"]["mIoU"] == pytest.approx(0.25)
    assert found["intervals"]["mIoU"] == pytest.approx([0.25, 1])
    one = replace(scores, scenes=("b",), matrices={OURS: [bad]})
    assert one.report("one").record["systems"][OURS]["intervals"]["mIoU"] is None


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
