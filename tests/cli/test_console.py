"""What all verbs share: help, version, output for people and machines, exit codes."""

from __future__ import annotations

import io
import json
import math
import os
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import torch

import scoup
from children import finished
from cli_support import BUILD, RUN, run, run_json
from scoup.base import InputError, ScoupWarning, html, slug, unique_slugs
from scoup.cli import main
from scoup.cli.console import Console, run_verb
from scoup.cli.options import Common

MACHINES = Common(as_json=True)


def test_help_without_arguments_lists_the_verbs():
    assert run("--version") == (0, f"scoup {scoup.__version__}\n", "")
    for arguments in ((), ("--help",), ("-h",)):
        code, out, _ = run(*arguments)
        assert code == 0
        assert all(verb in out for verb in ("demo", "build", "query", "select", "render", "info"))
        assert "Exit codes" in out


@pytest.mark.parametrize(
    "arguments", [("nonsense",), ("build",), ("build", "s", "--n-atoms", "many"), ("info", "x", "--nonsense")]
)
def test_what_cannot_be_parsed_is_bad_input(arguments):
    code, out, err = run(*arguments)
    assert (code, out) == (2, "")
    assert "--help" in err
    code, out, err = run(*arguments, "--json")
    assert code == 2
    assert list(json.loads(out)) == ["error"]
    assert err == f"error: {json.loads(out)['error']}\n"
    assert "--help" in err
    assert "---" not in err  # nothing of the frame around it


@pytest.mark.usefixtures("here")
def test_quiet_prints_nothing():
    assert run("query", "f.scoup", "kettle", "--quiet") == (0, "", "")
    assert run("info", "f.scoup", "--quiet") == (0, "", "")
    code, out, err = run("info", "nowhere", "--quiet")
    assert (code, out, len(err.splitlines())) == (2, "", 1)


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize("common", [Common(), Common(quiet=True), MACHINES])
def test_a_terminal_shows_that_a_verb_has_begun_until_it_says_more(monkeypatch, common):
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    before = []

    def verb(console: Console) -> None:
        before.append(terminal.getvalue())
        console.say("done")
        before.append(terminal.getvalue())

    assert run_verb(common, verb) == 0
    shown = "loading ...\r" if common == Common() else ""
    assert before == [shown, shown and f"{shown}{' ' * 11}\r"]


def test_a_warning_is_told_once(capsys):
    def verb(console: Console) -> None:
        for _ in range(3):
            warnings.warn("twice is too often", ScoupWarning, stacklevel=1)
        console.result({"a": 1})

    assert run_verb(MACHINES, verb) == 0
    out, err = capsys.readouterr()
    assert json.loads(out) == {"a": 1, "warnings": ["twice is too often"]}
    assert err == "warning: twice is too often\n"


@pytest.mark.parametrize(("message", "said"), [
    ("a: exists; pass `overwrite=True`", "a: exists; pass --overwrite"),
    ("to continue anyway, pass `check_fit=False`", "to continue anyway, pass --no-check-fit"),
    ("learn more (`n_atoms=8`)", "learn more (--n-atoms 8)"),
    ("name it with `gaussians`; or `distorted='undistort'`", "name it with --gaussians; or --undistort"),
    ("pass `segmenter='felzenszwalb'`", "pass --segmenter felzenszwalb"),
    ("run `scoup view`; a`b.ply", "run `scoup view`; a`b.ply"),
])  # fmt: skip
def test_messages_name_options_in_place_of_arguments(capsys, message: str, said: str):
    Console(Common()).warn(message)
    Console(Common()).fail(message, 2)
    assert capsys.readouterr().err == f"warning: {said}\nerror: {said}\n"


@pytest.mark.parametrize(("error", "code", "said"), [
    (InputError("a.ply: is\nodd"), 2, "a.ply: is odd"),
    (KeyboardInterrupt(), 130, "interrupted"),
    (MemoryError(), 2, "not enough memory"),
    (RuntimeError("DefaultCPUAllocator: can't allocate memory"), 2, "not enough memory"),
    (OSError(28, "No space left on device", "a.png"), 2, "a.png: the system refused (No space left on device)"),
    (OSError(24, "Too many open files"), 2, "the system refused (Too many open files); raise the limit of open files"),
])  # fmt: skip
def test_errors_are_one_line_and_one_object(capsys, error, code, said):
    def verb(console: Console) -> None:
        raise error

    shown = {}
    for common in (Common(), Common(quiet=True), MACHINES):
        assert run_verb(common, verb) == code
        shown[common] = capsys.readouterr()
    err = shown[MACHINES].err
    assert err.startswith(f"error: {said}")
    assert (err.count("\n"), {each.err for each in shown.values()}) == (1, {err})
    assert json.loads(shown.pop(MACHINES).out) == {"error": err.removeprefix("error: ").strip()}
    assert {each.out for each in shown.values()} == {""}


