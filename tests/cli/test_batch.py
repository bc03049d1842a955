"""scoup batch: every scan of a folder, resumed, with an archive and a report."""

from __future__ import annotations

import json
import os
import shutil
import socket
from pathlib import Path

import pytest

from cli_support import FREE, refused, run, run_json, write_scene

pytest.importorskip("duckdb", reason="duckdb is not installed (pip install 'scoup[archive]')")
pytestmark = pytest.mark.usefixtures("quick_python")


@pytest.fixture(autouse=True)
def _empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_a_folder_of_scans_becomes_fields_and_an_archive() -> None:
    for name in "ab":
        write_scene(Path("scans") / name)  # of one world: their words are the same
    shutil.copytree("scans/a", "scans/broken")
    Path("scans/broken/point_cloud.ply").write_bytes(b"ply\n")
    table = Path("scans/a/words.npz").resolve()
    options = ("--out", "fields", "--archive", "archive", "--jobs", "2")
    command = ("batch", "scans", *options, "--model", table)
    code, out, _ = run(*command, "--json")
    said = json.loads(out)
    assert code == 2
    assert said["failed"] == ["broken"]
    assert "scans/broken/point_cloud.ply" in said["scans"]["broken"]["error"]
    rows = [row.split("<td>")[1:] for row in Path("fields/batch.html").read_text().split("<tr>")[2:]]
    assert [row[:2] for row in rows] == [["a", "done"], ["b", "done"], ["broken", "failed"]]
    assert "scans/broken/point_cloud.ply" in rows[2][3]
    listed = run_json("archive", "archive", "--list")
    assert [each["scan"] for each in listed["scans"]] == ["a", "b"]
    assert "presence must be" in refused("archive", "archive", "kettle", "--presence", 2)

    # Only what is missing is made again, in fields and archive.
    shutil.copy("scans/a/point_cloud.ply", "scans/broken/point_cloud.ply")
    Path("archive/a.parquet").unlink()
    os.utime("archive/b.parquet", (2e9, 2e9))  # of a clock that was set back since
    times = lambda: [Path(name).stat().st_mtime_ns for name in ("fields/a.scoup", "archive/b.parquet")]  # noqa: E731
    before = times()
    first = said["scans"]["b"]
    said = run_json(*command)
    assert said["scans"]["b"] == {**first, "kept": True}
    kept = {name: record["kept"] for name, record in said["scans"].items()}
    assert kept == {"a": True, "b": True, "broken": False}
    assert times() == before
    assert len(run_json("archive", "archive", "--list")["scans"]) == 3
    Path("fields/b.scoup").unlink()
    run_json(*command)
    assert times()[1] < before[1]

    # A damaged report is no report.
    records = (
        "[1]",
        '{"a": 3}',
        '{"a": {"warnings": 3, "seconds": 1.5}}',
        '{"a": {"warnings": [3], "seconds": 1.5}}',
    )
    for text in ("[" * 100_000, "3", *(f'{{"scans": {record}}}' for record in records)):
        Path("fields/batch.json").write_text(text)
        assert run_json("batch", "scans", "--out", "fields")["scans"]["a"] == {"kept": True}


def test_builds_get_the_options_that_were_passed(monkeypatch: pytest.MonkeyPatch) -> None:
    write_scene(Path("scans/a"))
    shutil.copytree("scans/a", "scans/broken")
    Path("scans/broken/point_cloud.ply").write_bytes(b"ply\n")  # found before any is built
    seen: dict[str, list[str]] = {}
    monkeypatch.setattr(
        "scoup.cli.batch._in_processes", lambda commands, jobs: iter(seen.update(commands) or ())
    )
    passed = [*FREE, "--embed-geometry", "--preset", "paper", "--masks", "black", "--no-masks"]
    said = json.loads(run("batch", "scans", "--out", "fields", *passed, "--json")[1])
    assert (said["failed"], [*seen]) == (["broken"], ["a"])
    start, rest = seen["a"][:4], seen["a"][4:]
    assert start == ["build", "scans/a", "--out", "fields/a.scoup"]
    assert sorted(rest) == sorted([*passed, "--device", "cpu", "--overwrite", "--json"])


def test_fields_that_name_no_words_are_not_archived() -> None:
    write_scene(Path("scans/a"))
    code, out, _ = run("batch", "scans", "--out", "fields", "--archive", "scans.archive")
    assert code == 2
    assert "a: fields/a.scoup: names no embedding model; pass a word table or model as --text" in out


def test_a_cluster_that_is_not_there_is_refused_at_once() -> None:
    Path("scans/a").mkdir(parents=True)
    with socket.socket() as closed:
        closed.bind(("127.0.0.1", 0))
        port = closed.getsockname()[1]
        for address in (f"127.0.0.1:{port}", f"ray://localhost:{port}", f"localhost:9{port}"):
            said = refused("batch", "scans", "--out", "f", "--ray", address)
            assert f"--ray {address}: nothing answers there (" in said
