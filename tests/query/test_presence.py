"""Texts as vectors, and their presence: the score against its definition, for things and for votes."""

from __future__ import annotations

import math
import statistics
from contextlib import nullcontext
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from messages import refuses, warns
from query.conftest import Queried, random_vectors
from query.planted_room import Box, planted_room
from scoup.base import ScoupWarning, UnknownNameError
from scoup.models import CANONICAL_PHRASES, LEAST_WORDS, TextEncoder, WordTable, with_everyday
from scoup.query import constants
from scoup.query.ask import each_answer
from scoup.query.language_field import LanguageField
from scoup.query.presence import TextScore, other_words, presence_threshold, said_score
from scoup.query.question import Question, TextVectors, check_encoder, encode_texts
from scoup.query.thing_judge import thing_index
from scoup.query.votes import SampledVotes, select_each
from support import altered, examples, unit


@settings(max_examples=examples(60))
@given(st.lists(st.tuples(st.integers(-3, 3), st.booleans()), max_size=12), st.integers(-4, 4))
def test_the_score_is_the_share_of_words_that_fit_worse(words: list[tuple[int, bool]], fit: int) -> None:
    best_fits = torch.tensor([float(value) for value, _ in words])
    counted = [value for value, counts in words if counts]
    found = TextScore(best_fits[None], torch.tensor([counts for _, counts in words], dtype=torch.bool))(fit)
    assert found == (sum(value < fit for value in counted) / len(counted) if counted else None)


def literal_others(query: Tensor, words: Tensor) -> list[bool]:
    near = [float(query @ word) for word in words]
    mean, deviation = statistics.mean(near), statistics.stdev(near)
    return [one < constants.SAME_WORD and one <= mean + constants.OTHER_NAME * deviation for one in near]


def test_other_names_of_a_text_are_no_words_to_compare_it_with() -> None:
    query, words = random_vectors(1, 64), random_vectors(200, 64, seed=2)
    names = unit(query + 0.15 * random_vectors(15, 64, seed=3))
    table = torch.cat([words, names, query])
    found = other_words(query, table)[0].tolist()
    assert found == literal_others(query[0], table) == [True] * 200 + [False] * 16


def share_below(fit: float, best: list[float], counts: list[bool]) -> float:
    """Of the values that count, those below."""
    return sum(value < fit for value, one in zip(best, counts, strict=True) if one) / sum(counts)


def literal_scores(field: LanguageField, question: Question) -> list[float]:
    """The best fit of each word with a thing that it does not name, then the share below each text's."""
    known = thing_index(field, question)
    assert known is not None
    (vectors,) = known.vectors
    named = [int((question.everyday @ vector).argmax()) for vector in vectors]
    best = [
        max((float(fit) for fit, name in zip(fits, named, strict=True) if name != number), default=-math.inf)
        for number, fits in enumerate(known.fits(question.everyday).T)
    ]
    scores = []
    for answer, query in zip(each_answer(field, question), question.queries, strict=True):
        fits, counts = known.fits(query[None])[:, 0].tolist(), literal_others(query, question.everyday)
        score = share_below(max(fits[thing] for thing in answer.things), best, counts)
        first = max((fit, thing) for thing, fit in enumerate(fits) if bool(known.usable[thing]))[1]
        near = question.everyday @ vectors[first].float() - query @ vectors[first].float()
        scores.append(min(score, most_of(share_below(-1e-6, (-near).tolist(), counts))))
    return scores


def scores_of(field: LanguageField, question: Question) -> list[float | None]:
    return [answer.score for answer in each_answer(field, question)]


def most_of(nearer: float) -> float:
    """What a text may score: straight lines between the pairs of the table."""
    pairs = list(zip(constants.NEARER_SHARES, constants.MOST_SCORES, strict=True))
    for (low, before), (high, after) in pairwise(pairs):
        if nearer <= high:
            return before + (nearer - low) / (high - low) * (after - before)
    raise AssertionError(nearer)


@pytest.mark.parametrize(("fit", "nearer", "score"), [
    (5, 0, 0.5), (10, 0, 1.0), (10, 2, 0.8), (5, 5, 0.5), (10, 5, 0.6), (10, 7, 0.35), (3, 7, 0.3), (10, 100, 0.2),
    (2, 100, 0.2), (1, 100, 0.1),
])  # fmt: skip
def test_nearer_words_lower_the_score(fit: int, nearer: int, score: float) -> None:
    """Of a hundred words, some fit something better than the text and some are nearer to what fits it best."""
    best_fits = torch.arange(100)[None] // 10
    near = torch.where(torch.arange(100) < nearer, 0.1, -0.1)
    text = TextScore(best_fits, torch.ones(100, dtype=torch.bool), nearer=lambda scene: near)
    assert text(fit) == pytest.approx(score)


