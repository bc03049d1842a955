"""The check that the build makes of its kernels refuses what could break on an older CPU."""

from __future__ import annotations

import shutil
import sys
import sysconfig
from pathlib import Path

import pytest

from children import finished

CHECK = Path(__file__).resolve().parents[2] / "native" / "check_kernel_objects.cmake"

KERNEL = """
namespace v3 {
namespace { inline int twice(int x) { return 2 * x; } }
extern int (*const table)(int);
int (*const table)(int) = twice;
}
"""
SHARED = "inline int half(int x) { return x / 2; } int (*shared())(int) { return half; }"
RUNS_AT_LOAD = "int ask(); namespace { const int answer = ask(); } const int* where() { return &answer; }"


def tool(*names: str) -> str:
    """The path of the first of these programs that is installed."""
    scripts = sysconfig.get_path("scripts")
    for name in names:
        if found := shutil.which(name) or shutil.which(name, path=scripts):
            return found
    pytest.skip(f"needs {' or '.join(names)}")


def check(folder: Path, *sources: str) -> str:
    """Compile the sources; what the build says against them."""
    compiler, cmake, nm = tool("c++", "g++", "clang++"), tool("cmake"), tool("nm")
    objects = []
    for i, source in enumerate(sources):
        code, compiled = folder / f"{i}.cpp", folder / f"{i}.o"
        code.write_text(source, encoding="utf-8")
        finished([compiler, "-O2", "-fPIC", "-c", code, "-o", compiled], check=True)
        objects.append(str(compiled))
    done = finished([cmake, f"-DNM={nm}", f"-DOBJECTS={';'.join(objects)}", "-P", CHECK])
    assert bool(done.returncode) == bool(done.stderr)
    return " ".join(done.stderr.split())


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the build checks on Linux only")
def test_what_could_reach_another_cpu_is_refused(tmp_path):
    assert check(tmp_path, KERNEL) == ""  # of its own namespace
    for source, symbol in ((SHARED, "_Z4halfi"), (RUNS_AT_LOAD, "_GLOBAL__sub_I")):
        said = check(tmp_path, KERNEL, source)
        assert "1.o must define nothing outside its own namespace" in said
        assert symbol in said
