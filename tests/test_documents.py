"""The documents say what the records say: tables made from them are up to date, and other figures are found in them."""

from __future__ import annotations

import json
import re
import shlex
from bisect import bisect_left
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from benchmarks import documents
from benchmarks.__main__ import STUDIES

from scoup.cli.parsing import parse

MEASURED = [
    path
    for path in documents.DOCUMENTS
    if path.stem in ("README", "answers", "benchmarks", "evaluation", "claims")
]
NUMBER = re.compile(r"(?<![\w.,/-])[-+~]?(\d{1,3}(?:,\d{3})+|\d+)(\.\d+)?(?![\w/.]*\d)")
FINISHED = re.compile(r"<!-- measured at [0-9a-f]{8} -->\n.*?<!-- end of table -->", re.DOTALL)
SCALES = (1.0, 100.0, 1000.0, 1e-3, 1e-6, 1e-9)
"""As stored; percent; milliseconds; kilo, mega and giga."""


LONG = 60
"""Entries of a list of single scores."""


def sections(path: Path) -> Iterator[tuple[str, str]]:
    """Heading and text of each section of a document, without code."""
    text = re.sub(
        r"```.*?```",
        lambda block: "".join(re.findall(r"\S+\.json", block[0])),
        path.read_text(),
        flags=re.DOTALL,
    )
    parts = re.split(r"^(#+ .*)$", text, flags=re.MULTILINE)
    yield from zip(["", *parts[1::2]], parts[::2], strict=True)


def records_of(text: str) -> list[str]:
    """Names of the records that a section names."""
    names = sorted(set(re.findall(r"benchmarks/([\w-]+)\.json", text)))
    return [name for name in names if (documents.RECORDS / f"{name}.json").is_file()]


