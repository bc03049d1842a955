"""Judging presence: AUC, precision and recall by hand, models never judged on what they were calibrated on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from scoup import raster
from scoup.base.errors import InputError
from scoup.evaluate.data_sets import LabelledScene, find_data_set
from scoup.evaluate.studies.presence import (
    ABSENT,
    IN_SCENE,
    OUT_OF_VIEW,
    PRESENT,
    Question,
    absent_words,
    rendered_mean,
    signals_of,
)
from scoup.evaluate.studies.presence_scores import (
    auc,
    best_bound,
    held_out_answers,
    presence_report,
    presence_score,
)
from scoup.io.labels import LabelledFrame
from scoup.query.segment import segment
from scoup.scene.cameras import Cameras
from support import make_camera, small_scene


def question(scene: str, kind: str, value: float, number: int = 0, frame: str = "f") -> Question:
    signals = (value, value, value, value, 0.5, 0.5, 1.0)
    return Question(scene, frame, f"{kind}{number}", kind, signals if frame else signals[:1])


def test_auc_by_hand() -> None:
    assert auc(np.array([3.0, 4.0]), np.array([1.0, 2.0])) == 1
    assert auc(np.array([1.0, 2.0]), np.array([3.0, 4.0])) == 0
    assert auc(np.array([1.0, 1.0]), np.array([1.0])) == 0.5
    random = np.random.default_rng(0)
    present, absent = random.integers(0, 6, 30).astype(float), random.integers(0, 5, 20).astype(float)
    wins = np.mean([(p > a) + 0.5 * (p == a) for p in present for a in absent])
    assert auc(present, absent) == pytest.approx(wins)


def test_scores_by_hand() -> None:
    kinds = [PRESENT, PRESENT, PRESENT, ABSENT, ABSENT, OUT_OF_VIEW]
    questions = [question("s", kind, 0.5) for kind in kinds]
    score = presence_score(questions, np.array([1, 1, 0, 1, 0, 0], bool))
    assert (score.precision, score.recall) == (pytest.approx(2 / 3), pytest.approx(2 / 3))
    assert (score.absent_refused, score.out_of_view_refused) == (0.5, 1.0)
    assert score.f1 == pytest.approx(2 / 3)
    nothing = presence_score(questions, np.zeros(6, bool))
    assert (nothing.precision, nothing.recall, nothing.f1) == (0, 0, 0)
    everything = presence_score(questions[:4], np.ones(4, bool))
    assert np.isnan(everything.out_of_view_refused)
    assert everything.recall == 1


def study(frame: str = "f") -> list[Question]:
    """In scene "a" present things lie above 3, in "b" above 2: each must be judged by the other's bound."""
    questions = []
    there = PRESENT if frame else IN_SCENE
    for number in range(20):
        for scene, shift in (("a", 1.0), ("b", 0.0)):
            questions.append(question(scene, there, 2.5 + shift + number * 0.02, number, frame))
            questions.append(question(scene, ABSENT, 1.5 + shift - number * 0.02, number, frame))
    return questions


def test_each_scene_is_judged_by_the_other() -> None:
    questions = study()
    said = held_out_answers(questions, "peak")
    # Chosen on "b" (2), absent things of "a" above it pass; on "a" (3), present things of "b" fail.
    of_a = np.array([q.scene == "a" for q in questions])
    kinds = np.array([q.kind for q in questions])
    assert said[of_a & (kinds == PRESENT)].all()
    assert said[of_a & (kinds == ABSENT)].any()
    assert not said[~of_a & (kinds == ABSENT)].any()
    assert not said[~of_a & (kinds == PRESENT)].all()
    with pytest.raises(InputError, match="two or more"):
        held_out_answers([q for q in questions if q.scene == "a"], "peak")


def test_the_best_bound_parts_the_kinds() -> None:
    values, present = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]), np.array([0, 0, 1, 0, 1, 1], bool)
    gains = {
        bound: (values[present] >= bound).mean() + (values[~present] < bound).mean()
        for bound in (1, 1.5, 2.5, 3.5, 4.5, 5.5)
    }
    assert best_bound(values, present) == max(gains, key=lambda bound: gains[bound])
    for kind in (np.zeros(6, bool), np.ones(6, bool)):
        with pytest.raises(InputError, match="both kinds"):
            best_bound(values, kind)


