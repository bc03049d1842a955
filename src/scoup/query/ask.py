"""The one way to ask: a text, phrase or expression, and the things and Gaussians of the scene that answer it.

Command line, page and agents show these answers. Relations and orders are of things; "and" and "not" are of Gaussians:
a thing answers where more than half of its Gaussians do.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import combinations, product
from typing import Any

import torch

from scoup.field.language_field import LanguageField
from scoup.query.answer import Answer
from scoup.query.answer_scene import answer_scene
from scoup.query.expression import Expression
from scoup.query.phrases import Phrase, texts_of
from scoup.query.presence import LEAST_GAUSSIANS
from scoup.query.question import Question, Several, as_question
from scoup.query.relations import overlaps, resolve
from scoup.query.thing_names import find_objects, named_things
from scoup.query.things import Thing, all_things, scored_things, text_fits, things_of_answer


def answer(field: LanguageField, question: Question[Any] | str | Several) -> Any:
    """Return the answers to texts, or the answer to one; ``field.answer`` documents it."""
    asked = as_question(field, question)
    return asked.shaped(answers_of(field, asked))


def answers_of(field: LanguageField, question: Question[Any]) -> list[Answer]:
    """Return the answer to each text, phrase or expression from the cache of the field, as a copy for the caller."""
    return copy.deepcopy(field.kept((Answer, question), lambda: made_answers(field, question)))


def made_answers(field: LanguageField, question: Question[Any]) -> list[Answer]:
    """Return ``answers_of`` without the cache."""
    answers = answer_scene(field, question)
    if not question.asked:
        return answers
    return [_joined(field, question, said, expression, answers) for said, expression in question.asked]


def one_answer(field: LanguageField, question: Question[Any]) -> Answer:
    """Return the answer to all texts, phrases and expressions of a question together, any of which may answer.

    Its ``parts`` are the answers to the texts.
    """
    nodes = [expression.root for _, expression in question.asked] or list(question.texts)
    expression = Expression.of(nodes, any(each.counted for _, each in question.asked))
    answers = answer_scene(field, question) if question.asked else answers_of(field, question)
    whole = _joined(field, question, str(expression), expression, answers)
    return replace(whole, parts=whole.parts or (whole,))


def things(field: LanguageField, question: Question[Any] | str | Several | None) -> list[Thing]:
    """Return all things, or those that a question singles out; ``field.things`` documents it."""
    if question is None:
        return copy.deepcopy(all_things(field))
    answers = answers_of(field, as_question(field, question))
    return _once(thing for each in answers for thing in things_of_answer(field, each))


def _joined(
    field: LanguageField,
    question: Question[Any],
    said: str,
    expression: Expression,
    answers: Sequence[Answer],
) -> Answer:
    """Return the answer to an expression from those to its texts.

    Level, score, runner-up and threshold are those of the wanted text with the largest score.
    """
    of_text = {answer.text: answer for answer in answers}
    parts = tuple(of_text[text] for text in expression.texts)
    if expression.root == parts[0].text and not expression.counted:
        return parts[0]
    by_things = parts[0].threshold is None
    frame = (question.frame or field.frame()) if expression.phrases else None
    of_leaf: dict[Any, list[Thing]] = {leaf: [] for leaf in expression.leaves()}
    of_texts: dict[str, list[Thing]] = {}
    if by_things or expression.counted or frame is not None:
        of_texts = {part.text: things_of_answer(field, part) for part in parts}
        of_texts[""] = (
            find_objects(field, named_things(field, question.everything)) if question.everything else []
        )
        for leaf in of_leaf:  # parts are of other levels
            own = of_texts if question.level is not None else apart(field, leaf, of_texts, of_text)
            of_leaf[leaf] = resolve(field, leaf, own, frame)
    masks = {text: part.mask for text, part in of_text.items()}
    for leaf, mine in of_leaf.items():
        if expression.counted or not isinstance(leaf, str):
            masks[str(leaf)] = torch.zeros(len(field), dtype=torch.bool)
            for thing in mine:
                masks[str(leaf)][thing.gaussians] = True
    mask, wanted = expression.combine(masks), expression.leaves(True)
    found = of_leaf.get(expression.root, [])
    if by_things:
        mine = [thing for leaf in wanted for thing in of_leaf[leaf]] if wanted else of_texts[""]
        found = [thing for thing in _once(mine) if 2 * int(mask[thing.gaussians].sum()) > thing.n_gaussians]
    without = [thing.number for leaf in expression.leaves(False) for thing in of_leaf[leaf]]
    needed = {text for leaf in wanted for text in texts_of(leaf)}
    ranked = [of_text[text] for text in expression.wanted]
    ranked.sort(key=lambda each: (each.presence, each.score or 0.0), reverse=True)
    present = ranked[0].presence
    if not expression.is_plain:
        present = bool(found) if by_things and wanted else bool(mask.any())
        mask = mask if present else torch.zeros_like(mask)
    numbers = tuple(thing.number for thing in found if thing.number is not None)
    judged = {} if wanted else {"score": None, "runner_up": None}  # by a text that is not wanted
    return replace(
        ranked[0],
        text=said,
        mask=mask,
        level=found[0].level if found and frame is not None else ranked[0].level,
        presence=present,
        things=numbers,
        wanted=expression.wanted,
        excluded=tuple(text for text in expression.texts if text not in needed),
        without=tuple(sorted({number for number in without if number is not None} - {*numbers})),
        parts=parts,
        asked=tuple(one for each in ranked for one in each.asked),
        seen_from=frame.seen_from if frame and any(each.is_seen for each in expression.phrases) else "",
        found=tuple(found),
        **judged,
    )


def apart(
    field: LanguageField,
    leaf: str | Phrase,
    of_texts: Mapping[str, list[Thing]],
    answers: Mapping[str, Answer],
) -> Mapping[str, list[Thing]]:
    """Return the things of each text, of which none answers two texts of a phrase, as a plate with a doughnut may.

    Where one is, or contains, a thing that answers another text, the parts that fit each text best replace them, if
    they are two things.
    """
    found = dict(of_texts)
    for texts in combinations(dict.fromkeys(texts_of(leaf)), 2):
        for pair in product(*(of_texts[text] for text in texts)):
            if not _nested(field, *pair):
                continue
            parts = [_best_part(field, answers[text], thing) for text, thing in zip(texts, pair, strict=True)]
            if not overlaps(*parts):
                for text, thing, part in zip(texts, pair, parts, strict=True):
                    found[text] = [part if each.number == thing.number else each for each in found[text]]
    return found


def _nested(field: LanguageField, one: Thing, other: Thing) -> bool:
    """Return whether one of two things is the other, or a part of it."""
    table = field.thing_table
    if table is None or one.number is None or other.number is None:
        return False
    return bool(table.parts(one.number)[other.number] or table.parts(other.number)[one.number])


def _best_part(field: LanguageField, answer: Answer, thing: Thing) -> Thing:
    """Return the part of a thing that fits the text of an answer best, or the thing itself."""
    known, fits = text_fits(field, answer)
    assert thing.number is not None
    assert field.thing_table is not None
    inside = field.thing_table.parts(thing.number) & known.usable & (known.counts >= LEAST_GAUSSIANS)
    best = max(inside.nonzero()[:, 0].tolist(), key=fits.__getitem__, default=thing.number)
    return thing if best == thing.number else next(iter(scored_things(field, answer, [best])), thing)


def _once(things: Iterable[Thing]) -> list[Thing]:
    """Return things, each once."""
    first: dict[int, Thing] = {}
    for thing in things:
        first.setdefault(id(thing) if thing.number is None else thing.number, thing)
    return list(first.values())
