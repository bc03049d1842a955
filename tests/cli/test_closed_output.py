"""Whoever reads the output may go: the work goes on, is written, and the exit status is that of the work."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from children import finished
from cli_support import BUILD, RUN, run
from scoup.cli import main

pytestmark = pytest.mark.usefixtures("here")


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


@pytest.mark.parametrize(("stream", "more"), [("stdout", ()), ("stdout", ("--json",)), ("stderr", ())])
def test_results_and_warnings_that_nobody_reads(stream: str, more: tuple[str, ...]) -> None:
    Path("scene/images/view_00.png").unlink()  # of which a warning is said
    with nobody_reads(stream):
        assert main([*BUILD, *more]) == 0
    assert run("info", "a.scoup")[0] == 0


def in_a_shell(python: str, *words: str, ending: str) -> int:
    """The exit code of the command line."""
    command = f"set -o pipefail; '{python}' -c '{RUN}' {' '.join(words)} {ending}"
    return finished(["bash", "-c", command]).returncode


@pytest.mark.skipif(sys.platform == "win32", reason="shells of Unix")
def test_shells_that_close_streams(preloaded_python: str) -> None:
    convert = ("convert", "scene/point_cloud.ply", "a.splat")
    assert in_a_shell(preloaded_python, *convert, ending="| true") == 0
    assert in_a_shell(sys.executable, *convert, "--overwrite", ending="<&- >&- 2>&-") == 0
    assert run("info", "a.splat")[0] == 0
    assert in_a_shell(preloaded_python, "build nowhere --out b.scoup", ending="2>&1 | true") == 2
