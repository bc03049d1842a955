"""Two processes at one output, and processes that are interrupted, terminated or killed."""

from __future__ import annotations

import json
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from subprocess import PIPE
from unittest.mock import Mock

import pytest

from children import Child, child, finished
from cli_support import BUILD, FREE, RUN, plain_photographs, printed, refused, run, run_json
from messages import check_message
from scoup.base import locked, reserved_output
from scoup.cli.stop import stop_on_signals
from scoup.io import RegionStore, load_gaussians, save_gaussians

pytestmark = pytest.mark.usefixtures("quick_python", "here")

PYTHON = sys.executable  # that of most tests here has imported everything already
EXTRACT = ("extract", "scene", *FREE, "--out", "regions")
# A build in a process of its own that rasterises no third view: it waits, once two are in their files.
STUCK = """
import time
from scoup import raster
from scoup.cli.app import entry
from scoup.uplift.stored_sums import RegionSums
region_sums, append, rasterised, appended = raster.region_sums, RegionSums.append, [], []
def counted(self, *view):
    append(self, *view)
    appended.append(1)
def slow(*view):
    rasterised.append(1)
    while len(rasterised) == 3 and len(appended) < 2:
        time.sleep(0.01)
    if len(rasterised) == 3:
        print("two views", flush=True)
    while len(rasterised) == 3:
        time.sleep(0.1)
    return region_sums(*view)
raster.region_sums, RegionSums.append = slow, counted
entry()
"""
KEEP = (*BUILD, "--model", "scene/words.npz", "--keep-sums", "sums")


def names() -> set[str]:
    return {path.name for path in Path().iterdir()}


@contextmanager
def stuck(*arguments: object) -> Iterator[Child]:
    """The build, stuck after two views."""
    command = [sys.executable, "-c", STUCK, *arguments]
    with child(command) as process:
        while not process.stdout.readline().startswith("two views"):
            assert process.poll() is None
        yield process


KEPT = "error: {}; 2 of 4 views are kept, run the same command again to continue\n"
STOPS = {
    "interrupted": (KEEP, signal.SIGINT, 130, KEPT.format("interrupted"), {"sums"}),
    "killed": (KEEP, signal.SIGKILL, -9, "", {"sums", ".a.scoup.work.lock"}),
    "terminated, none kept": (BUILD, signal.SIGTERM, 143, "error: terminated; nothing was written\n", set()),
}
"""The build, the signal, the exit code, what is said, and what is left: else neither locks nor temporary files."""


@pytest.mark.parametrize("case", STOPS)
def test_a_build_that_is_stopped_goes_on(case: str) -> None:
    verb, number, code, said, left = STOPS[case]
    before = names()
    with stuck(*verb) as build:
        assert refused(*verb).startswith("a.scoup: is being written by another process; wait for it")
        build.send_signal(number)
        _, err = build.communicate()
    assert (build.returncode, err) == (code, said)
    assert names() - before == left
    code, out, err = run(*verb)
    assert code == 0, err
    assert names() - before == {"a.scoup", *({"sums"} if verb is KEEP else ())}
    if verb is KEEP:
        assert err == ""
        assert "sums: contains 2 views already" in out
        run_json(*KEEP[: KEEP.index("--keep-sums")], "--out", "whole.scoup")
        assert Path("a.scoup").read_bytes() == Path("whole.scoup").read_bytes()


def test_verbs_that_find_their_output_in_use() -> None:
    for name in ("regions", "sums"):
        Path(name).mkdir()
    part = ("build", "scene", "--keep-sums", "sums", "--part", "1/2")
    with (
        reserved_output(Path("a.scoup")),
        locked(Path("sums/part-1-of-2")),
        locked(Path("regions/part-1-of-1")),
    ):
        for verb in (BUILD, part, EXTRACT):
            check_message(refused(*verb))


def test_an_interrupted_extraction_says_how_to_go_on(monkeypatch: pytest.MonkeyPatch) -> None:
    plain_photographs()
    write, written = RegionStore.write, []

    def interrupted(self, *view, **more):
        if len(written) == 3:
            raise KeyboardInterrupt
        written.append(1)
        return write(self, *view, **more)

    with monkeypatch.context() as patch:
        patch.setattr(RegionStore, "write", interrupted)
        code, out, err = run(*EXTRACT, "--json")
    assert code == 130
    assert err == "error: interrupted; 3 of 4 views are kept, run the same command again to continue\n"
    assert json.loads(out) == {"error": err.removeprefix("error: ").strip()}
    assert len(list(Path("regions").glob("*.regions"))) == 3
    out = printed(*EXTRACT)
    assert "regions: resumes: 3 of 4 views are done\n" in out
    assert "1 view made, 3 already there" in out


WHERE = """
from scoup.archive import archive
matching = archive.matching_things
def announced(*asked):
    print("asked", flush=True)
    return matching(*asked)
archive.matching_things = announced
from scoup.cli.app import entry
entry()
"""
ENDLESS = "(select count(*) from range(20000000000000)) > 0", "length(repeat('x', 4000000000)) > 0"


