"""Phrases that single out things: "mug left of the laptop", "largest box", "second chair from the left"."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from scoup.base import InputError, UnknownNameError
from scoup.models import ARTICLES, CANONICAL_PHRASES, TextEncoder

RELATIONS: dict[str, tuple[str, ...]] = {
    "left of": ("to the left of", "on the left of", "left of"),
    "right of": ("to the right of", "on the right of", "right of"),
    "in front of": ("in front of",),
    "behind": ("behind",),
    "on": ("on top of", "on", "upon", "atop"),
    "above": ("above", "over"),
    "under": ("under", "below", "beneath", "underneath"),
    "between": ("in between", "between"),
    "nearest to": ("nearest to", "closest to", "nearest", "closest"),
    "near": ("next to", "close to", "near to", "near", "beside"),
    "inside": ("inside of", "inside", "within", "in"),
}
"""Relations between two things (for "between" three), and the words for each."""
DIRECTED = ("left of", "right of", "in front of", "behind")
"""Relations that depend on where they are seen from."""
SIDES = ("left", "right", "top", "bottom", "front", "back")
SIZES = {"largest": "largest", "biggest": "largest", "smallest": "smallest"}
ORDINALS = ("first", "second", "third", "fourth", "fifth", "sixth", "seventh", "eighth", "ninth", "tenth")
_NUMBERED = re.compile(r"([1-9][0-9]?)(?:st|nd|rd|th)")
_UNKNOWN = re.findall(
    r"\w+",
    "across against along alongside amid among around beyond facing off opposite outside past through touching toward "
    "towards",
)
_FORMS = [form for forms in RELATIONS.values() for form in forms]
_UNFINISHED = frozenset(_FORMS)
"""Texts that lack the thing that they are about."""
_BEGINNINGS = tuple(f"{form} " for form in _FORMS if " " in form)
"""So do texts that begin with these; one word may be a part of a name, as in "on switch"."""
_ANYTHING = ("what", "what's", "thing", "things", "object", "objects", "anything", "everything", "something")
"""Words before a relation that stand for all objects of the scene."""
_FILLERS = ("is", "are", "that", "which", "there")
"""Words before a relation that say nothing."""
OPERATORS = ("and", "or", "not", "+", "-", "(", ")")
RESERVED = frozenset(" ".join((*SIZES, *ORDINALS, *OPERATORS, *_UNKNOWN, *_FORMS)).split())
"""Words of relations, orders and operators; names with one of them may be read as phrases."""
_STOPS = ",;."  # after a noun
_SPACE = "\0"  # before each word in double quotes
_DEEPEST = 8  # relations within relations
KNOWN_PHRASES = (
    f"known relations: {', '.join(RELATIONS)}; also largest, smallest, second largest, second ... from the "
    f"{', '.join(SIDES[:-1])} or {SIDES[-1]}; double quotes keep a text as it is"
)
WORDS = {
    "relations": RELATIONS, "sizes": SIZES, "sides": SIDES, "ordinals": ORDINALS, "unknown": _UNKNOWN,
    "anything": _ANYTHING, "fillers": _FILLERS, "articles": ARTICLES, "operators": OPERATORS,
    "forms": sorted(_FORMS, key=len, reverse=True), "beginnings": _BEGINNINGS, "phrases": KNOWN_PHRASES,
}  # fmt: skip
"""The words of the grammar, for pages that parse phrases themselves (viewer/src/phrases.ts)."""


@dataclass(frozen=True)
class Phrase:
    """A text, and the relation and order that single out some of its things. Relations count first, then the order."""

    text: str  # "" before a relation: any object
    relation: str = ""  # a key of RELATIONS; "" for none
    anchors: tuple[Target, ...] = ()  # targets of the relation: one, for "between" two
    order: str = ""  # "largest", "smallest", or one of SIDES to count from; "" keeps all
    rank: int = 1  # in that order

    @property
    def texts(self) -> tuple[str, ...]:
        """Return all texts to look for, its own first."""
        noun = (self.text,) if self.text else ()
        return *noun, *(text for anchor in self.anchors for text in texts_of(anchor))

    @property
    def parts(self) -> tuple[Phrase, ...]:
        """Return itself and the phrases in it."""
        inner = (phrase for anchor in self.anchors if isinstance(anchor, Phrase) for phrase in anchor.parts)
        return self, *inner

    @property
    def is_seen(self) -> bool:
        """Return whether its things depend on where it is seen from."""
        sides = ("left", "right", "front", "back")
        return any(phrase.relation in DIRECTED or phrase.order in sides for phrase in self.parts)

    def __str__(self) -> str:
        ordinal = ORDINALS[self.rank - 1] if self.rank <= len(ORDINALS) else f"{self.rank}th"
        text = quoted(self.text) if self.text else "thing" if self.order else "what is"
        if self.order in SIZES:
            text = f"{self.order} {text}" if self.rank == 1 else f"{ordinal} {self.order} {text}"
        elif self.order in SIDES:
            text = f"{ordinal} {text} from the {self.order}"
        anchors = " and ".join(quoted(one) if isinstance(one, str) else str(one) for one in self.anchors)
        return f"{text} {self.relation} {anchors}" if self.relation else text


Target: TypeAlias = "str | Phrase"
"""A text alone, all of whose things are meant, or a phrase."""


def texts_of(target: Target) -> tuple[str, ...]:
    """Return the texts of a target, its own first."""
    return (target,) if isinstance(target, str) else target.texts


def begins_with_relation(text: str) -> bool:
    """Return whether a text, such as "near the window", lacks the thing that has the relation."""
    words = text.lower().split()
    return any(len(words) > length for length, _ in _relations_at(words, 0))


def parse_phrase(text: str) -> Target:
    """Return the phrase that a text is, or the text itself if it names things without relation or order.

    Example:
        >>> parse_phrase("the largest mug left of the laptop")
        Phrase(text='mug', relation='left of', anchors=('laptop',), order='largest', rank=1)
        >>> parse_phrase("coffee mug")
        'coffee mug'
    """
    return _parse(text.split(), text, 0)


def explained(error: UnknownNameError, encoder: TextEncoder) -> UnknownNameError:
    """Return the error of a text that a word table lacks, with the longest part that the table has, and phrases of
    it; the same error where it has none."""
    words = [word for word in error.name.split() if word.lower() not in ARTICLES]
    spans = sorted((stop - start, start) for stop in range(len(words) + 1) for start in range(stop))
    for length, start in reversed(spans if RESERVED.isdisjoint(word.lower() for word in words) else ()):
        part = " ".join(words[start : start + length])
        if part in encoder and part.lower() not in CANONICAL_PHRASES:
            rest, word = " ".join(words[:start] + words[start + length :]), encoder.word_of(part)
            remedy = f"{word!r} is one of its names, {rest!r} is not; ask {word!r}, 'largest {word}' or 'second {word} "
            remedy += "from the left' (docs/things.md)" + "".join(error.remedy.partition(", or ")[1:])
            return UnknownNameError(error.kind, error.name, error.nearest, error.where, remedy)
    return error


def quoted(text: str) -> str:
    """Return a text as it is written: in double quotes where it would be read as a phrase or expression."""
    is_text = not (
        set(text.lower().split()) & set(OPERATORS) or set(text) & set('"()') or text.endswith(("?", *_STOPS))
    )
    try:
        is_text = is_text and parse_phrase(text) == text
        is_text = is_text and not begins_with_relation(text)
    except InputError:
        is_text = False
    return text if is_text else f'"{text}"'


def protected(text: str) -> str:
    """Return a text as one word, which ``parse_phrase`` takes as it is."""
    return "".join(_SPACE + word for word in text.split())


def _parse(words: Sequence[str], source: str, depth: int) -> Target:
    if depth > _DEEPEST:
        raise InputError(
            f"{source}: more than {_DEEPEST} relations within each other; ask for fewer at a time"
        )
    lowered = [word.lower() for word in words]
    first = next(_relations(lowered), None)
    end = len(words) if first is None else first[0]
    head, order, rank = _ordered(words[:end], source)
    if first is None:
        noun = _noun(head, source)
        return Phrase(noun, order=order, rank=rank) if order else _joined(words)
    _, relation, length = first
    rest = words[end + length :]
    while head and head[-1].lower() in _FILLERS:
        head = head[:-1]
    if relation == "between":
        middle = next((k for k, word in enumerate(rest) if word.lower() == "and"), None)
        if middle is None:
            raise _refusal(source, '"between" needs two things joined by "and"')
        parts = [rest[:middle], rest[middle + 1 :]]
    else:
        parts = [rest]
    anchors = tuple(_anchor(span, source, depth) for span in parts)
    noun = _noun(head, source)
    return Phrase("" if noun.lower() in _ANYTHING else noun, relation, anchors, order, rank)


def _relations(words: Sequence[str]) -> Iterator[tuple[int, str, int]]:
    """Yield the relations after the first word, from the left: start, relation and length in words."""
    for start in range(1, len(words)):
        if words[start] in _UNKNOWN:
            raise _refusal(" ".join(words), f"unknown relation {words[start]!r}")
        if matches := _relations_at(words, start):
            length, relation = max(matches)
            yield start, relation, length


def _relations_at(words: Sequence[str], start: int) -> list[tuple[int, str]]:
    return [
        (len(form.split()), relation)
        for relation, forms in RELATIONS.items()
        for form in forms
        if list(words[start : start + len(form.split())]) == form.split()
    ]


def _ordered(words: Sequence[str], source: str) -> tuple[Sequence[str], str, int]:
    """Return the words that say no order; the order, and the rank in it."""
    lowered = [word.lower() for word in words]
    first = 1 if lowered[:1] and lowered[0] in ARTICLES else 0
    rank = _rank(lowered[first]) if len(lowered) > first else None
    after = first + (rank is not None)
    if len(lowered) > after and lowered[after] in SIZES:
        return words[after + 1 :], SIZES[lowered[after]], rank or 1
    if len(lowered) > 3 and lowered[-3:-1] == ["from", "the"]:
        if lowered[-1] in SIDES:
            return words[after:-3], lowered[-1], rank or 1
        if rank is not None:
            raise _refusal(source, f"unknown side {lowered[-1]!r}")
    if rank is not None and rank > 1 and len(lowered) > after:
        raise _refusal(source, f"{lowered[first]!r} does not say from which side it is counted")
    return words, "", 1


def _rank(word: str) -> int | None:
    if word in ORDINALS:
        return ORDINALS.index(word) + 1
    numbered = _NUMBERED.fullmatch(word)
    return int(numbered[1]) if numbered else None


def _noun(words: Sequence[str], source: str) -> str:
    words = words[1:] if words and words[0].lower() in ARTICLES else words
    if words and not words[-1].startswith(_SPACE):
        words = [*words[:-1], words[-1].rstrip(_STOPS)]
    said = " ".join(words).lower()
    if not (noun := _joined(words)) or said in _UNFINISHED or said.startswith(_BEGINNINGS):
        raise _refusal(source, "a thing is missing")
    return noun


def _joined(words: Sequence[str]) -> str:
    return " ".join(" ".join(words).replace(_SPACE, " ").split())


def _anchor(words: Sequence[str], source: str, depth: int) -> Target:
    target = _parse(words, source, depth + 1)
    return _noun(words, source) if isinstance(target, str) else target


def _refusal(source: str, problem: str) -> InputError:
    return InputError(f"{_joined([source])}: {problem}; {KNOWN_PHRASES}")