def test_signals_by_hand() -> None:
    maps = torch.full((2, 20, 30), 0.4)
    maps[1, 4:14, 6:20] = 0.8
    found = signals_of(maps)
    mask = segment(maps).mask
    smoothed = 0.5 * (maps[1] + box(maps[1]))
    assert found[0] == pytest.approx(float(smoothed.max()))
    assert found[1] == pytest.approx(float(smoothed[mask].mean()), abs=1e-6)
    assert found[2] == pytest.approx(float(smoothed[mask].mean() - smoothed[~mask].mean()), abs=1e-6)
    extra = torch.rand(2, 20, 30)
    assert signals_of(maps, [extra])[3] == pytest.approx(float(extra[1][mask].mean()), abs=1e-6)


def box(values: torch.Tensor) -> torch.Tensor:
    """Mean over 7 x 7 pixels inside the image, by torch's own pooling."""
    pooled = torch.nn.functional.avg_pool2d(values[None, None], 7, 1, 3, count_include_pad=False)
    return pooled[0, 0]


def test_a_constant_map_answers_nothing() -> None:
    assert signals_of(torch.full((3, 9, 9), 0.5)) == [0.5, 0.5, 0.0]
    extra = torch.rand(3, 9, 9)
    assert signals_of(torch.full((3, 9, 9), 0.5), [extra])[3] == pytest.approx(float(extra[0].mean()))


def test_rendered_means_are_over_coded_gaussians() -> None:
    gaussians, cameras, _ = small_scene(count=40, views=1)
    projection = raster.project(gaussians, cameras[0])
    values = torch.rand(40, 3, generator=torch.Generator().manual_seed(0))
    coded = torch.rand(40, 3, generator=torch.Generator().manual_seed(1)) > 0.4
    weights = raster.render_channels(projection, torch.eye(40))[0]
    found = rendered_mean(projection, values, coded)
    for level in range(3):
        counted = coded[:, level].float()
        total = weights @ counted
        expected = torch.where(
            total > 1e-6, weights @ (counted * values[:, level]) / total.clamp(min=1e-6), 1.0
        )
        assert torch.allclose(found[level], expected, atol=1e-4)


def test_tables() -> None:
    report = presence_report([*study(), *study("")], {"seed": 0})
    record = report.record
    assert record["auc"]["peak"][OUT_OF_VIEW] is None
    assert record["rules"]["the protocols' rule (paints always)"]["recall"] == 1
    assert record["questions"] == {PRESENT: 40, OUT_OF_VIEW: 0, ABSENT: 40}
    fixed = record["scene_rules"]["z-score, 1.5 or more (the default)"]
    # Those of "b" but for the first, which is at the bound.
    assert (fixed["recall"], fixed["absent_refused"]) == (1, 0.475)
    assert len(report.tables) == 3


def labelled(folder: Path, name: str, *labels: str) -> LabelledScene:
    """A scene with one frame of these labels."""
    mask = torch.zeros(30, 40, dtype=torch.bool)
    frame = LabelledFrame("view_00.png", 40, 30, dict.fromkeys(labels, mask), {})
    camera = make_camera(name="view_00.png")
    home = folder / name
    frames = [(frame, camera)]
    return LabelledScene(find_data_set("lerf-ovs"), name, home, home, home, Cameras([camera]), frames)


def test_absent_words(tmp_path: Path) -> None:
    table, shelves = labelled(tmp_path, "table", "cup", "pot"), labelled(tmp_path, "shelves", "book", "cup")
    assert absent_words(table, [shelves]) == ["book"]
    with pytest.raises(InputError, match=r"absent\.txt"):
        absent_words(table, [])
    table.folder.mkdir()
    (table.folder / "absent.txt").write_text("elephant\n\ncup\npiano\nelephant\n")
    assert absent_words(table, [shelves]) == ["elephant", "piano"]
