"""Expressions over texts, such as "mug and not handle"."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import TypeAlias

from torch import Tensor

from scoup.base.errors import InputError

OPERATORS = ("and", "or", "not", "+", "-", "(", ")")
_TOKEN = re.compile(r'"([^"]*)"|([()])|([^\s()"]+)')
_GRAMMAR = 'write texts joined by and, or, not, + and -, for example "mug and not handle"'
_DEEPEST = 50  # operators within operators


@dataclass(frozen=True)
class Operation:
    """ "not" of one part, or "and" or "or" of two or more."""

    operator: str
    parts: tuple[Node, ...]


Node: TypeAlias = "str | Operation"
"""A text or an operation."""


@dataclass(frozen=True)
class Expression:
    """Texts joined by operators."""

    root: Node

    @classmethod
    def of(cls, texts: Sequence[str]) -> Expression:
        """Combine texts with `or`."""
        return cls(texts[0] if len(texts) == 1 else Operation("or", tuple(texts)))

    @property
    def texts(self) -> tuple[str, ...]:
        """The texts in their order, each once."""
        return tuple(dict.fromkeys(_texts(self.root)))

    @property
    def wanted(self) -> tuple[str, ...]:
        """The texts under an even number of "not"; all if there are none."""
        return tuple(dict.fromkeys(_wanted(self.root, True))) or self.texts

    @property
    def is_plain(self) -> bool:
        """Whether its only operator is "or"."""
        return all(operator == "or" for operator in _operators(self.root))

    def __str__(self) -> str:
        return _said(self.root)

    def combine(self, masks: Mapping[str, Tensor]) -> Tensor:
        """Combine boolean masks of its texts, of one shape."""
        return _combined(self.root, masks)


def parse_expression(words: Iterable[str]) -> Expression:
    """Parse the words of a command line.

    ``not`` binds closest, then ``and``, then ``or``, ``+`` (the same) and ``-`` (and not), which are operators only
    between spaces; brackets group. A text may have several words. Double quotes make one text of operators, as in
    ``'"salt and pepper"'``. Texts without an operator are combined with ``or``.

    Args:
        words: texts, operators, or expressions.

    Raises:
        InputError: it is not an expression.

    Example:
        >>> scoup.parse_expression(["mug and not handle", "plate"]).texts
        ('mug', 'handle', 'plate')
    """
    given = list(words)
    tokens: list[str] = []
    for word in given:
        part = [word.lower()] if word.lower() in OPERATORS else ["(", *_tokens(word), ")"]
        if tokens and tokens[-1] == ")" and part[0] == "(":
            tokens.append("or")
        tokens += part
    reader = _Reader(tokens, " ".join(given))
    root = reader.union()
    if reader.rest:
        raise reader.refusal(f"{reader.rest[0]!r} is not expected")
    return Expression(root)


def _tokens(text: str) -> list[str]:
    """Operators as they are, and texts after a mark, `=` or a double quote, that tells them from operators."""
    tokens: list[str] = []
    quotes = text.count('"')
    if quotes % 2:
        raise InputError(f"{text}: a double quote is not closed; {_GRAMMAR}")
    for quoted, bracket, word in _TOKEN.findall(text):
        if bracket or word.lower() in OPERATORS:
            tokens.append(bracket or word.lower())
        elif word and tokens and tokens[-1].startswith("="):
            tokens[-1] += f" {word}"
        elif word or quoted.strip():
            tokens.append(f"={word}" if word else f'"{quoted.strip()}')
    return tokens


class _Reader:
    """A parser by recursive descent, which takes tokens from the left."""

    def __init__(self, tokens: list[str], source: str) -> None:
        self.rest, self.source, self.depth = tokens, source, 0

    def refusal(self, problem: str) -> InputError:
        return InputError(f"{self.source}: {problem}; {_GRAMMAR}")

    def union(self) -> Node:
        left, before = self.intersection(), self.depth
        while self.rest and self.rest[0] in ("or", "+", "-"):
            operator = self.rest.pop(0)
            right = self.intersection()
            if operator == "-":
                left = self.combine("and", left, Operation("not", (right,)))
            else:
                left = self.combine("or", left, right)
        self.depth = before
        return left

    def intersection(self) -> Node:
        left = self.factor()
        while self.rest and self.rest[0] == "and":
            self.rest.pop(0)
            left = self.combine("and", left, self.factor())
        return left

    def combine(self, operator: str, left: Node, right: Node) -> Node:
        if isinstance(left, Operation) and left.operator == operator:
            return Operation(operator, (*left.parts, right))
        self.deeper()
        return Operation(operator, (left, right))

    def deeper(self) -> None:
        self.depth += 1
        if self.depth > _DEEPEST:
            raise self.refusal("operators are nested too deeply")

    def factor(self) -> Node:
        if not self.rest:
            raise self.refusal("a text is missing at the end")
        token = self.rest.pop(0)
        if token[0] in '="':
            return token[1:]
        if token not in ("not", "("):
            raise self.refusal(f"a text is missing before {token!r}")
        before = self.depth
        self.deeper()
        inner: Node = Operation("not", (self.factor(),)) if token == "not" else self.union()
        if token == "(" and (not self.rest or self.rest.pop(0) != ")"):
            raise self.refusal("a bracket is not closed")
        self.depth = before
        return inner


def _texts(node: Node) -> list[str]:
    return [node] if isinstance(node, str) else [text for part in node.parts for text in _texts(part)]


def _operators(node: Node) -> list[str]:
    if isinstance(node, str):
        return []
    return [node.operator, *(operator for part in node.parts for operator in _operators(part))]


def _wanted(node: Node, positive: bool) -> list[str]:
    if isinstance(node, str):
        return [node] if positive else []
    positive = positive != (node.operator == "not")
    return [text for part in node.parts for text in _wanted(part, positive)]


def _combined(node: Node, masks: Mapping[str, Tensor]) -> Tensor:
    if isinstance(node, str):
        return masks[node]
    found = [_combined(part, masks) for part in node.parts]
    if node.operator == "not":
        return ~found[0]
    return reduce(Tensor.logical_and if node.operator == "and" else Tensor.logical_or, found)


def _said(node: Node, outer: str = "") -> str:
    if isinstance(node, str):
        return node if parses_as_text(node) else f'"{node}"'
    if node.operator == "not":
        return f"not {_said(node.parts[0], 'not')}"
    said = f" {node.operator} ".join(_said(part, node.operator) for part in node.parts)
    return f"({said})" if outer not in ("", node.operator) else said


def parses_as_text(text: str) -> bool:
    """Return whether a text is read as itself without double quotes."""
    return _tokens(text) == [f"={text}"] if '"' not in text else False
