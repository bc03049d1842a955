"""Fields, encoders, questions and answers in other processes: pickle, deepcopy, spawn, joblib."""

from __future__ import annotations

import copy
import multiprocessing
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch

from messages import refuses
from query.conftest import WORDS, random_vectors
from scoup.models import TextEncoder, WordTable
from scoup.query.answer import Answer, answer_relevancy
from scoup.query.language_field import LanguageField

COPIES = {"pickle": lambda value: pickle.loads(pickle.dumps(value)), "deepcopy": copy.deepcopy}


@pytest.mark.parametrize("copied", COPIES.values(), ids=COPIES)
def test_fields_and_what_they_answer(field: LanguageField, copied: Callable[[Any], Any]) -> None:
    expected = field.location("word 3").to_dict()  # and something is kept
    field.at(0).answer("word 3")
    other = copied(field)
    assert other.location("word 3").to_dict() == expected
    assert len(other.cache) == 3  # its own comparison of things with words, question and answer
    question = field.question(["word 1", "word 2"], threshold=0.6)
    found, wanted = other.location(copied(question)), field.location(question)
    assert [each.to_dict() for each in found] == [each.to_dict() for each in wanted]
    answers = field.answer("word 3"), field.select("word 3 and not word 4"), field.answer("largest word 3")
    for made in (*answers, field.location("word 3")):
        assert copied(made).to_dict() == made.to_dict()
        if isinstance(made, Answer):  # a copy knows its vectors: any field that it fits shows it
            again = copied(made)
            assert again.remark() == made.remark()
            assert answer_relevancy(other, again).equal(answer_relevancy(field, made))
            seen, expected_seen = other.at(0).show([again])[0], field.at(0).show([made])[0]
            assert seen.to_dict() == expected_seen.to_dict()
            assert seen.mask.equal(expected_seen.mask)
            assert other.location(again).to_dict() == field.location(made).to_dict()
    labels = field.label(["word 1", "word 2"])
    assert copied(labels).ids.equal(labels.ids)


@pytest.mark.parametrize("copied", COPIES.values(), ids=COPIES)
def test_encoders(tmp_path: Path, copied: Callable[[Any], Any]) -> None:
    vectors = random_vectors(len(WORDS), 16, seed=5)
    WordTable.save(tmp_path / "words.npz", WORDS, vectors)
    for encoder in (
        TextEncoder.open(dict(zip(WORDS, vectors, strict=True))),
        TextEncoder.open(tmp_path / "words.npz"),
        TextEncoder("model", 16, _ones),
    ):
        other = copied(encoder)
        assert (other.name, other.dim, other.names) == (encoder.name, encoder.dim, encoder.names)
        assert other.encode(["word 3"]).equal(encoder.encode(["word 3"]))
    encoder.close()
    with refuses():
        copied(encoder).encode(["word 3"])


def _ones(phrases: list[str]) -> torch.Tensor:
    return torch.ones(len(phrases), 16)


def _located(field: LanguageField, text: str) -> dict[str, Any]:
    return field.location(text).to_dict()


def test_other_processes_ask(field: LanguageField) -> None:
    texts = ["word 3", "word 4"]
    expected = [_located(field, text) for text in texts]
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        assert pool.apply(_located, (field, texts[0])) == expected[0]
    joblib = pytest.importorskip("joblib")
    assert joblib.Parallel(n_jobs=2)(joblib.delayed(_located)(field, text) for text in texts) == expected
