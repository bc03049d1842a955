"""Whoever reads the output may go: the work goes on, is written, and the exit status is that of the work."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from cli.test_no_space import VERBS, entries
from cli.test_no_space import original as original  # the fixture: a scene, fields, shards
from cli_support import BUILD, RUN, run
from scoup.cli import main

pytestmark = pytest.mark.usefixtures("here")
unix = pytest.mark.skipif(sys.platform == "win32", reason="shells of Unix")


@contextmanager
def nobody_reads(name: str) -> Iterator[None]:
    """A standard stream is a pipe whose reader has gone."""
    reader, writer = os.pipe()
    os.close(reader)
    before = getattr(sys, name)
    with open(writer, "w") as stream:
        setattr(sys, name, stream)
        try:
            yield
        finally:
            setattr(sys, name, before)


@pytest.mark.parametrize("verb", [name for name in VERBS if name not in ("demo", "bench")])
def test_every_verb_ends_its_work(verb: str, tmp_path: Path) -> None:
    """With text and with JSON on the pipe; what is written is what is written otherwise."""
    assert run(*VERBS[verb])[0] == 0
    expected = entries(Path())
    for options in ((), ("--json",)):
        with nobody_reads("stdout"):
            code = main([str(part) for part in (*VERBS[verb], *options, "--overwrite")])
        assert code == 0
        assert entries(Path()) == expected


def test_warnings_that_nobody_reads_end_nothing() -> None:
    (Path("scene") / "images" / "view_00.png").unlink()
    with nobody_reads("stderr"):
        code = main([str(part) for part in BUILD])
    assert code == 0
    assert Path("a.scoup").is_file()


@unix
@pytest.mark.parametrize("ending", ["| true", ">&-", "<&- >&- 2>&-"])
def test_shells_that_close_streams(ending: str) -> None:
    words = " ".join(str(word) for word in BUILD)
    command = f"set -o pipefail; '{sys.executable}' -c '{RUN}' {words} {ending}"
    assert subprocess.run(["bash", "-c", command], check=False).returncode == 0
    assert run("info", "a.scoup")[0] == 0


@unix
def test_a_mistake_stays_one_without_a_reader() -> None:
    command = f"set -o pipefail; '{sys.executable}' -c '{RUN}' build nowhere --out a.scoup 2>&1 | true"
    assert subprocess.run(["bash", "-c", command], check=False).returncode == 2
