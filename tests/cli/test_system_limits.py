"""One sentence where the system gives too little."""

from __future__ import annotations

import os
import sys
from subprocess import CompletedProcess

import pytest

from children import finished
from cli_support import BUILD, RUN

pytestmark = [
    pytest.mark.usefixtures("here"),
    pytest.mark.skipif(sys.platform != "linux", reason="limits of Linux"),
]
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


def test_sixteen_open_files_are_enough() -> None:
    done = limited("RLIMIT_NOFILE", 16, *BUILD, "--model", "scene/words.npz")
    assert (done.returncode, done.stderr) == (0, "")


def test_too_little_memory_is_one_sentence() -> None:
    done = limited("RLIMIT_AS", 600 << 20, "query", "f.scoup", "kettle", "--out", "o")
    said = "error: not enough memory; use fewer or smaller views, or a machine with more\n"
    assert (done.returncode, done.stdout, done.stderr) == (2, "", said)