def test_scores_of_things(queried: Queried) -> None:
    found = scores_of(queried.field, queried.texts)
    assert found == pytest.approx(literal_scores(queried.field, queried.texts))
    assert len(set(found)) > 3
    room = planted_room()
    question = room.question(["mug", "laptop", "unicorn", "word 3"], always=True)
    found = scores_of(room, question)
    assert found == pytest.approx(literal_scores(room, question))
    assert found[:2] == [1, 1]
    assert (found[2] or 0) < constants.PRESENT_FROM


def test_scores_of_votes(voted: Queried) -> None:
    """Without things, texts and words select Gaussians, and the mean relevancy of these is compared."""
    field, texts = voted.field, voted.texts

    def fit(vector: Tensor) -> float:
        (found,) = select_each(field, replace(texts.one(0), queries=vector[None]))
        return float(found.relevancy[found.mask].mean()) if found.mask.any() else -math.inf

    words = [fit(word) for word in texts.everyday]
    assert SampledVotes(field, texts).best_fits.tolist() == pytest.approx(words, abs=1e-6)
    others = [literal_others(query, texts.everyday) for query in texts.queries]
    expected = [share_below(fit(query), words, own) for query, own in zip(texts.queries, others, strict=True)]
    assert scores_of(field, texts) == pytest.approx(expected)


def test_votes_compared_with_other_phrases_are_other_votes(voted: Queried) -> None:
    field, fresh = (voted.field.with_gaussians(voted.field.gaussians) for _ in range(2))
    others = replace(voted.texts, canonical=random_vectors(2, 16, seed=7))
    first = scores_of(field, voted.texts)
    assert scores_of(field, others) == scores_of(fresh, others) != first


def test_presence_is_judged_by_enough_words_only(queried: Queried, voted: Queried) -> None:
    texts = queried.texts
    few = replace(texts, everyday=texts.everyday[: LEAST_WORDS - 1])
    for field in (queried.field, voted.field):
        for answer in list(each_answer(field, few)):
            assert (answer.score, answer.certainty, answer.presence) == (None, None, True)
            assert answer.runner_up is None or answer.runner_up.score is None
            assert "presence not judged" in repr(answer)
    assert presence_threshold(LEAST_WORDS - 1, "words.npz") is None
    thresholds = [presence_threshold(LEAST_WORDS, "", bound) for bound in (None, 0.0)]
    assert thresholds == [constants.PRESENT_FROM, 0]
    wrong = (-0.01, 1.01, 100, math.nan, math.inf)
    for count, bound in ((LEAST_WORDS - 1, 0.5), *((LEAST_WORDS, each) for each in wrong)):
        with refuses():
            presence_threshold(count, "words.npz", bound)


def test_a_text_is_present_from_the_threshold_on(queried: Queried, voted: Queried) -> None:
    for field in (queried.field, voted.field):
        for number, answer in enumerate(list(each_answer(field, queried.texts))):
            score, one = answer.score or 0.0, queried.texts.one(number)
            enough = int(answer.mask.sum()) >= 10
            at, above = (
                next(iter(each_answer(field, replace(one, present_from=bound))))
                for bound in (score, min(1.0, score + 1e-9))
            )
            assert at.presence == enough
            assert at.mask.equal(answer.mask & enough)
            assert above.presence == (enough and score == 1)
            assert above.score == at.score == answer.score


@pytest.mark.parametrize("has_things", [True, False])
def test_fewer_than_ten_gaussians_are_absent(has_things: bool) -> None:
    boxes = [Box("mug", (0, 0, 0), (1, 1, 1)), Box("ball", (3, 0, 0), (1, 1, 1))]
    field = planted_room(boxes, has_things=has_things)
    assert field.answer("mug").presence
    for count in (10, 9):
        kept = torch.ones(len(field), dtype=torch.bool)
        kept[count:216] = False
        part = field[kept]
        answer = part.answer("mug")
        assert answer.presence == (count == 10)
        assert int(answer.mask.sum()) == (10 if count == 10 else 0)
        assert len(part.things("mug")) == (count == 10)
        place = part.location(part.question("mug", always=True))
        assert (getattr(place.thing, "n_gaussians", 0), int(place.answer.mask.sum())) == (count, count)
    said = f"not in this scene: what fits has fewer than 10 Gaussians (score {answer.score:.2f})"
    assert answer.remark() == said


@pytest.mark.parametrize(("score", "least", "said"), [
    (0.35, 0.35, "0.35"), (0.3499, 0.35, "0.34"), (0.3451, 0.35, "0.34"), (0.8999, 0.35, "0.89"), (0.9, 0.35, "0.90"),
    (0.5999, None, "0.59"), (0.987, 0.35, "0.99"), (0.0, 0.0, "0.00"),
])  # fmt: skip
def test_a_score_below_a_bound_reads_as_below(score: float, least: float | None, said: str) -> None:
    assert said_score(score, least) == said


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
