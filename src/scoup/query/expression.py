"""Expressions over texts, such as "mug and not handle"."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, reduce
from typing import TypeAlias

from torch import Tensor

from scoup.base.errors import InputError
from scoup.query.phrases import (
    OPERATORS,
    RESERVED,
    Phrase,
    begins_with_relation,
    counted_text,
    parse_phrase,
    protected,
    quoted,
    texts_of,
)

_TOKEN = re.compile(r'"([^"]*)"|([()])|([^\s()"]+)')
_GRAMMAR = 'write texts joined by and, or, not, + and -, for example "mug and not handle"'
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
    counted: bool = False
    """It asks how many: the things that are one instance each answer."""

    @classmethod
    def of(cls, nodes: Sequence[Node], counted: bool = False) -> Expression:
        """Combine texts, phrases and operations with `or`."""
        return cls(nodes[0] if len(nodes) == 1 else Operation("or", tuple(nodes)), counted)

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
        unnamed = any(not part.text for phrase in self.phrases for part in phrase.parts)
        return unnamed or not self.leaves(True)

    def leaves(self, wanted: bool | None = None) -> tuple[str | Phrase, ...]:
        """Return its texts and phrases, each once; those under an even number of "not", or all others, if asked."""
        signed = _signed(self.root, True)
        return tuple(dict.fromkeys(leaf for leaf, sign in signed if wanted in (None, sign)))

    def __str__(self) -> str:
        return f"how many {_text_of(self.root)}" if self.counted else _text_of(self.root)

    def as_count(self) -> Expression:
        """Return the expression that asks how many: "and" joins what is counted, but for what is under "not"."""
        return self if self.counted else Expression(_summed(self.root), True)

    def combine(self, masks: Mapping[str, Tensor]) -> Tensor:
        """Combine boolean masks of its texts and phrases (by their ``str``), of one shape."""
        return _combined(self.root, masks)


def parse_expression(words: Iterable[str] | str, names: Iterable[str] | None = None) -> Expression:
    """Parse the words of a command line.

    ``not`` binds closest, then ``and``, then ``or``, ``+`` (the same) and ``-`` (and not), which are operators only
    between spaces; brackets group. A text may have several words. Double quotes make one text of operators, as in
    ``'"salt and pepper"'``. Texts without an operator are combined with ``or``. A text with a relation or an order,
    such as "mug left of the laptop" or "largest mug", is a phrase over things (``scoup.query.phrases``), unless it
    stands in double quotes. One that begins with a relation after an operator, as in "mug on the table and near the
    laptop", is about the text before. "how many mugs" counts; "how many mugs and cups" counts both, and a relation of
    the last is one of all. A question mark at the end is left out.

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
    (known, kept_whole), counted = _names(tuple(names or ())), False
    tokens: list[str] = []
    for word in given:
        text = word.strip()
        if not text:
            raise InputError(f"a text is blank; {_GRAMMAR}")
        if text.casefold() in known:
            part = ["(", f"={protected(text)}", ")"]
        elif text.lower() in OPERATORS:
            part = [text.lower()]
        else:
            text = text.removesuffix("?")
            counted = counted or counted_text(text) is not None
            text = counted_text(text) or text
            pieces = text.split('"')
            pieces[::2] = [kept_whole.sub(r'"\g<0>"', piece) for piece in pieces[::2]]
            part = ["(", *_tokens('"'.join(pieces)), ")"]
        if tokens and tokens[-1] == ")" and part[0] == "(":
            tokens.append("or")
        tokens += part
    reader = _Reader(tokens, " ".join(given))
    root = reader.union()
    if reader.rest:
        raise reader.unexpected()
    return Expression(root).as_count() if counted else Expression(root)


@lru_cache(maxsize=4)
def _names(names: tuple[str, ...]) -> tuple[frozenset[str], re.Pattern[str]]:
    """Return names without case, and a pattern of those that may be read as phrases or expressions, longest first."""
    parts = {tuple(map(re.escape, name.split())) for name in names if RESERVED & {*name.lower().split()}}
    forms = sorted((r"\s+".join(words) for words in parts if len(words) > 1), key=len, reverse=True)
    pattern = rf"(?<![^\s(])(?:{'|'.join(forms)})(?![^\s),;.])" if forms else r"(?!)"
    return frozenset(name.casefold() for name in names), re.compile(pattern, re.IGNORECASE)


def _summed(node: Node) -> Node:
    """Return what is counted: in a count, "and" joins things to be counted, but for those under "not"."""
    if not isinstance(node, Operation) or node.operator == "not" or node.of_one:
        return node
    parts = tuple(_summed(part) for part in node.parts)
    excluded = tuple(part for part in parts if isinstance(part, Operation) and part.operator == "not")
    wanted = tuple(part for part in parts if part not in excluded)
    if node.operator == "or" or len(wanted) < 2:
        return Operation(node.operator, parts)
    *nouns, last = wanted
    if (
        isinstance(last, Phrase)
        and last.relation
        and not last.order
        and all(isinstance(each, str) for each in nouns)
    ):
        wanted = (*(replace(last, text=str(noun)) for noun in nouns), last)
    either = Operation("or", wanted)
    return Operation("and", (either, *excluded)) if excluded else either


def _tokens(text: str) -> list[str]:
    """Operators as they are, and texts after a mark, `=`, that tells them from operators."""
    tokens: list[str] = []
    if text.count('"') % 2:
        raise InputError(f"{text}: a double quote is not closed; {_GRAMMAR}")
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
        return InputError(f"{self.source}: {problem}; {_GRAMMAR}")

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
    for part in node.parts:
        yield from _signed(part, sign != (node.operator == "not"))


def _noun_of(node: Node) -> str:
    """Return the text that a relation after a part is about, protected; "" if there is none."""
    if isinstance(node, Operation):
        return _noun_of(node.parts[0]) if node.of_one else ""
    return protected(node if isinstance(node, str) else node.text or "thing")


def _operators(node: Node) -> list[str]:
    if not isinstance(node, Operation):
        return []
    return [node.operator, *(operator for part in node.parts for operator in _operators(part))]


def _combined(node: Node, masks: Mapping[str, Tensor]) -> Tensor:
    if not isinstance(node, Operation):
        return masks[str(node)]
    combined = [_combined(part, masks) for part in node.parts]
    if node.operator == "not":
        return ~combined[0]
    return reduce(Tensor.logical_and if node.operator == "and" else Tensor.logical_or, combined)


def _text_of(node: Node, outer: str = "") -> str:
    if isinstance(node, Phrase):
        return str(node)
    if isinstance(node, str):
        return quoted(node)
    if node.operator == "not":
        return f"not {_text_of(node.parts[0], 'not')}"
    texts = [_text_of(part, node.operator) for part in node.parts]
    if node.of_one:
        texts[1:] = [_relation_of(part) for part in node.parts[1:]]
    text = f" {node.operator} ".join(texts)
    return f"({text})" if outer not in ("", node.operator) else text


def _relation_of(node: Node) -> str:
    """Return the text of a part without the noun that it took over."""
    if isinstance(node, Operation):
        return f"not {_relation_of(node.parts[0])}"
    assert isinstance(node, Phrase)
    return str(node).removeprefix(f"{replace(node, relation='', anchors=())} ")
