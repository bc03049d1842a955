"""Damaged files for every reader (benchmarks/hostile), and readers that misbehave on purpose, which it must find."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from benchmarks.hostile import study as hostile_study
from benchmarks.hostile.containers import join_parts
from benchmarks.hostile.readers import READERS
from benchmarks.hostile.run import FAILURES, Limits, Trial, try_reader
from benchmarks.hostile.samples import write_samples
from benchmarks.hostile.study import Hostile
from benchmarks.hostile.worker import Job, damaged_file
from benchmarks.study import run

from planted_readers import FILE, VALID, write_planted
from scoup.base.errors import InputError, UnknownNameError

pytestmark = pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="limits and peaks are those of Linux"
)

COUNT, SEED = 30, 7
EXPECTED = {
    "good": "refused",
    "accepting": "accepted",
    "crash": "crash",
    "exit": "crash",
    "loop": "hang",
    "much": "memory",
    "much, untouched": "memory",
    "much, hidden": "memory",
    "not so much": "accepted",
    "ValueError": "other error",
    "nameless": "other error",
    "RuntimeWarning": "other error",
}


@pytest.fixture(scope="module")
def samples(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("valid")
    write_samples(folder)
    return folder


@pytest.fixture
def planted(tmp_path: Path) -> Path:
    (tmp_path / "valid").mkdir()
    write_planted(tmp_path / "valid")
    return tmp_path / "valid"


def planted_trial(
    name: str, folder: Path, count: int, failures: Path | None = None, **limits: float
) -> Trial:
    return try_reader(name, folder, count, 1, "planted_readers:PLANTED", Limits(**limits), failures)


@pytest.mark.parametrize("name", READERS)
def test_no_reader_misbehaves(samples: Path, name: str) -> None:
    trial = try_reader(name, samples, max(10, int(COUNT * READERS[name].share)), SEED)
    assert not trial.failures, trial.failures[0]
    assert trial.outcomes["refused"]
    assert trial.outcomes["refused"] + trial.outcomes["accepted"] == trial.files


@pytest.mark.parametrize("name", EXPECTED)
def test_what_readers_do_is_found(planted: Path, name: str) -> None:
    trial = planted_trial(name, planted, 2, planted.parent / "failures", processor=0.5)
    # Damage may leave a file as it was, by chance; with this seed it does not.
    assert dict(trial.outcomes) == {EXPECTED[name]: 2}
    saved = sorted(path.name for path in planted.parent.glob("failures/*/*.planted"))
    outcome = EXPECTED[name].replace(" ", "-")
    wanted = [f"{number:06d}-{outcome}.planted" for number in range(2)]
    assert saved == (wanted if EXPECTED[name] in FAILURES else [])


def test_a_process_without_a_word_is_ended(planted: Path) -> None:
    assert dict(planted_trial("sleep", planted, 1, wall=1.0).outcomes) == {"hang": 1}


def test_what_is_kept_of_a_failure_is_the_file(planted: Path) -> None:
    trial = planted_trial("crash", planted, 2, planted.parent / "failures")
    kept = [path.read_bytes() for path in sorted((planted.parent / "failures" / "crash").glob("*.planted"))]
    job = Job("planted_readers:PLANTED", "crash", planted, 1, range(2), 1.0)
    assert kept == [damaged_file(job, number) for number in range(2)]
    assert kept[0] != VALID
    assert [result.said for result in trial.failures] == ["exit status -11"] * 2


def test_samples_that_are_not_valid_are_named(planted: Path) -> None:
    (planted / FILE).write_bytes(b"something else")
    with pytest.raises(InputError, match="ValueError: its valid sample is not read"):
        planted_trial("ValueError", planted, 1)
    with pytest.raises(InputError, match="crash: the process ended at its valid sample"):
        planted_trial("crash", planted, 1)


@pytest.mark.parametrize("name", [name for name, reader in READERS.items() if reader.containers])
def test_containers_are_put_together_as_they_were(samples: Path, name: str) -> None:
    """What is taken apart and joined again is taken apart alike, and damage inside changes the whole."""
    reader = READERS[name]
    for file in (reader.file, *reader.more):
        whole = (samples / file).read_bytes()
        for container in reader.containers:
            parts = container.split(whole)
            again = join_parts(container, whole, parts)
            assert [part.rstrip() for part in container.split(again)] == [part.rstrip() for part in parts]
            last = max(range(len(parts)), key=lambda place: len(parts[place]))
            changed = [part[1:] if place == last else part for place, part in enumerate(parts)]
            assert join_parts(container, whole, changed) != again


def test_the_study_counts_by_reader(capsys: pytest.CaptureFixture[str]) -> None:
    study = Hostile(per_reader=5, readers=("splat", "cfg_args"))
    record = run(study, "hostile")
    assert [row["reader"] for row in record["readers"]] == ["splat", "cfg_args"]
    assert all(row["files"] == row["accepted"] + row["refused"] == 5 for row in record["readers"])
    assert record["failures"] == []
    assert not study.failed(record)
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("|")]
    assert len(lines) == 4
    with pytest.raises(UnknownNameError, match="spam"):
        run(Hostile(per_reader=5, readers=("spam",)), "hostile")


def test_the_study_keeps_what_failed(planted: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = planted_trial("crash", planted, 2)
    monkeypatch.setattr(hostile_study, "try_reader", lambda *_, **__: found)
    study = Hostile(per_reader=2, readers=("splat",))
    record = run(study, "hostile")
    assert [(each["reader"], each["outcome"]) for each in record["failures"]] == [("splat", "crash")] * 2
    assert study.failed(record)
