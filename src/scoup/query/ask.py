"""The one way to ask: a text, phrase or expression, and the things and Gaussians of the scene that answer it.

Command line, page and agents show these answers. Relations and orders are of things; "and" and "not" are of Gaussians:
a thing answers where more than half of its Gaussians do.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product
from typing import Any

import torch
from torch import Tensor

from scoup.field import Field
from scoup.models import TextEncoder
from scoup.query.answer import Answer, ExpressionAnswer
from scoup.query.expression import Expression, Node, Operation
from scoup.query.frame import scene_frame
from scoup.query.named import named_texts
from scoup.query.phrases import Phrase, texts_of
from scoup.query.presence import is_present, text_scores
from scoup.query.question import Question, make_question
from scoup.query.relations import overlaps, resolve
from scoup.query.thing_judge import thing_index
from scoup.query.thing_names import find_objects, named_things
from scoup.query.things import Thing, best_part, things_of_answer
from scoup.query.votes import SampledVotes, select_each


def each_answer(field: Field, question: Question[Any]) -> Iterator[Answer]:
    """Yield the answer of the scene to each text; every way to ask calls this.

    Things answer where the field has them. The votes of the Gaussians answer in other fields, and where the question
    has a threshold for them.

    Raises:
        InputError: the vectors do not fit the field, or the threshold is not 0 to 1.
    """
    table, index = field.thing_table, thing_index(field, question) if question.threshold is None else None
    if table is None or index is None:
        yield from _by_votes(field, question)
        return
    for number, (verdict,) in enumerate(index.judge(question, named_texts(table, question))):
        things = verdict.things if verdict.presence else ()
        yield Answer(
            text=question.texts[number],
            mask=table.members(torch.tensor(things, dtype=torch.int64)).cpu(),
            level=field.levels[verdict.level],
            score=verdict.score,
            asked=question.vectors_of(number, verdict.level),
            presence=verdict.presence,
            things=things,
            scores=verdict.scores if verdict.presence else (),
            runner_up=verdict.runner_up,
        )


def _by_votes(field: Field, question: Question[Any]) -> Iterator[Answer]:
    scores: list[float | None] = [None] * len(question.texts)
    if question.can_judge_presence:
        words = (vectors.cpu().numpy().tobytes() for vectors in (question.everyday, question.canonical))
        votes = field.kept((SampledVotes, *words), lambda: SampledVotes(field, question))
        fits, of_texts = votes.fits(question.queries).tolist(), text_scores(question, votes.best_fits[None])
        scores = [score(fit) for score, fit in zip(of_texts, fits, strict=True)]
    for number, (selection, score) in enumerate(zip(select_each(field, question), scores, strict=True)):
        text, level, mask = question.texts[number], field.levels[selection.level], selection.mask.cpu()
        presence = is_present(score, int(mask.sum()), question.present_from)
        asked = question.vectors_of(number, selection.level)
        mask = mask if presence else torch.zeros_like(mask)
        yield Answer(text, mask, level, score, asked, presence, threshold=selection.threshold)


def answers_of(field: Field, question: Question[Any], keep: bool = True) -> list[Answer]:
    """Return the answer to each text, phrase or expression, from the cache of the field as a copy for the caller; with
    ``keep`` false, without the cache: for questions that nobody will ask again."""

    def made() -> list[Answer]:
        answers = list(each_answer(field, question))
        of_text = {answer.text: answer for answer in answers}
        return answers if not question.asked else [
            of_text[tree.root] if isinstance(tree.root, str) else evaluated(field, question, said, tree, of_text)
            for said, tree in question.asked
        ]  # fmt: skip

    return copy.deepcopy(field.kept((Answer, question), made)) if keep else made()


def one_answer(field: Field, question: Question[Any]) -> ExpressionAnswer:
    """Return the answer to all texts, phrases and expressions of a question together, any of which may answer."""
    tree = Expression.of([tree.root for _, tree in question.asked] or list(question.texts))
    answers = list(each_answer(field, question)) if question.asked else answers_of(field, question)
    return evaluated(field, question, str(tree), tree, {answer.text: answer for answer in answers})


def things_of_question(field: Field, question: Question[Any]) -> list[Thing]:
    """Return the things that a question singles out, each once, best first."""
    return _once(thing for answer in answers_of(field, question) for thing in things_of_answer(field, answer))


def asked_things(field: Field, encoder: TextEncoder, texts: Any, present_from: float | None) -> list[Thing]:
    """Return the things that texts single out; without a least score, presence is not judged."""
    return things_of_question(field, make_question(field, encoder, texts, present_from is None, present_from))


@dataclass(frozen=True, eq=False)
class _Selected:
    """The selection of a part of an expression."""

    mask: Tensor  # [N] boolean
    things: tuple[Thing, ...] = ()  # that may answer
    excluded: tuple[Thing, ...] = ()  # under "not"

    @staticmethod
    def of(node: Node, of_leaf: Callable[[str | Phrase], _Selected]) -> _Selected:
        """Return the selection of a node from those of its leaves."""
        if not isinstance(node, Operation):
            return of_leaf(node)
        first, *others = (_Selected.of(part, of_leaf) for part in node.parts)
        if node.operator == "not":
            return _Selected(~first.mask, first.excluded, first.things)
        for other in others:
            first = _Selected(
                first.mask & other.mask if node.operator == "and" else first.mask | other.mask,
                first.things + other.things,
                first.excluded + other.excluded,
            )
        return first


def evaluated(
    field: Field, question: Question[Any], said: str, tree: Expression, answers: Mapping[str, Answer]
) -> ExpressionAnswer:
    """Return the answer to an expression, asked as ``said``, from the answers to its texts: leaves become things,
    operators join them."""
    frame = (question.frame or scene_frame(field)) if tree.phrases else None
    parts = [answers[text] for text in tree.texts]
    ranked = sorted(
        (answers[text] for text in tree.wanted), key=lambda one: (one.presence, one.score or 0.0), reverse=True
    )  # fmt: skip
    best, by_things, wanted = ranked[0], parts[0].threshold is None, tree.leaves(True)
    of_texts = _things_of_texts(field, question, parts) if by_things or frame is not None else {}

    def of_leaf(leaf: str | Phrase) -> _Selected:
        things: list[Thing] = []
        if of_texts:
            # Parts are of other levels than the one that was asked for.
            by_text = of_texts if question.level is not None else apart(field, question, leaf, of_texts)
            things = resolve(field, leaf, by_text, frame)
        mask = answers[leaf].mask if isinstance(leaf, str) else _union(things, len(field))
        return _Selected(mask, tuple(things))

    selected = _Selected.of(tree.root, of_leaf)
    mask, matches = selected.mask, [] if isinstance(tree.root, Operation) else list(selected.things)
    if by_things:
        candidates = _once(selected.things if wanted else of_texts[""])
        matches = [thing for thing in candidates if 2 * int(mask[thing.gaussians].sum()) > thing.n_gaussians]
    presence = best.presence
    if not tree.is_plain:
        presence = bool(matches) if by_things and wanted else bool(mask.any())
    numbers = {thing.number: thing.score for thing in matches if thing.number is not None}
    without = {thing.number for thing in selected.excluded if thing.number is not None}
    return ExpressionAnswer(
        text=said,
        mask=mask if presence or tree.is_plain else torch.zeros_like(mask),
        level=matches[0].level if matches and frame is not None else best.level,
        score=best.score if wanted else None,  # texts under "not" alone have no score
        asked=best.asked,
        presence=presence,
        things=tuple(numbers),
        scores=tuple(numbers.values()),
        runner_up=best.runner_up if tree.is_plain and len(parts) == 1 else None,
        threshold=best.threshold,
        tree=tree,
        parts=tuple(parts),
        found=tuple(matches),
        without=tuple(sorted(without - numbers.keys())),
        seen_from=frame.seen_from if frame and any(phrase.is_seen for phrase in tree.phrases) else "",
    )


def _things_of_texts(
    field: Field, question: Question[Any], answers: Sequence[Answer]
) -> dict[str, list[Thing]]:
    """Return the things that answer each text, and of "" all objects, where they are asked for."""
    everything = question.everything
    objects = [] if everything is None else find_objects(field, named_things(field, everything))
    return {"": objects, **{answer.text: things_of_answer(field, answer) for answer in answers}}


def apart(
    field: Field, question: Question[Any], leaf: str | Phrase, of_texts: Mapping[str, list[Thing]]
) -> Mapping[str, list[Thing]]:
    """Return the things of each text, none of them for two texts of a phrase, as a plate with a doughnut may be.

    Where one is, or contains, a thing that answers another text, the parts that fit each text best replace them, if
    they are two things.
    """
    by_text = dict(of_texts)
    for texts in combinations(dict.fromkeys(texts_of(leaf)), 2):
        for pair in product(*(of_texts[text] for text in texts)):
            if not _nested(field, *pair):
                continue
            parts = [best_part(field, question, text, thing) for text, thing in zip(texts, pair, strict=True)]
            if not overlaps(*parts):
                for text, thing, part in zip(texts, pair, parts, strict=True):
                    by_text[text] = [part if one.number == thing.number else one for one in by_text[text]]
    return by_text


def _nested(field: Field, one: Thing, other: Thing) -> bool:
    """Return whether one of two things is the other, or a part of it."""
    table = field.thing_table
    if table is None or one.number is None or other.number is None:
        return False
    return bool(table.parts(one.number)[other.number] or table.parts(other.number)[one.number])


def _union(things: Iterable[Thing], count: int) -> Tensor:
    """Return the Gaussians of things, [count] boolean."""
    mask = torch.zeros(count, dtype=torch.bool)
    for thing in things:
        mask[thing.gaussians] = True
    return mask


def _once(things: Iterable[Thing]) -> list[Thing]:
    first: dict[int, Thing] = {}
    for thing in things:
        first.setdefault(id(thing) if thing.number is None else thing.number, thing)
    return list(first.values())
