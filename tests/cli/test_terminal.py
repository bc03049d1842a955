"""One sentence where the system gives too little, and none where a user stops early."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from subprocess import CompletedProcess

import pytest

from children import finished
from cli_support import BUILD, FREE, RUN, run


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


def limited(limit: str, most: int, *arguments: object) -> CompletedProcess[str]:
    command = [sys.executable, "-c", LIMITED + RUN, limit, most, *arguments]
    # Linear algebra asks for memory per thread, and ends the process itself where it gets none.
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    return finished(command, env=environment)


@pytest.mark.usefixtures("here")
@pytest.mark.skipif(sys.platform != "linux", reason="limits of Linux")
def test_sixteen_open_files_are_enough() -> None:
    done = limited("RLIMIT_NOFILE", 16, *BUILD, "--model", "scene/words.npz")
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.usefixtures("here")
@pytest.mark.skipif(sys.platform != "linux", reason="limits of Linux")
def test_too_little_memory_is_one_sentence() -> None:
    done = limited("RLIMIT_AS", 600 << 20, "query", "f.scoup", "kettle", "--out", "o")
    said = "error: not enough memory; use fewer or smaller views, or a machine with more\n"
    assert (done.returncode, done.stdout, done.stderr) == (2, "", said)


@pytest.mark.usefixtures("here")
@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="pipes of Unix")
def test_a_photograph_that_is_a_named_pipe_is_skipped() -> None:
    image = Path("scene/images/view_00.png")
    image.unlink()
    os.mkfifo(image)
    code, _, err = run("extract", "scene", *FREE, "--out", "regions")
    assert code == 0
    assert "view_00.png: is a named pipe (FIFO), not an image" in err
