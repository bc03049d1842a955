"""The benchmark of labels, tiny, from arguments to its file."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch
from benchmarks import labels
from benchmarks.answer_scenes import SceneSize

from scoup.query.label import NONE
from synthetic.small_scenes import one_light


@pytest.mark.slow
def test_every_rule_is_scored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(labels, "SceneSize", lambda: SceneSize(4000, 160, 120, 6, 2))
    out = tmp_path / "labels.json"
    with one_light():
        labels.main(labels.Arguments(scenes=("table-0",), ways=("default", "dense"), out=out))
    scores = json.loads(out.read_text())["scores"]
    for way in ("default", "dense"):
        found = scores[way]["table-0"]
        assert set(found) == set(labels.WORDS)
        for words in labels.WORDS:
            assert found[words]["words"]["absent"] == (8 if words == "half the words" else 0)
            for rule in labels.RULES:
                assert 0 < found[words][rule]["miou"] < 1
        # Argmax has no "none of these".
        assert (
            found["half the words"]["as labelled"]["accuracy"] > found["half the words"]["argmax"]["accuracy"]
        )


def test_agreement_counts_by_word() -> None:
    truth = torch.tensor([0, 0, 0, 1, 1, NONE, NONE, NONE])
    given = torch.tensor([0, 0, 1, 1, NONE, NONE, NONE, 0])
    found = labels.agreement(truth, given, ["mug", "cup", "pot"])
    assert found["accuracy"] == 5 / 8
    assert found["ious"] == {"mug": 2 / 4, "cup": 1 / 3}
    assert found["none"] == 2 / 4
    assert found["miou"] == pytest.approx((1 / 2 + 1 / 3) / 2)
