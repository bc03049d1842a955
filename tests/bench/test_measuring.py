"""Turns, threads and clocks; tables, JSON and the machine; stages on every backend; the runner of the studies."""

from __future__ import annotations

import json
import socket
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import torch
from benchmarks import __main__ as program
from benchmarks.study import Record, Study, run

from messages import refuses
from scoup import raster
from scoup.base import InputError, OutputExistsError, UnknownNameError
from scoup.cli import Family
from scoup_lab.bench import measure
from scoup_lab.bench.environment import describe_environment, in_one_line
from scoup_lab.bench.measure import StageClock, Task, Timing, time_tasks, torch_threads
from scoup_lab.bench.report import markdown, milliseconds, write_json
from scoup_lab.bench.stages import STAGES, random_workload, stage_runs, usable_backends


def test_tasks_take_turns_under_their_threads():
    before = torch.get_num_threads()
    ran: list[tuple[str, int]] = []
    tasks = {
        name: Task(lambda name=name: ran.append((name, torch.get_num_threads())), threads, repeats)
        for name, threads, repeats in (("a", 1, 3), ("b", 2, 1))
    }
    reported: list[tuple[int, int]] = []
    timings = time_tasks(tasks, progress=lambda _, done, total: reported.append((done, total)))
    # Round 0 warms up; rounds go forwards and backwards in turn; b has had enough after one.
    assert "".join(name for name, _ in ran) == "ba" + "ab" + "a" + "a"
    assert set(ran) == {("a", 1), ("b", 2)}
    assert {key: len(timing.seconds) for key, timing in timings.items()} == {"a": 3, "b": 1}
    assert reported[0] == (0, 6)
    assert reported[-1] == (6, 6)
    assert torch.get_num_threads() == before
    assert time_tasks({}) == {}
    with pytest.raises(RuntimeError, match="oh"), torch_threads(before + 1):
        raise RuntimeError("oh")
    assert torch.get_num_threads() == before


@pytest.fixture
def now(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The time, in seconds."""
    time = [0.0]
    monkeypatch.setattr(measure.time, "perf_counter", lambda: time[0])
    return time


def test_the_clock_of_stages(now: list[float]):
    reported: list[str] = []
    clock = StageClock(lambda stage, done, total: reported.append(f"{stage} {done}/{total}"))
    calls = [("coding", 0, 2), ("coding", 1, 2), ("coding", 2, 2), ("uplift", 0, 1), ("uplift", 1, 1)]
    for power, call in enumerate(calls):
        now[0] += 2.0**power
        clock(*call)
    now[0] += 32.0
    found = {"start": 1.0, "coding": 6.0, "after coding": 8.0, "uplift": 16.0, "after uplift": 32.0}
    assert clock.stop() == found
    assert reported == ["coding 0/2", "coding 1/2", "coding 2/2", "uplift 0/1", "uplift 1/1"]


def test_short_runs_are_repeated_in_a_row(now: list[float]) -> None:
    def take(seconds: float) -> Callable[[], None]:
        def run() -> None:
            now[0] += seconds
            ran.append(seconds)

        return run

    ran: list[float] = []
    tasks = {seconds: Task(take(seconds), repeats=1) for seconds in (0.25, 2.0, 1e-6)}
    timings = time_tasks(tasks, least_seconds=1.0)
    assert [ran.count(seconds) for seconds in tasks] == [1 + 4, 1 + 1, 1 + measure.MOST_IN_A_ROW]
    assert all(timings[seconds].median == pytest.approx(seconds, rel=1e-3) for seconds in tasks)


def test_tables_are_aligned_and_times_have_three_digits():
    rows = ["| a      |  bb |", "| ------ | --: |", "| 1      |   2 |", "| 333333 |   4 |"]
    assert markdown(["a", "bb"], [["1", "2"], ["333333", "4"]]).splitlines() == rows
    texts = {12.3456: "12,346", 0.123456: "123", 0.0123456: "12.3", 0.00123456: "1.23", 1.2e-5: "0.012"}
    assert {seconds: milliseconds(seconds) for seconds in texts} == texts


def test_json_is_written_once(tmp_path: Path):
    path = tmp_path / "new" / "a.json"
    write_json(path, Timing((3.0, 1.0, 2.0, 9.0)).to_dict())
    assert json.loads(path.read_text()) == {"median_s": 2.5, "min_s": 1.0, "max_s": 9.0, "repeats": 4}
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
    line = in_one_line(environment)
    assert all(environment[part] and environment[part] in line for part in ("cpu", "torch"))
    assert "None" not in line


BACKENDS = usable_backends()[0]


@pytest.fixture(scope="module")
def work():
    return random_workload(300, 40, 30, regions=(6, 4, 2))


@pytest.mark.parametrize("backend", BACKENDS)
def test_every_stage_runs(work, backend):
    runs = stage_runs(work, backend)
    assert list(runs) == list(STAGES)
    results = {name: run() for name, run in runs.items()}
    assert results["project"].backend == backend
    image, alpha = results["alpha"]
    assert image.shape == (30, 40, 1)
    assert torch.allclose(image[..., 0], alpha, atol=1e-5)
    sums = results["sums"]
    assert int(sums.combination.max()) < len(sums.table)
    # Every pixel has a region, so what is summed up is what is painted.
    assert float(sums.weight.sum()) == pytest.approx(float(alpha.sum()), rel=1e-3)
    assert sums.table.shape[1] == 3
    assert results["colors"][0].shape == (30, 40, 3)
    assert results["codes"].shape == (3, 30, 40, 64)
    assert results["cosines"].shape == (3, 1, 30, 40)
    assert results["vote"].indices.shape == results["vote"].weights.shape == (300, 3, 4)


def test_stages_and_backends_are_those_wanted(work, monkeypatch: pytest.MonkeyPatch):
    assert list(stage_runs(work, "reference", ["vote", "project"])) == ["vote", "project"]
    with refuses():
        stage_runs(work, "reference", ["paint"])
    monkeypatch.setitem(raster.BACKENDS, "broken", "scoup.raster.no_such_module")
    found, reasons = usable_backends()
    assert ("reference" in found, "broken" in found) == (True, False)
    assert "no_such_module" in reasons["broken"]
    for name, kind in (("broken", InputError), ("nonsense", UnknownNameError)):
        with refuses(kind):
            usable_backends([name])
    assert usable_backends(["reference", "reference"]) == (["reference"], {})


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


def test_a_record_has_settings_machine_and_rows(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "squares.json"
    record = run(Squares(out=out), "squares")
    parts = {"what": "benchmarks squares", "settings": {"numbers": [2, 3]}, "rows": {"2": 4, "3": 9}}
    assert record == {**record, **parts}
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
    studies: dict[str, str] = dict.fromkeys(("squares", "again"), f"{__name__}:Squares")
    monkeypatch.setattr(program, "STUDIES", Family("All.", studies))
    assert program.main(["squares", "--numbers", "4"]) == 0
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
