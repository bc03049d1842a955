"""The benchmark of many visitors at once: it finds no fault in the server, and does find those that are planted."""

from __future__ import annotations

import sys

import pytest

pytest.importorskip("starlette", reason="needs scoup[view]")
from benchmarks.server_load import ServerLoad
from benchmarks.study import run

from scoup_lab.bench.measuring import resident_bytes

pytestmark = pytest.mark.skipif(
    resident_bytes() is None, reason="reads the state of a process as Linux shows it"
)
FEW = ServerLoad(clients=3, requests=15, pause=0, n_gaussians=500)
ENTRY = "\nfrom scoup.cli.app import entry\nentry()"
FAULT = """
from scoup.view.viewed_field import ViewedField
def fail(*arguments):
    raise RuntimeError("planted")
ViewedField.answers = fail
"""
ANOTHER = """
import itertools
from scoup.view import server
plain, numbers = server.JSONResponse, itertools.count()
server.JSONResponse = lambda content, *more: plain({**content, "number": next(numbers)}, *more)
"""


def test_visitors_meet_no_error(capsys: pytest.CaptureFixture[str]) -> None:
    record = run(FEW, "server-load")
    assert record["errors"] == 0, record["first_errors"]
    assert record["counts"]["query"] > 5
    assert set(record["seconds"]) >= {"query", "picture"}
    assert record["server"]["last"]["resident"] > 1e6
    assert "3 clients" in capsys.readouterr().out


@pytest.mark.parametrize(("planted", "said"), [(FAULT, "status 500"), (ANOTHER, "another answer to")])
def test_planted_faults_are_errors(planted: str, said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ServerLoad, "program", (sys.executable, "-c", planted + ENTRY))
    record = run(FEW, "server-load")
    assert FEW.failed(record)
    assert record["errors"] > 0
    assert any(said in error for error in record["first_errors"]), record["first_errors"]
