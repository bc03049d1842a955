"""What reaches a terminal: no control characters out of files, and one sentence where the system gives too little."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from subprocess import CompletedProcess

import pytest

from children import finished
from cli_support import BUILD, FREE, QUICK, RUN, run, write_scene

MARK = "a\x1b[2J\x07\u202eb "
WORD = f"{MARK}kettle"
SCENE = f"{MARK}scene"
BUILT = ("build", SCENE, *QUICK, "--out", f"{MARK}f.scoup", "--model", f"{SCENE}/words.npz")
FIELD = BUILT[-3]
VERBS = {
    "build": (*BUILT, "--overwrite"),
    "info": ("info", FIELD),
    "info, scene": ("info", SCENE),
    "info, words": ("info", f"{SCENE}/words.npz"),
    "query": ("query", FIELD, WORD, "--camera", "all", "--out", "answers"),
    "select": ("select", FIELD, WORD, "--always", "--out", "a.ply"),
    "label": ("label", FIELD, WORD, f"{MARK}mug"),
    "catalog": ("catalog", FIELD),
    "render": ("render", FIELD, "--camera", "all", "--out", f"{MARK}pictures"),
    "regions": ("regions", SCENE, "--view", f"{MARK}view_00", "--out", f"{MARK}a.png"),
    "extract": ("extract", SCENE, *FREE, "--out", f"{MARK}regions"),
    "convert": ("convert", SCENE, f"{MARK}compact"),
    "no such view": ("query", FIELD, WORD, "--camera", "view_99", "--out", "a"),
    "no such word": ("query", FIELD, "zebra", "--out", "a"),
}


@pytest.fixture(scope="module")
def hostile(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a scene and its field; names of files, views and words have control characters."""
    folder = tmp_path_factory.mktemp("terminal")
    write_scene(folder / SCENE, mark=MARK)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        code, _, err = run(*BUILT)
    assert code == 0, err
    return folder


@pytest.mark.parametrize("verb", VERBS)
def test_control_characters_are_escaped(verb: str, hostile: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(hostile)
    code, out, err = run(*VERBS[verb])
    assert code == (2 if verb.startswith("no such") else 0), err
    pages = [path.read_text() for path in hostile.glob("*_catalog/index.html")] if verb == "catalog" else []
    assert len(pages) == (verb == "catalog")
    said = out + err + "".join(pages)
    assert r"a\x1b[2J\x07\u202eb" in said
    assert not [character for character in said if not character.isprintable() and character not in "\n\t"]


@pytest.mark.skipif(sys.platform == "win32", reason="signals of Unix")
def test_an_interruption_before_the_verb_begins_is_no_fault() -> None:
    program = f"""
import os, signal, sys
class Interrupts:
    def find_spec(self, name, *_):
        if name == "scoup.cli.options":
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Interrupts())
{RUN}
"""
    done = finished([sys.executable, "-c", program, "info", "x"])
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")


LIMITED = """
import resource, sys
resource.setrlimit(getattr(resource, sys.argv[1]), (int(sys.argv[2]),) * 2)
sys.argv = ["scoup", *sys.argv[3:]]
"""

LESS_MEMORY = "not enough memory; use fewer or smaller views, or a machine with more"


def limited(limit: str, most: int, *arguments: object) -> CompletedProcess[str]:
    command = [sys.executable, "-c", LIMITED + RUN, limit, most, *arguments]
    # Linear algebra asks for memory per thread, and ends the process itself where it gets none.
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    return finished(command, env=environment)


@pytest.mark.usefixtures("here")
@pytest.mark.skipif(sys.platform != "linux", reason="limits of Linux")
@pytest.mark.parametrize("verb", [
    (*BUILD, "--model", "scene/words.npz"),
    pytest.param(("query", "f.scoup", "kettle", "--out", "o"), marks=pytest.mark.slow),
])  # fmt: skip
def test_sixteen_open_files_are_enough(verb: tuple[str, ...]) -> None:
    done = limited("RLIMIT_NOFILE", 16, *verb)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.usefixtures("here")
@pytest.mark.skipif(sys.platform != "linux", reason="limits of Linux")
@pytest.mark.parametrize(("limit", "most", "said"), [
    ("RLIMIT_NOFILE", 5, "raise the limit of open files (ulimit -n)"),
    ("RLIMIT_AS", 600 << 20, LESS_MEMORY),
    pytest.param("RLIMIT_AS", 300 << 20, LESS_MEMORY, marks=pytest.mark.slow),
])  # fmt: skip
def test_limits_of_the_system_are_one_sentence(limit: str, most: int, said: str) -> None:
    done = limited(limit, most, "query", "f.scoup", "kettle", "--out", "o")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("error: ")
    assert done.stderr.endswith(f"{said}\n")
    assert done.stderr.count("\n") == 1


@pytest.mark.usefixtures("here")
@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="pipes of Unix")
def test_a_photograph_that_is_a_named_pipe_is_skipped() -> None:
    image = Path("scene/images/view_00.png")
    image.unlink()
    os.mkfifo(image)
    code, _, err = run("extract", "scene", *FREE, "--out", "regions")
    assert code == 0
    assert "view_00.png: is a named pipe (FIFO), not an image" in err