def numbers_in(value: Any) -> Iterator[float]:
    """Every number of a record, those in its strings and keys included, but not the long lists of single scores, among
    which any number is found."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from numbers_in(key)
            yield from numbers_in(inner)
    elif isinstance(value, list) and (len(value) <= LONG or isinstance(value[0], dict)):
        for inner in value:
            yield from numbers_in(inner)
    elif isinstance(value, str):
        yield from (float(found[0].replace(",", "")) for found in re.findall(r"(\d[\d,]*\.?\d*)()", value))
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield float(value)


def figures(text: str) -> list[str]:
    """Numbers with decimals of a text, and all of three digits or more in tables; tables made from records, paragraphs
    and tables of finished studies, which name their commit, links and inline code are left out."""
    text = FINISHED.sub("", documents.BLOCK.sub("", text))
    text = "\n\n".join(part for part in text.split("\n\n") if not re.search(r"commit [0-9a-f]{8}\b", part))
    text = re.sub(r"\]\(.*?\)|`[^`]*`|https?://\S+", "", text)
    found = []
    for line in text.splitlines():
        for whole, decimals in NUMBER.findall(line):
            if decimals or (line.startswith("|") and len(whole) > 2):
                found.append(whole.replace(",", "") + decimals)
    return found


def is_in(figure: str, known: list[float]) -> bool:
    """Whether a number rounds to a figure, as it is stored or by one of ``SCALES``; signs do not count."""
    decimals = len(figure.partition(".")[2])
    for scale in SCALES:
        wanted, tolerance = float(figure) / scale, 0.5000001 * 10**-decimals / scale
        place = bisect_left(known, wanted - tolerance)
        if place < len(known) and known[place] <= wanted + tolerance:
            return True
    return False


def test_every_table_stands_once() -> None:
    named = [name for path in documents.DOCUMENTS for _, name, _ in documents.BLOCK.findall(path.read_text())]
    assert sorted(named) == sorted(documents.TABLES)


@pytest.mark.parametrize("name", documents.HIDDEN)
def test_what_is_hidden_is_in_the_table(name: str) -> None:
    cells = {cell.strip() for cell in documents.TABLES[name]().replace("\n", "|").split("|")}
    for hidden in re.split(r"\|(?![^(]*\))", documents.HIDDEN[name]):
        assert any(re.fullmatch(hidden, cell) for cell in cells), hidden


def test_tables_are_up_to_date() -> None:
    assert documents.main(documents.Arguments(check=True)) == []


@pytest.mark.parametrize("path", MEASURED, ids=lambda path: path.stem)
def test_figures_are_in_the_records_that_their_section_names(path: Path) -> None:
    constants = json.loads((Path(__file__).parent / "constants_in_documents.json").read_text())[path.name]
    lost = {}
    for heading, text in sections(path):
        known = sorted(
            abs(number) for name in records_of(text) for number in numbers_in(documents.record(name))
        )
        missing = [
            each
            for each in figures(text)
            if not is_in(each, known) and each not in constants.get(heading, [])
        ]
        if missing:
            lost[heading] = (records_of(text), missing)
    assert not lost


def test_records_are_of_clean_commits() -> None:
    for path in sorted(documents.RECORDS.glob("*.json")):
        text = path.read_text()
        assert "with changes" not in text, path.name
        assert re.search(r'"commit": ?"[0-9a-f]{12}"', text), path.name


def test_every_record_is_named_by_a_document() -> None:
    said = {name for path in documents.DOCUMENTS for name in records_of(path.read_text())}
    said |= {name for path in MEASURED for name in re.findall(r"([\w-]+)\.json", path.read_text())}
    assert {path.stem for path in documents.RECORDS.glob("*.json")} <= said


def test_a_figure_that_is_not_in_a_record_is_found() -> None:
    known = sorted([0.8164, 12.0, 1030.0])
    assert figures("| `0.5` | 0.816 | +81.6 [1,030, x] |\n0.82 and 12 [a](b-0.3.md)") == [
        "0.816",
        "81.6",
        "1030",
        "0.82",
    ]
    assert [is_in(each, known) for each in ("0.816", "81.6", "0.82", "1030", "1.03")] == [True] * 5
    assert figures("A table at commit 098624a6: 0.5\n\n0.7") == ["0.7"]
    assert figures("<!-- measured at 098624a6 -->\n| 0.5 |\n<!-- end of table -->\n0.7") == ["0.7"]
    assert not any(is_in(each, known) for each in ("0.817", "0.815", "81.7", "0.9", "13.0"))


def commands() -> list[str]:
    """All commands of the documents that run the benchmarks."""
    texts = [path.read_text() for path in (*documents.DOCUMENTS, documents.ROOT / "CONTRIBUTING.md")]
    lines = "\n".join(texts).replace("\\\n", "")
    return sorted(set(re.findall(r"python -m (benchmarks[^`\n]*)", lines)))


@pytest.mark.parametrize("command", commands())
def test_commands_of_the_benchmarks_exist(command: str) -> None:
    module, *words = shlex.split(command, comments=True)
    place = documents.ROOT.joinpath(*module.split("."))
    assert place.with_suffix(".py").is_file() or (place / "__main__.py").is_file()
    if module == "benchmarks" and words and words[0] != "NAME":
        parse(words, STUDIES, "python -m benchmarks")


@pytest.mark.parametrize("path", documents.DOCUMENTS, ids=lambda path: path.stem)
def test_no_command_of_a_block_needs_the_place_of_an_earlier_output(path: Path) -> None:
    for block in re.findall(r"^```\n(.*?)^```$", path.read_text(), re.MULTILINE | re.DOTALL):
        places = []
        for line in re.findall(r"^scoup (?:query|select|label|catalog|render) .*", block, re.MULTILINE):
            words = shlex.split(line, comments=True)
            place = words[words.index("--out") + 1 :][:1] if "--out" in words else words[1:3]
            assert "--overwrite" in words or place not in places, line
            places.append(place)
