"""The help of every verb: options in groups, texts that fit the terminal and are whole."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator

import pytest

from cli_support import run
from scoup.cli.app import SCOUP
from scoup.cli.option_groups import attribute_texts, option_groups
from scoup.cli.parsing import Family


def verbs(family: Family = SCOUP, before: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], type]]:
    for name in family.verbs:
        verb = family.load(name)
        if isinstance(verb, Family):
            yield from verbs(verb, (*before, name))
        else:
            yield (*before, name), verb


ALL = dict(verbs())
every_verb = pytest.mark.parametrize("verb", ALL, ids=" ".join)
COMMON = ["--overwrite", "--device", "--quiet", "--json"]


def boxes(text: str) -> dict[str, list[str]]:
    """Title of each group -> the options in it."""
    parts = re.split(r"^ (\w[\w ]*?) *\n -+ *\n", text, flags=re.MULTILINE)[1:]
    return {
        title: re.findall(r"^  (--[\w-]+)", body, flags=re.MULTILINE)
        for title, body in zip(parts[::2], parts[1::2], strict=True)
    }


def help_of(verb: tuple[str, ...], monkeypatch: pytest.MonkeyPatch, columns: int = 80) -> str:
    monkeypatch.setenv("COLUMNS", str(columns))
    code, out, err = run(*verb, "--help")
    assert (code, err) == (0, "")
    return out


@every_verb
def test_every_option_is_shown_once_in_its_group(verb, monkeypatch):
    kind = ALL[verb]
    groups = option_groups(kind)
    named = [name for names in groups.values() for name in names]
    assert len(named) == len(set(named))
    assert set(named) <= {field.name for field in dataclasses.fields(kind)}
    text = help_of(verb, monkeypatch)
    shown = boxes(text)
    options = [option for group in shown.values() for option in group]
    assert "None" not in text
    assert len(options) == len(set(options))
    assert [title for title in shown if title not in ("positional arguments", "options")] == [
        f"{title} options" for title in groups
    ]
    assert list(shown)[-1] == "common options"
    assert shown["common options"] == [name for name in COMMON if name in options]


@every_verb
def test_no_box_is_a_wall(verb, monkeypatch):
    shown = boxes(help_of(verb, monkeypatch))
    assert max(len(options) for options in shown.values()) <= 8


@every_verb
def test_every_option_says_what_it_is(verb):
    texts = attribute_texts(ALL[verb])
    assert {field.name for field in dataclasses.fields(ALL[verb])} <= set(texts)
    assert all(text.endswith(".") for text in texts.values())


@every_verb
@pytest.mark.parametrize("columns", [80, 120])
def test_lines_fit_the_terminal(verb, columns, monkeypatch):
    assert all(len(line) <= columns for line in help_of(verb, monkeypatch, columns).splitlines())


def test_a_list_of_verbs_gives_a_sentence_each(monkeypatch):
    out = help_of((), monkeypatch)
    assert "Needs no network" not in out
    out = help_of(("eval",), monkeypatch)
    assert re.findall(r"^ +• (\S+)", out, flags=re.MULTILINE) == [
        verb[1] for verb in ALL if verb[0] == "eval"
    ]
