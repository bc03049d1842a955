"""Expressions over texts, such as "mug and not handle"."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, reduce
from typing import TypeAlias

from scoup.base import InputError
from scoup.query.phrases import (
    OPERATORS,
    RESERVED,
    Phrase,
    begins_with_relation,
    parse_phrase,
    protected,
    quoted,
    texts_of,
)

_TOKEN = re.compile(r'"([^"]*)"|([()])|([^\s()"]+)')
USAGE = 'write texts joined by and, or, not, + and -, for example "mug and not handle"'
_DEEPEST = 50  # operators within operators


@dataclass(frozen=True)
class Operation:
    """ "not" of one part, or "and" or "or" of two or more."""

    operator: str
    parts: tuple[Node, ...]
    of_one: bool = False
    """Of "and": the parts after the first began with a relation and took over its text."""


Node: TypeAlias = "str | Phrase | Operation"
"""A text, a phrase over things, or an operation."""


@dataclass(frozen=True)
class Expression:
    """Texts joined by operators. One of a text alone keeps the text as it is."""

    root: Node

    @classmethod
    def of(cls, nodes: Sequence[Node]) -> Expression:
        """Combine texts, phrases and operations with `or`."""
        return cls(nodes[0] if len(nodes) == 1 else Operation("or", tuple(nodes)))

    @property
    def texts(self) -> tuple[str, ...]:
        """The texts in their order, each once."""
        return tuple(dict.fromkeys(text for leaf in self.leaves() for text in texts_of(leaf)))

    @property
    def wanted(self) -> tuple[str, ...]:
        """The first texts of what is under an even number of "not"; all texts if nothing is."""
        return tuple(dict.fromkeys(texts_of(leaf)[0] for leaf in self.leaves(True))) or self.texts

    @property
    def phrases(self) -> tuple[Phrase, ...]:
        """Its parts that single out things by relation or order."""
        return tuple(leaf for leaf in self.leaves() if isinstance(leaf, Phrase))

    @property
    def is_plain(self) -> bool:
        """Return whether it is texts without phrases, and its only operator is "or"."""
        return not self.phrases and set(_operators(self.root)) <= {"or"}

    @property
    def wants_everything(self) -> bool:
        """Return whether it is about things that it does not name, as in "what is on the table" and "not mug"."""
        unnamed = any(not inner.text for phrase in self.phrases for inner in phrase.parts)
        return unnamed or not self.leaves(True)

    def leaves(self, wanted: bool | None = None) -> tuple[str | Phrase, ...]:
        """Return its texts and phrases, each once; those under an even number of "not", or all others, if asked."""
        signed = _signed(self.root, True)
        return tuple(dict.fromkeys(leaf for leaf, sign in signed if wanted in (None, sign)))

    @property
    def excluded(self) -> tuple[str, ...]:
        """The texts that stand under "not" only."""
        needed = {text for leaf in self.leaves(True) for text in texts_of(leaf)}
        return tuple(text for text in self.texts if text not in needed)

    def __str__(self) -> str:
        return _text_of(self.root)


def parse_expression(words: Iterable[str] | str, names: Iterable[str] | None = None) -> Expression:
    """Parse the words of a command line.

    ``not`` binds closest, then ``and``, then ``or``, ``+`` (the same) and ``-`` (and not), which are operators only
    between spaces; brackets group. A text may have several words. Double quotes make one text of operators, as in
    ``'"salt and pepper"'``. Texts without an operator are combined with ``or``. A text with a relation or an order,
    such as "mug left of the laptop" or "largest mug", is a phrase over things (``scoup.query.phrases``), unless it
    stands in double quotes. One that begins with a relation after an operator, as in "mug on the table and near the
    laptop", is about the text before. A question mark at the end is left out.

    Args:
        words: texts, operators, or expressions; or one of them.
        names: of a word table: they are taken whole, also within phrases, as "power plugs and sockets on the desk".

    Raises:
        InputError: it is not an expression.

    Example:
        >>> scoup.parse_expression(["mug and not handle", "plate"]).texts
        ('mug', 'handle', 'plate')
    """
    given = [words] if isinstance(words, str) else list(words)
    known, kept_whole = name_forms(tuple(names or ()))
    tokens: list[str] = []
    for word in given:
        text = word.strip()
        if not text:
            raise InputError(f"a text is blank; {USAGE}")
        if text.casefold() in known:
            group = ["(", f"={protected(text)}", ")"]
        elif text.lower() in OPERATORS:
            group = [text.lower()]
        else:
            pieces = text.removesuffix("?").split('"')
            pieces[::2] = [kept_whole.sub(r'"\g<0>"', piece) for piece in pieces[::2]]
            group = ["(", *_tokens('"'.join(pieces)), ")"]
        if tokens and tokens[-1] == ")" and group[0] == "(":
            tokens.append("or")
        tokens += group
    reader = _Reader(tokens, " ".join(given))
    root = reader.union()
    if reader.rest:
        raise reader.unexpected()
    return Expression(root)


@lru_cache(maxsize=4)
def name_forms(names: tuple[str, ...]) -> tuple[frozenset[str], re.Pattern[str]]:
    """Return the case-folded names, and a pattern for names that look like phrases or expressions, longest first."""
    parts = {tuple(map(re.escape, name.split())) for name in names if RESERVED & {*name.lower().split()}}
    forms = sorted((r"\s+".join(words) for words in parts if len(words) > 1), key=len, reverse=True)
    pattern = rf"(?<![^\s(])(?:{'|'.join(forms)})(?![^\s),;.])" if forms else r"(?!)"
    return frozenset(name.casefold() for name in names), re.compile(pattern, re.IGNORECASE)


def _tokens(text: str) -> list[str]:
    """Return operators as they are, and texts after a prefix, `=`, that marks them as texts."""
    tokens: list[str] = []
    if text.count('"') % 2:
        raise InputError(f"{text}: a double quote is not closed; {USAGE}")
    for inside, bracket, word in _TOKEN.findall(text):
        piece = word or protected(inside)
        if bracket or word.lower() in OPERATORS:
            tokens.append(bracket or word.lower())
        elif piece and tokens and tokens[-1][0] == "=":
            tokens[-1] += f" {piece}"
        elif piece:
            tokens.append(f"={piece}")
    return tokens


class _Reader:
    """A parser by recursive descent, which takes tokens from the left."""

    def __init__(self, tokens: list[str], source: str) -> None:
        self.rest, self.source, self.depth = tokens, source, 0
        self.before = ""  # the operator in front of the text that comes next

    def refusal(self, problem: str) -> InputError:
        return InputError(f"{self.source}: {problem}; {USAGE}")

    def unexpected(self) -> InputError:
        """Return the refusal of the next token."""
        token = self.rest[0]
        if token == "not":
            return self.refusal("'not' must follow 'and' or 'or'")
        if token == ")":
            return self.refusal("a bracket is closed that was not opened")
        problem = (
            "an operator is missing beside a bracket; put a text that contains brackets in double quotes"
        )
        return self.refusal(problem)

    def union(self) -> Node:
        last, before = self.intersection(), self.depth
        left = last
        while self.rest and self.rest[0] in ("or", "+", "-"):
            operator = self.before = self.rest.pop(0)
            last = self.intersection(self.noun_of_next(last))
            if operator == "-":
                left = self.combine("and", left, Operation("not", (last,)))
            else:
                left = self.combine("or", left, last)
        self.depth = before
        return left

    def intersection(self, noun: str = "") -> Node:
        parts = [self.factor(noun)]
        while self.rest and self.rest[0] == "and":
            self.before = self.rest.pop(0)
            last = parts[-1]
            if noun := self.noun_of_next(last):
                before = last.parts if isinstance(last, Operation) and last.of_one else (last,)
                parts[-1] = Operation("and", (*before, self.factor(noun)), of_one=True)
            else:
                parts.append(self.factor())
        return reduce(lambda left, right: self.combine("and", left, right), parts)

    def noun_of_next(self, before: Node) -> str:
        """Return the text that the next part takes over from the one before, if it begins with a relation."""
        after = next((token for token in self.rest if token != "not"), "")
        return _noun_of(before) if after[:1] == "=" and begins_with_relation(after[1:]) else ""

    def combine(self, operator: str, left: Node, right: Node) -> Node:
        if isinstance(left, Operation) and left.operator == operator and not left.of_one:
            return Operation(operator, (*left.parts, right))
        self.deeper()
        return Operation(operator, (left, right))

    def deeper(self) -> None:
        self.depth += 1
        if self.depth > _DEEPEST:
            raise self.refusal("operators are nested too deeply")

    def factor(self, noun: str = "") -> Node:
        token = self.rest.pop(0) if self.rest else ""
        if not token or (token in OPERATORS and token not in ("not", "(")):
            where = f" after {self.before!r}" if self.before else f" before {token!r}" if token != ")" else ""
            raise self.refusal(f"a text is missing{where}")
        if token[0] == "=":
            token = f"={noun} {token[1:]}" if noun else token
            while (
                token.lower().count(" between ") > token.count(" and ")
                and self.rest[:1] == ["and"]
                and self.rest[1:2]
                and self.rest[1][0] == "="
            ):
                token += f" and {self.rest[1][1:]}"
                self.rest = self.rest[2:]
            return parse_phrase(token[1:])
        before, self.before = self.depth, token if token == "not" else ""
        self.deeper()
        inner: Node = Operation("not", (self.factor(noun),)) if token == "not" else self.union()
        if token == "(":
            if not self.rest:
                raise self.refusal("a bracket is not closed")
            if self.rest[0] != ")":
                raise self.unexpected()
            self.rest.pop(0)
        self.depth = before
        return inner


def _signed(node: Node, sign: bool) -> Iterator[tuple[str | Phrase, bool]]:
    """Yield the leaves, and whether each is under an even number of "not"."""
    if not isinstance(node, Operation):
        yield node, sign
        return
    for child in node.parts:
        yield from _signed(child, sign != (node.operator == "not"))


def _noun_of(node: Node) -> str:
    """Return the text that a relation after a part is about, protected; "" if there is none."""
    if isinstance(node, Operation):
        return _noun_of(node.parts[0]) if node.of_one else ""
    return protected(node if isinstance(node, str) else node.text or "thing")


def _operators(node: Node) -> list[str]:
    if not isinstance(node, Operation):
        return []
    return [node.operator, *(operator for child in node.parts for operator in _operators(child))]


def _text_of(node: Node, outer: str = "") -> str:
    if isinstance(node, Phrase):
        return str(node)
    if isinstance(node, str):
        return quoted(node)
    if node.operator == "not":
        return f"not {_text_of(node.parts[0], 'not')}"
    texts = [_text_of(child, node.operator) for child in node.parts]
    if node.of_one:
        texts[1:] = [_relation_of(child) for child in node.parts[1:]]
    text = f" {node.operator} ".join(texts)
    return f"({text})" if outer not in ("", node.operator) else text


def _relation_of(node: Node) -> str:
    """Return the text of a part without the noun that it took over."""
    if isinstance(node, Operation):
        return f"not {_relation_of(node.parts[0])}"
    assert isinstance(node, Phrase)
    return str(node).removeprefix(f"{replace(node, relation='', anchors=())} ")
