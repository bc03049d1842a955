"""Every public name has an example in its docstring that says what happens."""

from __future__ import annotations

import doctest
from pathlib import Path

import pytest
import torch

import scoup
from cli.conftest import here as here
from cli.conftest import original as original
from scoup.field import Cache
from scoup.query import FieldView

ANSWERS = [
    "question", "answer", "at", "location", "things", "relations", "catalog", "frame", "select", "label",
]  # fmt: skip
NAMES = [name for name in scoup.__all__ if name != "__version__"]


def methods_of_fields() -> list[object]:
    return [*(getattr(scoup.LanguageField, name) for name in ANSWERS), FieldView, Cache]


@pytest.mark.usefixtures("few_candidates")
@pytest.mark.parametrize("name", NAMES)
def test_an_example_runs(here: Path, name: str) -> None:
    """In a folder with a scene and its field, as the examples have it."""
    field = scoup.LanguageField.load("f.scoup", words="scene/words.npz")
    given = {"scoup": scoup, "torch": torch, "field": field, "Cache": Cache}
    public = [getattr(scoup, name), *(methods_of_fields() if name == "LanguageField" else ())]
    finder = doctest.DocTestFinder(recurse=False)
    found = [each for item in public for each in finder.find(item, name, globs=given)]
    examples = [each for each in found if each.examples]
    assert len(examples) == len(public), f"the docstring of scoup.{name} has no example"
    said: list[str] = []
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
    for each in examples:
        runner.run(each, out=said.append)
    assert runner.summarize(verbose=False).failed == 0, "".join(said)


def test_what_is_no_public_name_is_an_error() -> None:
    with pytest.raises(AttributeError, match="no attribute"):
        _ = scoup.nonsense
