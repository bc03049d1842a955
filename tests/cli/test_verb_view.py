"""scoup view."""

from __future__ import annotations

import contextlib
import json
import signal
import sys
import threading
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from subprocess import Popen

import pytest

from children import child
from cli_support import printed, refused, run_json
from scoup.view import export, page, viewer
from scoup.view.page import PROGRAM, SETTINGS, STYLE, PageFiles

PAGE = PageFiles(f"<head>{STYLE}{SETTINGS}</head>{PROGRAM}", b"", "", "")
BUILT = page.page_files
QUERY = json.dumps({"texts": ["kettle"]}).encode()
pytestmark = pytest.mark.usefixtures("quick_python", "here")

SERVE = f"""
from scoup.view import page, viewer
page.page_files = viewer.page_files = lambda: page.PageFiles({PAGE.index!r}, b"", "", "")
from scoup.cli.app import entry
entry()
"""


@pytest.fixture(autouse=True)
def built_page(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (export, page, viewer):
        monkeypatch.setattr(module, "page_files", lambda: PAGE)


def test_export_prints_sizes():
    out = printed("view", "f.scoup", "--export", "page.html")
    assert out.startswith("page.html: 0.")
    assert out.rstrip().endswith("3 words")
    record = run_json("view", "f.scoup", "--export", "page.html", "--overwrite")
    assert record["bytes"] == Path("page.html").stat().st_size
    folder = run_json("view", "f.scoup", "--export", "pages", "--split")
    assert folder["bytes"] == sum(path.stat().st_size for path in Path("pages").iterdir())
    Path("words.txt").write_text("mug\n")
    assert run_json("view", "f.scoup", "--export", "own.html", "--words", "words.txt")["words"] == 1


def test_bad_input_is_one_sentence():
    Path("other.txt").write_text("zebra\n")
    assert "zebra" in refused("view", "f.scoup", "--words", "other.txt")
    assert "missing.npz" in refused("view", "f.scoup", "--text", "missing.npz")
    Path("there.html").write_text("mine")
    assert "--overwrite" in refused("view", "f.scoup", "--export", "there.html")


def test_a_page_that_was_not_built_is_said(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    monkeypatch.setattr(page, "page_files", lambda: BUILT(tmp_path))
    assert "tools/build_viewer.py" in refused("view", "f.scoup")


@contextmanager
def served(before: str = "") -> Iterator[tuple[Popen[str], str]]:
    """A server in a process of its own, which runs some Python before, and the address of its queries."""
    command = [sys.executable, "-c", before + SERVE, "view", "f.scoup", "--port", "0", "--json"]
    with child(command) as process:
        assert process.stdout is not None
        lines = []
        while not lines or lines[-1] != "}\n":
            lines.append(process.stdout.readline())
            assert lines[-1], process.stderr and process.stderr.read()
        yield process, f"{json.loads(''.join(lines))['address']}api/query"


@pytest.mark.parametrize(("stop", "code"), [(signal.SIGINT, 0), (signal.SIGTERM, 143)])
def test_it_serves_until_it_is_stopped(stop: signal.Signals, code: int):
    with served() as (process, queries):
        with urllib.request.urlopen(urllib.request.Request(queries, QUERY)) as answer:
            assert json.load(answer)["answers"][0]["text"] == "kettle"
        process.send_signal(stop)
        _, err = process.communicate()
    assert (process.returncode, err) == (code, "")


SLOW = """
import sys, time
from scoup.view.viewed_field import ViewedField
def answers(*_):
    print("asked", flush=True)
    time.sleep(4)  # longer than the server waits for answers
ViewedField.answers = answers
"""


def test_it_stops_quietly_while_requests_wait():
    def ask(queries: str) -> None:
        with contextlib.suppress(OSError):  # nobody answers, or it is said that the server ends
            urllib.request.urlopen(urllib.request.Request(queries, QUERY))

    with served(SLOW) as (process, queries):
        visitors = [threading.Thread(target=ask, args=(queries,)) for _ in range(3)]
        for visitor in visitors:
            visitor.start()
        assert process.stdout is not None
        assert process.stdout.readline() == "asked\n"
        process.send_signal(signal.SIGTERM)
        _, err = process.communicate()
        for visitor in visitors:
            visitor.join()
    assert (process.returncode, err) == (143, "")
