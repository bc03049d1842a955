"""Expressions over texts, against Python's own operators on sets; the grammar of phrases, and what they say of
themselves."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from messages import refuses
from scoup.query.expression import Expression, Node, Operation, parse_expression
from scoup.query.phrases import ORDINALS, RELATIONS, SIDES, SIZES, Phrase, parse_phrase

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
    (["mug", "cup"], "mug or cup", ("mug", "cup"), ("mug", "cup")),
    (["mug and not handle"], "mug and not handle", ("mug", "handle"), ("mug",)),
    (["mug", "and", "not", "handle"], "mug and not handle", ("mug", "handle"), ("mug",)),
    ("mug and not handle", "mug and not handle", ("mug", "handle"), ("mug",)),
    (["mug + cup - handle"], "(mug or cup) and not handle", ("mug", "cup", "handle"), ("mug", "cup")),
    (["mug or cup and handle"], "mug or (cup and handle)", ("mug", "cup", "handle"), ("mug", "cup", "handle")),
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
    assert found.is_plain == (said in ("kettle", "mug or cup", "t-shirt or sand", "mug or mug"))


NO_EXPRESSIONS = (
    [""], ["mug and"], ["and mug"], ["mug", "+"], ["not"], ["(mug"], ["mug)"], ['"mug'], ["mug not cup"], ["()"],
    ["mug", "and", "or", "cup"], ["not " * 60 + "mug"], ["(" * 60 + "mug" + ")" * 60], [" + a - b" * 60], [],
    ['mug between "a cup"'],
)  # fmt: skip


def test_what_is_no_expression_is_refused_but_thousands_of_texts_are_one() -> None:
    for words in NO_EXPRESSIONS:
        with refuses():
            parse_expression(words)
    texts = [f"thing {number}" for number in range(3000)]
    assert parse_expression(texts).texts == tuple(texts)
    assert len(parse_expression([" and not ".join(texts)]).texts) == 3000  # which are no depth


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


def truth(expression: Expression, leaves: Sequence[str]) -> torch.Tensor:
    """An expression of all combinations of its leaves, each there or not."""
    rows = torch.tensor(list(product([False, True], repeat=len(leaves))))
    masks = dict(zip(leaves, rows.T, strict=True))

    def value(node: Node) -> torch.Tensor:
        if not isinstance(node, Operation):
            return masks[str(node)]
        parts = torch.stack([value(part) for part in node.parts])
        return (
            ~parts[0] if node.operator == "not" else parts.all(0) if node.operator == "and" else parts.any(0)
        )

    return value(expression.root)


@given(nodes)
def test_combined_masks_equal_truth_tables(node) -> None:
    found: Expression = parse_expression([written(node)])
    rows = product([False, True], repeat=len(NAMES))
    expected = [literal(node, dict(zip(NAMES, row, strict=True))) for row in rows]
    for each in (found, parse_expression([str(found)])):
        assert truth(each, NAMES).tolist() == expected


FORMS = [(form, relation) for relation, forms in RELATIONS.items() for form in forms]


@pytest.mark.parametrize(("form", "relation"), FORMS)
def test_every_form_of_a_relation_is_read(form, relation) -> None:
    anchors = ("red box", "lamp") if relation == "between" else ("red box",)
    expected = Phrase("coffee mug", relation, anchors)
    others = " and the ".join(anchors)
    for text in (f"coffee mug {form} {' and '.join(anchors)}", f"The coffee mug {form.upper()} the {others}"):
        assert parse_phrase(text) == expected


@pytest.mark.parametrize(("text", "expected"), [
    ("largest box", Phrase("box", order="largest")),
    ("the biggest box", Phrase("box", order="largest")),
    ("a second smallest box", Phrase("box", order="smallest", rank=2)),
    ("third box from the left", Phrase("box", order="left", rank=3)),
    ("12th box from the back", Phrase("box", order="back", rank=12)),
    ("2nd mug from the right on the desk", Phrase("mug", "on", ("desk",), "right", 2)),
    ("mug on largest box", Phrase("mug", "on", (Phrase("box", order="largest"),))),
    ("p left of q behind r", Phrase("p", "left of", (Phrase("q", "behind", ("r",)),))),
    ("x between p on q and r", Phrase("x", "between", (Phrase("p", "on", ("q",)), "r"))),
    ("x between p and y between q and r", Phrase("x", "between", ("p", Phrase("y", "between", ("q", "r"))))),
])  # fmt: skip
def test_orders_and_nested_phrases_are_read(text, expected) -> None:
    assert parse_phrase(text) == expected
    assert parse_expression([text]).root == expected


@pytest.mark.parametrize("text", ["mug", "the mug", "first aid kit", "on switch", "left shoe"])
def test_names_of_things_are_texts(text) -> None:
    assert parse_phrase(text) == text


NO_PHRASES = (
    "mug across the desk", "mug on", "the on desk", "largest", "left of", "left of mug", "in front of mug on desk",
    "mug on left of", "behind", "mug between a", "third mug", "third mug from the door", " on ".join("abcdefghijk"),
)  # fmt: skip


def test_what_is_not_a_phrase_is_refused() -> None:
    for text in NO_PHRASES:
        with refuses():
            parse_phrase(text)


@pytest.mark.parametrize(("words", "texts"), [
    (['"salt on pepper"'], ["salt on pepper"]),
    (['"salt on pepper" or cup'], ["salt on pepper", "cup"]),
    (['mug between "p and q" and "not"'], ["mug", "p and q", "not"]),
    (["mug Between p and q and not cup"], ["mug", "p", "q", "cup"]),
    (["mug between p and q", "cup"], ["mug", "p", "q", "cup"]),
    (["(mug between p and q) or c and d"], ["mug", "p", "q", "c", "d"]),
    (['mug and "near p"'], ["mug", "near p"]),
    (['"mug." between p, and q'], ["mug.", "p", "q"]),
])  # fmt: skip
def test_phrases_within_expressions(words, texts) -> None:
    found = parse_expression(words)
    assert found.texts == tuple(texts)
    assert len(found.phrases) == ("between" in words[0].lower())
    assert parse_expression([str(found)]) == found


@pytest.mark.parametrize(("text", "said"), [
    ("mug near p and near q", "mug near p and mug near q"),
    ("what is on p and near q", "what is on p and what is near q"),
    ("mug near p or near q and not near r", "mug near p or (mug near q and not mug near r)"),
    ("mug near p or cup near q - near r", "(mug near p or cup near q) and not cup near r"),
    ("mug and not near p and between p and q", "mug and not mug near p and mug between p and q"),
])  # fmt: skip
def test_operators_join_relations_of_a_thing(text: str, said: str) -> None:
    found = parse_expression(text)
    assert parse_expression(str(found)) == found
    leaves = [str(leaf) for leaf in found.leaves()]
    assert truth(found, leaves).equal(truth(parse_expression(said), leaves))


words = st.sampled_from(["red", "coffee mug", "box", "t-shirt"])
texts = st.lists(words, min_size=1, max_size=3).map(" ".join)
ranks = st.integers(1, len(ORDINALS) + 5)
orders = st.one_of(st.just(("", 1)), st.tuples(st.sampled_from([*SIDES, *SIZES.values()]), ranks))


@st.composite
def phrases(draw: st.DrawFn, depth: int = 2, between: bool = True) -> str | Phrase:
    """Phrases that text can say: what follows "between" up to "and" has no "between" in it."""
    order, rank = draw(orders)
    relations = [name for name in RELATIONS if between or name != "between"]
    relation = draw(st.sampled_from(["", *relations])) if depth else ""
    inner: tuple[str | Phrase, ...] = ()
    if relation == "between":
        inner = (draw(phrases(depth - 1, False)), draw(phrases(depth - 1)))
    elif relation:
        inner = (draw(phrases(depth - 1, between)),)
    text = draw(st.one_of(texts, st.sampled_from(["tea in a glass", "the not", *[""] * bool(relation)])))
    return Phrase(text, relation, inner, order, rank) if order or relation else text


@given(phrases())
def test_what_a_phrase_says_of_itself_is_that_phrase(phrase) -> None:
    assert parse_expression([str(Expression(phrase))]).root == phrase