def test_faults_of_the_program_are_not_hidden():
    def verb(console: Console) -> None:
        raise RuntimeError("a fault")

    with pytest.raises(RuntimeError, match="a fault"):
        run_verb(Common(), verb)


def test_file_names_of_texts():
    assert slug("Wooden  table!") == "wooden-table"
    assert slug("???") == "text"
    assert slug("茶壶") == "茶壶"
    assert len(slug("𝒶" * 200).encode()) <= 80
    assert unique_slugs(["a", "a", "a-2", "A!"]) == ["a", "a-2", "a-2-2", "a-3"]


def test_control_characters_out_of_files_are_escaped(capsys) -> None:
    """They could move the cursor, or hide what a terminal shows."""
    hostile = "a\x1b[2Jb\x07\x9bc\rd\x7f\u202e\udcff"
    escaped = r"a\x1b[2Jb\x07\x9bc\x0dd\x7f\u202e\udcff"
    assert html("{{ text }}", text=hostile) == escaped  # in pages, too

    def speak(console: Console) -> None:
        console.say("a [red] :smile: [31, 9]")
        console.say(f"{hostile}\tone\ntwo: é 水")
        warnings.warn(hostile, ScoupWarning, stacklevel=1)
        raise InputError(hostile.replace("\r", ""))

    assert run_verb(Common(), speak) == 2
    out, err = capsys.readouterr()
    assert out == f"a [red] :smile: [31, 9]\n{escaped}\tone\ntwo: é 水\n"
    assert err == f"warning: {escaped}\nerror: {escaped.replace(chr(92) + 'x0d', '')}\n"
    for arguments in ([f"quer{hostile}"], ["info", "f", f"--{hostile}"], ["view", "f", "--port", hostile]):
        assert main(arguments) == 2  # the parser repeats them
        err = capsys.readouterr().err
        assert r"\x1b" in err
        assert not set("\x1b\x07\x9b\r\u202e") & set(err)


def test_steps_of_minutes_have_a_time_that_remains(monkeypatch: pytest.MonkeyPatch) -> None:
    now, shown = [0.0], Terminal()
    monkeypatch.setattr("rich.console.monotonic", lambda: now[0])
    monkeypatch.setattr(sys, "stderr", shown)
    with Console(Common()).progress() as progress:
        for done in range(3):
            progress("photographs", done, 4)
            now[0] += 100.0
    assert "0:03:20" in shown.getvalue()


# ---- whoever reads the output may go: the work goes on, and the exit status is that of the work


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


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(("stream", "more"), [("stdout", ()), ("stdout", ("--json",)), ("stderr", ())])
def test_results_and_warnings_that_nobody_reads(stream: str, more: tuple[str, ...]) -> None:
    Path("scene/images/view_00.png").unlink()  # of which a warning is said
    with nobody_reads(stream):
        assert main([*BUILD, *more]) == 0
    run_json("info", "a.scoup")


def in_a_shell(python: str, *words: str, ending: str) -> int:
    """The exit code of the command line."""
    command = f"set -o pipefail; '{python}' -c '{RUN}' {' '.join(words)} {ending}"
    return finished(["bash", "-c", command]).returncode


@pytest.mark.usefixtures("here")
@pytest.mark.skipif(sys.platform == "win32", reason="shells of Unix")
def test_shells_that_close_streams(preloaded_python: str) -> None:
    frame = ("frame", "f.scoup", "--metres-per-unit")  # which writes without torch
    for number, python, ending in ((2, preloaded_python, "| true"), (3, sys.executable, "<&- >&- 2>&-")):
        assert in_a_shell(python, *frame, str(number), ending=ending) == 0
        assert run_json("info", "f.scoup")["frame"]["metres_per_unit"] == number
    assert in_a_shell(preloaded_python, "build nowhere --out b.scoup", ending="2>&1 | true") == 2


def test_json_has_neither_nan_nor_infinity(capsys: pytest.CaptureFixture[str]) -> None:
    odd = (math.nan, [-math.inf, np.float32("nan")], {"a": torch.tensor(math.inf)}, Path("a"), 1.5)
    Console(Common(as_json=True)).result({"odd": odd})
    assert json.loads(capsys.readouterr().out, parse_constant=pytest.fail) == {
        "odd": [None, [None, None], {"a": None}, "a", 1.5]
    }
