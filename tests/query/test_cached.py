"""What a field keeps from one question to the next: the same answers, in bounded memory, from several threads."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import torch
from torch import Tensor

from query.conftest import WORDS, random_vectors, without_things
from query.planted_room import BACK, FRONT, planted_room
from query.test_named import LAMP, MUG, named_room
from scoup.field import Cache
from scoup.field.cache import ENTRY_BYTES
from scoup.field.cosines import PixelCosines, pixel_relevancy
from scoup.models import CANONICAL_PHRASES, TextEncoder
from scoup.query.answer import answer_relevancy
from scoup.query.language_field import LanguageField
from scoup.scene import Cameras
from support import altered


def relevancy_of_word(field: LanguageField) -> Tensor:
    return answer_relevancy(field, field.answer("word 3"))


def test_codes_that_are_written_in_place_are_noticed(field: LanguageField) -> None:
    field = altered(field, code_weights=field.code_weights.clone(), words=field.words)
    before = relevancy_of_word(field)
    assert field.coded_levels().equal((field.code_weights > 0).any(-1).T)
    field.code_weights[::2] = 0
    assert relevancy_of_word(field).equal(relevancy_of_word(altered(field, words=field.words)))
    assert not relevancy_of_word(field).equal(before)
    assert field.coded_levels().equal((field.code_weights > 0).any(-1).T)


def test_the_same_text_again_has_an_answer_of_its_own(field: LanguageField) -> None:
    question = field.question("word 3", always=True)
    first = field.location(question)
    expected, thing = first.to_dict(), first.thing
    assert field.question("word 3") is field.question("word 3") is not question
    assert thing is not None
    first.answer.mask[:] = True
    thing.position[:] = thing.gaussians[:] = 0
    assert field.location(question).to_dict() == expected
    assert not field.location(question).answer.mask.all()
    either = field.question(["word 3", "word 4"], always=True)
    field.select(either).mask[:] = False
    assert field.select(either).mask.any()


def test_fields_of_the_same_tensors_keep_answers_of_their_own(field: LanguageField) -> None:
    expected, relevancy = field.location("word 3").to_dict(), relevancy_of_word(field)
    assert without_things(field).answer("word 3").threshold is not None
    other = field.with_encoder(dict(zip(WORDS, random_vectors(len(WORDS), 16, seed=6), strict=True)))
    assert other.code_weights is field.code_weights
    assert (len(field.cache), len(other.cache)) == (len(field.cache), 0)
    assert not relevancy_of_word(other).equal(relevancy)
    assert relevancy_of_word(field).equal(relevancy)
    moved = field.with_gaussians(field.gaussians)
    for each in (field, moved):
        assert each.location("word 3").to_dict() == expected


def test_many_questions_keep_memory_flat(field: LanguageField) -> None:
    field.cache = Cache(25_000)
    sizes, dice = [], np.random.default_rng(0)
    for number in range(75):
        one, other = dice.choice(WORDS[4:], 2, replace=False).tolist()
        if number % 3 == 0:
            level, always = int(dice.integers(2)), bool(dice.integers(2))
            field.location(field.question([one, other], level=level, always=always))
        elif number % 3 == 1:
            field.select(f"{one} and not {other}")
        else:
            field.location(random_vectors(16, seed=number))
        sizes.append((len(field.cache), field.cache.bytes))
    count, n_bytes = (max(each) for each in zip(*sizes, strict=True))
    assert 10 < count <= 25_000 / ENTRY_BYTES
    assert 20_000 < n_bytes <= 25_000


def test_what_is_kept_is_the_newest_within_bounds() -> None:
    entry = ENTRY_BYTES + 100
    kept = Cache(3 * entry)
    for number in range(4):
        kept.keep(number, bytes([number]) * 100)
    assert [(kept.get(number) or b"none")[:1] for number in range(4)] == [b"n", b"\1", b"\2", b"\3"]
    kept.get(1)
    kept.keep(4, bytes(100 + 1))  # a byte too many
    assert [kept.get(number) is None for number in (1, 2, 3, 4)] == [False, True, True, False]
    kept.keep(5, bytes(3 * entry))
    assert kept.get(5) is None
    kept.keep(4, [torch.zeros(2), torch.zeros(3)])
    assert kept.bytes == entry + ENTRY_BYTES + 20
    kept.clear()
    assert (len(kept), kept.bytes) == (0, 0)


def test_parts_that_change_while_a_value_is_made_leave_nothing() -> None:
    part, kept = torch.zeros(3), Cache(1 << 20)
    assert kept.value("sum", lambda: part.add_(1).sum(), [part]) == 3
    assert len(kept) == 0
    assert kept.value("sum", lambda: part.sum() + 1, [part]) == 4
    assert kept.value("sum", lambda: part.sum(), [part]) == 4
    assert kept.value("sum", lambda: part.sum(), [part.clone()]) == 3  # another tensor
    with torch.inference_mode():
        part = torch.zeros(3)  # such tensors count no versions
        assert kept.value("sum", lambda: part.sum(), [part]) == 0


def test_a_view_keeps_what_further_questions_reuse(field: LanguageField, monkeypatch) -> None:
    weights = field.code_weights.clone()  # those of other tests stay as they are
    field = altered(field, code_weights=weights, words=field.words)
    view, queries, canonical = field.at(0), random_vectors(12, 16), random_vectors(3, 16, seed=1)
    view.relevancy(queries[:1], canonical)
    known = view.cache.get(PixelCosines, field.parts())
    view.relevancy(queries, canonical)  # more than are rendered as channels
    assert view.cache.get(PixelCosines, field.parts()) is known

    def edited(*arguments: Any) -> Any:
        """Another thread writes between the computing and the keeping."""
        found = pixel_relevancy(*arguments)
        field.code_weights.mul_(0)
        return found

    monkeypatch.setattr("scoup.field.field.pixel_relevancy", edited)
    view.relevancy(queries[:1], canonical)
    monkeypatch.undo()
    assert view.relevancy(queries[1:2], canonical).eq(0.5).all()


def test_fields_with_other_cameras_and_encoders_answer_by_these() -> None:
    room = planted_room(cameras=(FRONT,))
    for camera in (FRONT, BACK):
        other = room.changed(room.gaussians, cameras=Cameras([camera]))
        assert other.select("mug left of the laptop").seen_from == camera.name
    room = named_room({"mug": {MUG: 0.6}, "lamp": {LAMP: 0.6}})
    encoder = room.encoder
    mug, lamp, *others = encoder.encode(["mug", "lamp", *CANONICAL_PHRASES])
    for one, other in ((mug, lamp), (lamp, mug)):
        vectors = dict(zip(CANONICAL_PHRASES, others, strict=True), mug=one, lamp=other, beaker=one + 0.01)
        assert room.with_encoder(TextEncoder.open(vectors)).question("beaker").near == ("mug",)


def test_several_threads_ask_one_field(field: LanguageField) -> None:
    words = WORDS[4:10]
    fresh = field.with_gaussians(field.gaussians)

    def answers(asked: LanguageField, word: str) -> tuple[object, ...]:
        question = asked.question([word, "word 20"], always=True)
        return (
            asked.location(word).to_dict(),
            asked.at(1).answer(word).to_dict(),
            [thing.to_dict() for thing in asked.things(word)],
            asked.select(f"{word} and not word 20").to_dict(),
            asked.label(question).counts(),
        )

    def ask(start: int) -> list[tuple[str, object]]:
        return [(word, answers(field, word)) for word in (words[start:] + words[:start]) * 2]

    expected = {word: answers(fresh, word) for word in words}
    with ThreadPoolExecutor(4) as pool:
        found = [pair for pairs in pool.map(ask, range(0, 12, 3)) for pair in pairs]
    assert len(found) == 4 * 2 * len(words)
    assert all(records == expected[word] for word, records in found)


def test_a_smaller_look(field: LanguageField) -> None:
    question = field.question("word 3", always=True)
    answer, whole = field.at(0, scale=0.5).answer(question), field.at(0).answer(question)
    assert answer.mask.shape == tuple(round(side / 2) for side in whole.mask.shape)
    assert field.cameras is not None
    small = field.cameras.scaled(0.5)[0]
    assert field.at(small).answer(question).to_dict() == answer.to_dict()
