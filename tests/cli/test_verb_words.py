"""scoup words, with a tiny random model."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from cli_support import printed, refused, run_json
from scoup.models import CANONICAL_PHRASES, EVERYDAY_WORDS, TextEncoder, load_table
from tiny_models import save_text_clip


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return save_text_clip(tmp_path_factory.mktemp("clip"))


@pytest.fixture(autouse=True)
def _here(clip: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(clip, "clip")
    Path("list.txt").write_text("red apple\n\nobject\nchair\nred apple\n")


def test_a_table_answers_as_its_model():
    said = run_json("words", "--model", "clip", "--words", "list.txt")
    names = (*CANONICAL_PHRASES, "red apple", "chair", *(word for word in EVERYDAY_WORDS if word != "chair"))
    assert said == {"out": "words.npz", "names": len(names), "dim": 12, "embedding_model": "clip"}
    assert load_table("words.npz").names == names
    table, model = TextEncoder.open("words.npz"), TextEncoder.open("clip")
    asked = ["red apple", "chair", "the lamps"]
    assert (table.encode(asked) * model.encode(["red apple", "chair", "lamp"])).sum(1).min() > 1 - 1e-6
    assert (table.canonical() * model.canonical()).sum(1).min() > 1 - 1e-6
    assert table.everyday().shape[0] >= len(EVERYDAY_WORDS)
    assert "already exists" in refused("words", "--model", "clip")


def test_everyday_words_alone():
    out = printed("words", "--model", "clip", "--out", "w.npz")
    assert "scoup build SCENE --model w.npz" in out


def test_a_model_that_is_nowhere():
    assert "text model 'nobody/none' cannot be loaded" in refused("words", "--model", "nobody/none")
