"""Tables, JSON and what is said of the machine."""

from __future__ import annotations

import json
import socket
from pathlib import Path

import pytest

from scoup.base import OutputExistsError
from scoup_lab.bench.environment import describe_environment, in_one_line
from scoup_lab.bench.measure import Timing
from scoup_lab.bench.report import markdown, milliseconds, write_json


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
    write_json(path, Timing((2.0, 1.0)).to_dict())
    assert json.loads(path.read_text()) == {"median_s": 1.5, "min_s": 1.0, "max_s": 2.0, "repeats": 2}
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
