"""Judging presence: AUC, precision and recall by hand, models never judged on what they were calibrated on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from scoup.errors import InputError
from scoup.evaluate.datasets import find_data_set, open_scene
from scoup.evaluate.presence_study import (
    ABSENT,
    OUT_OF_VIEW,
    PRESENT,
    Question,
    absent_words,
    auc,
    calibrated,
    held_out_answers,
    presence_score,
    presence_tables,
)


def question(scene: str, kind: str, peak: float, number: int = 0) -> Question:
    return Question(scene, "f", f"{kind}{number}", kind, (peak, peak, peak, 0.5, 0.5, 1.0), True)


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


def study() -> list[Question]:
    """In scene "a" present things peak above 0.6, in "b" above 0.5: each must be judged by the other's threshold."""
    questions = []
    for number in range(20):
        for scene, shift in (("a", 0.1), ("b", 0.0)):
            questions.append(question(scene, PRESENT, 0.55 + shift + number * 0.002, number))
            questions.append(question(scene, ABSENT, 0.45 + shift - number * 0.002, number))
    return questions


def test_each_scene_is_judged_by_the_other() -> None:
    questions = study()
    said = held_out_answers(questions, ("peak",))
    # Calibrated on "b" (bound 0.5), absent things of "a" above it pass; on "a" (0.6) present things of "b" fail.
    of_a = np.array([q.scene == "a" for q in questions])
    kinds = np.array([q.kind for q in questions])
    assert said[of_a & (kinds == PRESENT)].all()
    assert said[of_a & (kinds == ABSENT)].any()
    assert not said[~of_a & (kinds == ABSENT)].any()
    assert not said[~of_a & (kinds == PRESENT)].all()
    with pytest.raises(InputError, match="two or more"):
        held_out_answers([q for q in questions if q.scene == "a"])


def test_the_scene_threshold_parts_the_largest_probabilities() -> None:
    questions = [question("a", PRESENT, 0.7, n) for n in range(5)] + [
        question("a", ABSENT, 0.4, n) for n in range(5)
    ]
    model = calibrated(questions, ("peak",))
    low, high = (float(model.probability(np_tensor(value))) for value in (0.4, 0.7))
    assert low < model.scene_threshold < high


def np_tensor(value: float):
    import torch

    return torch.tensor([value])


def test_tables() -> None:
    tables, record = presence_tables(study())
    assert record["auc"]["peak"][OUT_OF_VIEW] is None
    assert record["rules"]["the protocols' rule (paints always)"]["recall"] == 1
    assert record["questions"] == {PRESENT: 40, OUT_OF_VIEW: 0, ABSENT: 40}
    assert len(tables) == 2


def test_absent_words(twins: Path, tmp_path: Path) -> None:
    data_set, root = find_data_set("lerf-ovs"), twins / "lerf-ovs"
    table, shelves = (open_scene(data_set, root, name) for name in ("table", "shelves"))
    assert "elephant" in absent_words(table, [shelves])
    from dataclasses import replace

    bare = replace(table, folder=tmp_path)
    found = absent_words(bare, [shelves])
    assert set(found) == set(shelves.labels) - set(table.labels)
    with pytest.raises(InputError, match=r"absent\.txt"):
        absent_words(bare, [])
