"""Texts as vectors."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from query.conftest import Queried, random_vectors
from scoup.base import InputError, ScoupWarning, UnknownNameError
from scoup.models import CANONICAL_PHRASES, LEAST_WORDS, TextEncoder, save_table, with_everyday
from scoup.query.language_field import LanguageField
from scoup.query.question import TextVectors, check_encoder, encode_texts
from support import altered

WORDS = ("kettle", "mug")


def encoder_of(path: Path, names: tuple[str, ...], dim: int = 16) -> TextEncoder:
    save_table(path, names, random_vectors(len(names), dim).numpy())
    return TextEncoder.open(path)


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
    with pytest.raises(InputError, match=r"wide\.npz: has vectors of 24 dimensions, but the field contains"):
        check_encoder(queried.field, wide)
    with pytest.raises(InputError, match=r"wide\.npz: has vectors of 24 dimensions"):
        queried.field.with_encoder(wide).question("mug")
    bare = encoder_of(tmp_path / "bare.npz", WORDS)
    with pytest.raises(InputError, match=r"bare\.npz: lacks 'object', but relevancy compares"):
        encode_texts(bare, ["mug"])
    with pytest.raises(UnknownNameError, match="ketle"):
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


@pytest.mark.parametrize(
    ("named", "other", "said"),
    [
        ("words.npz", "", "the field was built for the table words.npz: pass that, or a word table of 16"),
        ("colors", "", "embedded by their colours, without a model, and cannot be queried in words; extract them with"),
        ("", "", "the field does not name its model: pass a word table of 16 dimensions"),
        ("some/clip", "some/clip", "so some/clip, which the field names, did not embed its regions: pass a word table"),
        ("some/clip", "", "the field names the model some/clip: pass that, or a table made with it"),
    ],
)  # fmt: skip
def test_vectors_of_another_size_are_told_from_what_the_field_names(
    queried: Queried, tmp_path: Path, named: str, other: str, said: str
) -> None:
    field = queried.field
    if named.endswith(".npz"):
        info = replace(field.info, embedding_model="", words=Path(named))
    else:
        info = replace(field.info, embedding_model=named)
    built = altered(field, info=info)
    names = (*WORDS, *CANONICAL_PHRASES)
    save_table(tmp_path / "wide.npz", names, random_vectors(len(names), 24).numpy(), model=other)
    with pytest.raises(InputError) as refusal:
        check_encoder(built, TextEncoder.open(tmp_path / "wide.npz"))
    assert said in str(refusal.value)


@pytest.mark.parametrize(
    ("given", "named", "warned"),
    [
        ("open_clip:ViT-B-16/laion2b_s34b_b88k", "laion/CLIP-ViT-B-16-laion2B-s34B-b88K", False),
        ("openai/clip-vit-base-patch16", "laion/CLIP-ViT-B-16-laion2B-s34B-b88K", True),
        ("scoup-demo (simulated)", "laion/CLIP-ViT-B-16-laion2B-s34B-b88K", True),
        ("", "laion/CLIP-ViT-B-16-laion2B-s34B-b88K", False),
        ("google/siglip-base-patch16-224", "", False),
    ],
)
def test_vectors_of_another_model_are_warned_of(
    queried: Queried, given: str, named: str, warned: bool
) -> None:
    field = queried.field
    other = altered(field, info=replace(field.info, embedding_model=named))
    encoder = TextEncoder(given, 16, lambda phrases: torch.ones(len(phrases), 16))
    if warned:
        with pytest.warns(ScoupWarning, match="mean nothing unless"):
            check_encoder(other, encoder)
    else:
        check_encoder(other, encoder)


def test_a_question_of_a_field_of_another_model_is_warned_of(field: LanguageField) -> None:
    one, other = (
        altered(field, info=replace(field.info, embedding_model=name), words=field.words)  # names no model
        for name in ("one", "other")
    )
    question = one.question("word 1")
    one.answer(question)
    with pytest.warns(
        ScoupWarning, match="vectors come from one, the field's embeddings from other; answers"
    ):
        other.answer(question)
