"""Expressions over texts, against Python's own operators on sets."""

from __future__ import annotations

from itertools import product

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from messages import refuses
from scoup.query.expression import Expression, parse_expression

NAMES = ("mug", "wooden table", "cup")


@pytest.mark.parametrize(("words", "texts"), [
    ("Power plugs and sockets", ("Power plugs and sockets",)),
    (["power plugs and sockets", "mug"], ("power plugs and sockets", "mug")),
    ("power plugs and mug", ("power plugs", "mug")),
    ("the Power  plugs and sockets on the desk", ("Power plugs and sockets", "desk")),
    ("power plugs and sockets, left of the mug", ("power plugs and sockets", "mug")),
    ("mug with power plugs and sockets", ("mug with power plugs and sockets",)),
    ('mug and "plugs" and (power plugs and sockets)', ("mug", "plugs", "power plugs and sockets")),
])  # fmt: skip
def test_names_of_a_table_are_taken_whole(words: str | list[str], texts: tuple[str, ...]) -> None:
    assert parse_expression(words, ["mug", "power plugs and sockets"]).texts == texts


@pytest.mark.parametrize(("words", "said", "texts", "wanted"), [
    (["kettle"], "kettle", ("kettle",), ("kettle",)),
    (["wooden table"], "wooden table", ("wooden table",), ("wooden table",)),
    (["mug", "cup"], "mug or cup", ("mug", "cup"), ("mug", "cup")),
    (["mug and not handle"], "mug and not handle", ("mug", "handle"), ("mug",)),
    (["mug", "and", "not", "handle"], "mug and not handle", ("mug", "handle"), ("mug",)),
    ("mug and not handle", "mug and not handle", ("mug", "handle"), ("mug",)),
    (["mug", "+", "cup", "-", "handle"], "(mug or cup) and not handle", ("mug", "cup", "handle"), ("mug", "cup")),
    (["mug + cup - handle"], "(mug or cup) and not handle", ("mug", "cup", "handle"), ("mug", "cup")),
    (["mug or cup and handle"], "mug or (cup and handle)", ("mug", "cup", "handle"), ("mug", "cup", "handle")),
    (["(mug or cup) and red"], "(mug or cup) and red", ("mug", "cup", "red"), ("mug", "cup", "red")),
    (["not mug"], "not mug", ("mug",), ("mug",)),
    (["not not mug"], "not not mug", ("mug",), ("mug",)),
    (["not (mug or not cup)"], "not (mug or not cup)", ("mug", "cup"), ("cup",)),
    (['"a and b" and not lid'], '"a and b" and not lid', ("a and b", "lid"), ("a and b",)),
    (["t-shirt", "sand"], "t-shirt or sand", ("t-shirt", "sand"), ("t-shirt", "sand")),
    (["mug AND cup"], "mug and cup", ("mug", "cup"), ("mug", "cup")),
    (["mug", "mug"], "mug or mug", ("mug",), ("mug",)),
    (["mug or cup", "and", "red"], "(mug or cup) and red", ("mug", "cup", "red"), ("mug", "cup", "red")),
])  # fmt: skip
def test_expressions_are_read(words, said, texts, wanted) -> None:
    found = parse_expression(words)
    assert (str(found), found.texts, found.wanted) == (said, texts, wanted)
    assert found.is_plain == (
        said in ("kettle", "wooden table", "mug or cup", "t-shirt or sand", "mug or mug")
    )


NO_EXPRESSIONS = (
    [""], ["mug and"], ["and mug"], ["mug", "+"], ["not"], ["(mug"], ["mug)"], ['"mug'], ["mug not cup"], ["()"],
    ["mug", "and", "or", "cup"], ["not " * 60 + "mug"], ["(" * 60 + "mug" + ")" * 60], [" + a - b" * 60], [],
)  # fmt: skip


def test_what_is_no_expression_is_refused_in_one_sentence() -> None:
    for words in NO_EXPRESSIONS:
        with refuses() as error:
            parse_expression(words)
        assert "\n" not in str(error.value)


def test_thousands_of_texts_are_no_depth() -> None:
    texts = [f"thing {number}" for number in range(3000)]
    assert parse_expression(texts).texts == tuple(texts)
    assert len(parse_expression([" and not ".join(texts)]).texts) == 3000


nodes = st.recursive(
    st.sampled_from(NAMES),
    lambda inner: st.one_of(
        inner.map(lambda one: ("not", one)),
        st.tuples(st.sampled_from(["and", "or", "-"]), inner, inner),
    ),
    max_leaves=8,
)


def written(node) -> str:
    if isinstance(node, str):
        return node
    if node[0] == "not":
        return f"not ({written(node[1])})"
    return f"({written(node[1])}) {node[0]} ({written(node[2])})"


def literal(node, inside) -> bool:
    if isinstance(node, str):
        return inside[node]
    if node[0] == "not":
        return not literal(node[1], inside)
    first, second = literal(node[1], inside), literal(node[2], inside)
    return {"and": first and second, "or": first or second, "-": first and not second}[node[0]]


def joined(operator: str, one: torch.Tensor, other: torch.Tensor) -> torch.Tensor:
    return one & other if operator == "and" else one | other


@given(nodes)
def test_combined_masks_equal_truth_tables(node) -> None:
    rows = list(product([False, True], repeat=3))
    masks = {name: torch.tensor([row[column] for row in rows]) for column, name in enumerate(NAMES)}

    def folded(expression: Expression) -> list[bool]:
        return expression.fold(lambda leaf: masks[str(leaf)], torch.logical_not, joined).tolist()

    found: Expression = parse_expression([written(node)])
    expected = [literal(node, dict(zip(NAMES, row, strict=True))) for row in rows]
    assert folded(found) == expected
    assert folded(parse_expression([str(found)])) == expected
