"""Tables, JSON and what is said of the machine."""

from __future__ import annotations

import json
import socket
from pathlib import Path

import pytest

from scoup.base.errors import OutputExistsError
from scoup_lab.bench.environment import describe_environment, in_one_line
from scoup_lab.bench.measure import Timing
from scoup_lab.bench.report import Row, comparison, markdown, milliseconds, ratios, stage_table, write_json


def row(stage: str, backend: str, threads: int, *milliseconds: float, count: int = 1000) -> Row:
    return Row(count, stage, backend, threads, Timing(tuple(1e-3 * value for value in milliseconds)))


def test_a_table_of_stages():
    rows = [
        row("project", "native", 1, 2, 2, 3),
        row("project", "reference", 1, 500, 400, 300),
        row("vote", "native", 1, 0.5, 0.5, 0.5, count=2000),
    ]
    lines = [[cell.strip() for cell in line.split("|")[1:-1]] for line in stage_table(rows).splitlines()]
    assert lines[0] == ["Gaussians", "stage", "backend", "threads", "ms", "time over reference"]
    assert lines[2:] == [
        ["1,000", "project", "native", "1", "2", "0.005"],
        ["1,000", "project", "reference", "1", "400", "-"],
        ["2,000", "vote", "native", "1", "0.5", "-"],
    ]


def test_ratios_are_of_the_same_scene_stage_and_threads():
    rows = [row("project", "native", 1, 2), row("project", "native", 2, 2), row("vote", "native", 1, 2)]
    rows += [row("project", "reference", 1, 8)]
    assert ratios(rows) == {rows[0]: 0.25}
    found = comparison(rows)
    assert found["rows"] == [item.to_dict() for item in rows]
    at = {"gaussians": 1000, "stage": "project", "backend": "native", "threads": 1}
    assert found["ratios"] == [{**at, "time_over_reference": 0.25}]


def test_markdown_is_aligned():
    rows = ["| a      |  bb |", "| ------ | --: |", "| 1      |   2 |", "| 333333 |   4 |"]
    assert markdown(["a", "bb"], [["1", "2"], ["333333", "4"]]).splitlines() == rows


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(12.3456, "12,346"), (0.123456, "123"), (0.0123456, "12.3"), (0.00123456, "1.23"), (1.2e-5, "0.012")],
)
def test_milliseconds(seconds, text):
    assert milliseconds(seconds) == text


def test_json_is_written_once(tmp_path: Path):
    path = tmp_path / "new" / "a.json"
    write_json(path, {"rows": [row("project", "native", 1, 2).to_dict()]})
    assert set(json.loads(path.read_text())["rows"][0]) == {
        "gaussians", "stage", "backend", "threads", "median_s", "min_s", "max_s", "repeats",
    }  # fmt: skip
    with pytest.raises(OutputExistsError):
        write_json(path, {})
    write_json(path, {}, overwrite=True)
    assert json.loads(path.read_text()) == {}
    with pytest.raises(ValueError, match="JSON"):
        write_json(tmp_path / "b.json", {"a": float("nan")})
    assert [item.name for item in tmp_path.iterdir()] == ["new"]


def test_the_machine_is_described_without_naming_it():
    environment = describe_environment()
    text = json.dumps(environment)
    for private in (str(Path.home()), str(Path(__file__).resolve().parents[2]), socket.gethostname()):
        assert private not in text
    assert environment["cores"] >= 1
    assert environment["cpu"]
    assert environment["torch"] in in_one_line(environment)
    assert "None" not in in_one_line(environment)
