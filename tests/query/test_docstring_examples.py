"""The examples in the docstrings of what is public about questions and answers."""

from __future__ import annotations

import doctest
from types import ModuleType

import pytest

import scoup
from query.conftest import Queried, random_vectors
from scoup.models.words import CANONICAL_PHRASES
from scoup.query import expression, methods, question

WORDS = (*CANONICAL_PHRASES, *(f"word {number}" for number in range(20)))


@pytest.mark.parametrize("module", [expression, methods, question], ids=lambda module: module.__name__)
def test_examples_say_what_happens(queried: Queried, module: ModuleType) -> None:
    field = queried.field
    field.text_encoder(dict(zip(WORDS, random_vectors(len(WORDS), 16, seed=5), strict=True)))
    found = [
        each
        for each in doctest.DocTestFinder().find(module, extraglobs={"field": field, "scoup": scoup})
        if each.examples
    ]
    assert found
    runner = doctest.DocTestRunner()
    for each in found:
        runner.run(each)
    assert runner.summarize(verbose=False).failed == 0