@pytest.mark.parametrize(
    ("where", "number", "code"), [(ENDLESS[0], signal.SIGINT, 130), (ENDLESS[1], signal.SIGTERM, 143)]
)
def test_conditions_that_do_not_end_are_stopped(where: str, number: int, code: int) -> None:
    printed("archive", "a", "--add", "f.scoup")
    with child([sys.executable, "-c", WHERE, "archive", "a", "kettle", "--where", where]) as search:
        assert search.stdout.readline() == "asked\n"
        search.send_signal(number)
        _, err = search.communicate()
    said = {130: "interrupted", 143: "terminated"}[code]
    assert (search.returncode, err) == (code, f"error: {said}; nothing was written\n")


@pytest.mark.parametrize(("command", "inside"), [
    ("query f.scoup kettle --out new/answers", "scoup.query.field_view.FieldView.show"),
    ("select f.scoup kettle --out new/a.ply", "scoup.query.ask.each_answer"),
    ("render f.scoup --out new/a.gif", "scoup.pictures.save_frames"),
    ("views scene/point_cloud.ply --width 24 --height 18 --up 0 -1 0 --out new/own",
     "scoup.extract.own_views.render_colors"),
    ("convert scene new/compact", "scoup.io.regions.compact.write_view"),
    ("demo --out new/demo", "scoup_lab.evaluate.demonstration.make_demo_scene"),
    ("transfer f.scoup edited.ply --out new/b.scoup", "scoup.uplift.transfer"),
    ("build scene --n-atoms 8 --out new/a.scoup", "scoup.uplift.region_codes.fit_codes"),
])  # fmt: skip
def test_where_nothing_is_kept_nothing_is_left(
    command: str, inside: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    save_gaussians(load_gaussians("scene").select(slice(5, None)), "edited.ply")
    before = {path: path.stat().st_mtime_ns for path in Path().rglob("*") if path.is_file()}
    monkeypatch.setattr(inside, Mock(side_effect=KeyboardInterrupt))
    code, _, err = run(*command.split())
    assert (code, err) == (130, "error: interrupted; nothing was written\n")
    assert not list(Path("new").rglob("*"))
    assert {path: path.stat().st_mtime_ns for path in Path().rglob("*") if path.is_file()} == before


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_server_of_agents_ends_quietly_while_its_input_is_open(number: signal.Signals, code: int) -> None:
    pytest.importorskip("mcp", reason="needs scoup[mcp]")
    with child([sys.executable, "-c", RUN, "mcp", "f.scoup"], stdin=PIPE) as server:
        assert "serving f" in server.stderr.readline()
        server.stdin.write("?\n")
        server.stdin.flush()
        assert "error" in server.stdout.readline()  # it reads
        server.send_signal(number)
        assert (server.wait(), server.stderr.read()) == (code, "")


# The command line, which sends itself a signal when it has imported so many modules, one of which makes another error
# of an interruption.
AT_AN_IMPORT = """
import signal, sys
from scoup.cli.app import entry
number, count = int(sys.argv.pop(1)), int(sys.argv.pop(1))
class Interrupts:
    def find_spec(self, name, *_):
        global count
        count -= 1
        try:
            count or signal.raise_signal(number)
        except KeyboardInterrupt as error:
            raise ImportError(name) from error
sys.meta_path.insert(0, Interrupts())
entry()
"""
# An output is being written meanwhile.
AT_WORK = """
import sys, time
from scoup.base.outputs import reserved_output
from scoup.cli.stop import exit_code, stop_on_signals
stop_on_signals()
try:
    with reserved_output("a.scoup"):
        import stops
        while True:
            time.sleep(0.01)
except KeyboardInterrupt as stop:
    sys.exit(exit_code(stop))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="signals of Unix")
@pytest.mark.parametrize(("number", "count"), [(signal.SIGINT, 40), (signal.SIGTERM, 640)])
def test_a_stop_while_libraries_are_imported_is_quiet(number: int, count: int) -> None:
    arguments = ("query", "f.scoup", "kettle", "--out", "answers")
    done = finished([PYTHON, "-c", AT_AN_IMPORT, int(number), count, *arguments])
    assert (done.returncode, done.stdout, done.stderr) == (128 + number, "", "")
    assert not Path("answers").exists()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_stop_during_an_import_waits_where_an_output_is_begun(number: int) -> None:
    Path("stops.py").write_text(f"import signal\nsignal.raise_signal({int(number)})\nopen('whole', 'w')\n")
    before = names()
    done = finished([PYTHON, "-c", AT_WORK])
    assert (done.returncode, done.stderr) == (128 + number, "")
    # The import was not cut short, the output not left.
    assert names() - before - {"__pycache__"} == {"whole"}


def test_who_ignores_interruptions_still_does(monkeypatch: pytest.MonkeyPatch) -> None:
    """As jobs in the background of a shell."""
    handlers = {signal.SIGINT: signal.SIG_IGN, signal.SIGTERM: signal.SIG_DFL}
    monkeypatch.setattr("signal.signal", handlers.__setitem__)
    monkeypatch.setattr("signal.getsignal", handlers.__getitem__)
    stop_on_signals()
    assert handlers[signal.SIGINT] is signal.SIG_IGN
    assert handlers[signal.SIGTERM] is not signal.SIG_DFL
