"""The help of every verb: options in groups, texts that fit the terminal and are whole; and what it imports."""

from __future__ import annotations

import ast
import dataclasses
import functools
import json
import re
import sys
from collections.abc import Iterator

import pytest

from children import finished
from cli_support import printed, run_json
from messages import SNAPSHOT
from scoup.cli.app import SCOUP
from scoup.cli.family import Family
from scoup.cli.parsing import field_texts
from test_layout import PRODUCT, nodes, sources


def verbs(family: Family = SCOUP, before: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], type]]:
    for name in family.verbs:
        verb = family.load(name)
        if isinstance(verb, Family):
            yield from verbs(verb, (*before, name))
        else:
            yield (*before, name), verb


ALL = dict(verbs())
every_verb = pytest.mark.parametrize("verb", ALL, ids=" ".join)


def boxes(text: str) -> dict[str, list[str]]:
    """Title of each group -> the options in it."""
    parts = re.split(r"^ (\w[\w ]*?) *\n -+ *\n", text, flags=re.MULTILINE)[1:]
    return {
        title: re.findall(r"^  (--[\w-]+)", body, flags=re.MULTILINE)
        for title, body in zip(parts[::2], parts[1::2], strict=True)
    }


@functools.cache
def help_of(*verb: str, columns: int = 80) -> str:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("COLUMNS", str(columns))
        return printed(*verb, "--help")


def fields_of(kind: type) -> Iterator[tuple[type, str]]:
    """The fields of a verb and of the groups in it, each with its class."""
    for field in dataclasses.fields(kind):
        if dataclasses.is_dataclass(field.default):
            yield from fields_of(type(field.default))
        else:
            yield kind, field.name


@every_verb
def test_options_are_explained_and_shown_once_in_groups_that_fit_the_terminal(verb):
    text = help_of(*verb)
    assert "None" not in text
    assert [name for kind, name in fields_of(ALL[verb]) if not field_texts(kind).get(name)] == []
    shown = boxes(text)
    options = [option for group in shown.values() for option in group]
    every = re.findall(r"^  (?:-h, )?--[a-z]", text, re.MULTILINE)
    assert len(options) == len(set(options)) == len(every) - 1  # the help itself is in no group
    assert list(shown)[-1] == "common options"
    wide = help_of(*verb, columns=120)
    assert max(map(len, text.splitlines())) <= 80
    assert max(map(len, wide.splitlines())) <= 120


# torch takes a second to start, scipy half of one
HEAVY = ("torch", "scipy", "PIL", "transformers", "triton", "jinja2")
IMPORTED = f"""
import sys
import scoup.base.native
assert not [name for name in (*{HEAVY}, "numpy", "scoup._native") if name in sys.modules]
from scoup.cli.app import run
for command in sys.argv[1:]:
    assert run(command.split()) == 0
    print(command, [name for name in {HEAVY} if name in sys.modules], file=sys.stderr)
"""


@pytest.mark.usefixtures("here")
def test_help_facts_and_lists_need_nothing_heavy() -> None:
    run_json("archive", "scans", "--add", "f.scoup")
    commands = ("--help", "--version", "info --help", "info f.scoup", "archive scans --list")
    done = finished([sys.executable, "-c", IMPORTED, *commands], check=True)
    assert done.stderr.splitlines() == [f"{command} []" for command in commands]


FOREIGN = re.compile(
    r"\x1b|can still be loaded|weights_only|Weights only|from_pretrained|Traceback|while online"
)
# Of hf download, ray start, pip, xcode-select, LangSplat's training and our benchmarks, which messages name.
OF_OTHERS = {
    *("--local-dir", "--head", "--force-reinstall", "--no-deps", "--no-cache-dir", "--install"),
    *("--include_feature", "--rows"),
}


def arguments() -> set[str]:
    """Names of the parameters and fields of the product."""
    found = [node for source in sources(PRODUCT).values() for node in nodes(source)]
    fields = [node.target for node in found if isinstance(node, ast.AnnAssign)]
    names = {field.id for field in fields if isinstance(field, ast.Name)}
    return names | {node.arg for node in found if isinstance(node, ast.arg)}


def test_messages_have_no_words_of_other_libraries() -> None:
    """Names in back-quotes, which verbs turn to options, are arguments of scoup, and options are those of its verbs."""
    texts = [text for each in json.loads(SNAPSHOT.read_text()).values() for text in each]
    assert [text for text in texts if FOREIGN.search(text)] == []
    quoted = {name for text in texts for name in re.findall(r"`([a-z_]+)(?:=[^`]+)?`", text)}
    assert quoted - arguments() == set()
    options = {option for verb in ALL for group in boxes(help_of(*verb)).values() for option in group}
    named = {name for text in texts for name in re.findall(r"(?<![\w-])--[a-z][\w-]*", text)}
    assert {name for name in named - OF_OTHERS if not {name, name.replace("--no-", "--")} & options} == set()
