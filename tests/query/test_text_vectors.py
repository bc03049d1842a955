"""Texts as vectors."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from messages import refuses, warns
from query.conftest import Queried, random_vectors
from scoup.base import ScoupWarning, UnknownNameError
from scoup.models import CANONICAL_PHRASES, LEAST_WORDS, TextEncoder, WordTable, with_everyday
from scoup.query.language_field import LanguageField
from scoup.query.question import TextVectors, check_encoder, encode_texts
from support import altered

WORDS = ("kettle", "mug")


def encoder_of(path: Path, names: tuple[str, ...], dim: int = 16) -> TextEncoder:
    WordTable.save(path, names, random_vectors(len(names), dim).numpy())
    return TextEncoder.open(path)


def of_model(field: LanguageField, name: str, words: Path | None = None) -> LanguageField:
    """The field as if built with a model, or with words of a table."""
    return altered(field, info=replace(field.info, embedding_model=name, words=words), words=field.words)


def test_queries_and_what_they_are_compared_with(tmp_path: Path) -> None:
    encoder = encoder_of(tmp_path / "words.npz", (*WORDS, *CANONICAL_PHRASES))
    texts = encode_texts(encoder, ["mug", "kettle", "mug"])
    vectors = random_vectors(6, 16)
    torch.testing.assert_close(texts.queries, vectors[[1, 0, 1]])
    torch.testing.assert_close(texts.canonical, vectors[2:])
    torch.testing.assert_close(texts.everyday, vectors[:2])
    assert texts.source == encoder.source == str(tmp_path / "words.npz")
    assert not texts.can_judge_presence


def test_what_does_not_fit_is_refused(queried: Queried, tmp_path: Path) -> None:
    wide = encoder_of(tmp_path / "wide.npz", (*WORDS, *CANONICAL_PHRASES), dim=24)
    bare = encoder_of(tmp_path / "bare.npz", WORDS)
    with refuses():
        queried.field.with_encoder(wide).question("mug")
    with refuses():
        encode_texts(bare, ["mug"])
    with refuses(UnknownNameError):
        encode_texts(bare, ["ketle"])


def test_everyday_words_are_one_more_phrase() -> None:
    vectors = random_vectors(2, 16), random_vectors(4, 16), random_vectors(LEAST_WORDS, 16, seed=1)
    texts = TextVectors(("mug", "plate"), *vectors)
    assert texts.of(["plate"]).equal(texts.queries[1:])
    assert texts.can_judge_presence
    assert texts.with_everyday().canonical.equal(with_everyday(texts.canonical, texts.everyday))
    assert texts.with_everyday().everyday is texts.everyday
    few = replace(texts, everyday=texts.everyday[1:])
    assert not few.can_judge_presence
    assert few.with_everyday().canonical is texts.canonical


@pytest.mark.parametrize(("named", "other"), [
    ("words.npz", ""), ("colors", ""), ("", ""), ("some/clip", "some/clip"), ("some/clip", ""),
])  # fmt: skip
def test_vectors_of_another_size_are_told_from_what_the_field_names(
    queried: Queried, tmp_path: Path, named: str, other: str
) -> None:
    words = Path(named) if named.endswith(".npz") else None
    built = of_model(queried.field, "" if words else named, words)
    names = (*WORDS, *CANONICAL_PHRASES)
    WordTable.save(tmp_path / "wide.npz", names, random_vectors(len(names), 24).numpy(), model=other)
    with refuses():
        check_encoder(built, TextEncoder.open(tmp_path / "wide.npz"))


LAION = "laion/CLIP-ViT-B-16-laion2B-s34B-b88K"


@pytest.mark.parametrize(("given", "named", "warned"), [
    ("open_clip:ViT-B-16/laion2b_s34b_b88k", LAION, False), ("openai/clip-vit-base-patch16", LAION, True),
    ("scoup-demo (simulated)", LAION, True), ("", LAION, False), ("google/siglip-base-patch16-224", "", False),
])  # fmt: skip
def test_vectors_of_another_model_are_warned_of(
    queried: Queried, given: str, named: str, warned: bool
) -> None:
    encoder = TextEncoder(given, 16, lambda phrases: torch.ones(len(phrases), 16))
    with warns(ScoupWarning) if warned else nullcontext():
        check_encoder(of_model(queried.field, named), encoder)


def test_a_question_of_a_field_of_another_model_is_warned_of(field: LanguageField) -> None:
    one, other = (of_model(field, name) for name in ("one", "other"))  # words name no model
    question = one.question("word 1")
    one.answer(question)
    with warns(ScoupWarning):
        other.answer(question)
