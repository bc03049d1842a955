"""The runner of the studies: what it keeps, writes, refuses and returns."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from benchmarks import __main__ as program
from benchmarks.study import Record, Study, run

from messages import refuses
from scoup.base import OutputExistsError
from scoup.cli import Family


@dataclass(frozen=True, kw_only=True)
class Squares(Study):
    """Square some numbers."""

    numbers: tuple[int, ...] = (2, 3)
    """To be squared."""
    folder: Path = Path("/somewhere/of/this/machine")
    """Not part of the settings."""

    def measure(self, known: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        for number in self.numbers:
            if str(number) not in known:
                yield str(number), number**2
            if number < 0:
                raise KeyboardInterrupt

    @staticmethod
    def table(record: Record) -> str:
        return f"| {record['rows']} |"

    @staticmethod
    def failed(record: Record) -> bool:
        return 49 in record["rows"].values()


def test_a_record_has_settings_machine_and_rows(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "squares.json"
    record = run(Squares(out=out), "squares")
    assert record["what"] == "benchmarks squares"
    assert record["settings"] == {"numbers": [2, 3]}
    assert record["rows"] == {"2": 4, "3": 9}
    assert set(record["machine"]) >= {"cpu", "commit", "torch"}
    assert json.loads(out.read_text()) == record
    assert "| {'2': 4, '3': 9} |" in capsys.readouterr().out
    with pytest.raises(OutputExistsError):
        run(Squares(out=out, numbers=(-1,)), "squares")
    assert run(Squares(out=out, numbers=(5,), overwrite=True), "squares")["rows"] == {"5": 25}


def test_rows_are_kept_and_not_measured_again(tmp_path: Path) -> None:
    rows = tmp_path / "rows.json"
    with pytest.raises(KeyboardInterrupt):
        run(Squares(rows=rows, numbers=(2, -1, 3)), "squares")
    kept = json.loads(rows.read_text())
    assert kept["rows"] == {"2": 4, "-1": 1}
    kept["rows"] |= {"-1": 100, "3": 9}
    rows.write_text(json.dumps(kept))
    with pytest.raises(KeyboardInterrupt):  # what is known is passed over
        run(Squares(rows=rows, numbers=(2, -1, 3)), "squares")
    with refuses():
        run(Squares(rows=rows, numbers=(2, 3)), "squares")


def test_the_command(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setattr(
        program, "STUDIES", Family("All.", dict.fromkeys(("squares", "again"), f"{__name__}:Squares"))
    )
    assert program.main(["squares", "--numbers", "4"]) == 0
    assert program.main(["squares", "--numbers", "7"]) == 1
    (tmp_path / "there.json").write_text("{}")
    assert program.main(["squares", "--out", str(tmp_path / "there.json")]) == 2
    assert "there.json: already exists" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        program.main([])
    assert "Square some numbers." in capsys.readouterr().out


def test_every_study_can_be_named() -> None:
    for name in program.STUDIES.verbs:
        study = program.STUDIES.load(name)
        assert isinstance(study, type)
        assert issubclass(study, Study)
        assert study.__doc__
