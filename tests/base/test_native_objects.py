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


def check(folder: Path, *sources: str) -> tuple[bool, str]:
    """Compile the sources; whether the build would go on with them, and what it says."""
    compiler, cmake, nm = tool("c++", "g++", "clang++"), tool("cmake"), tool("nm")
    objects = []
    for i, source in enumerate(sources):
        code, compiled = folder / f"{i}.cpp", folder / f"{i}.o"
        code.write_text(source, encoding="utf-8")
        finished([compiler, "-O2", "-fPIC", "-c", code, "-o", compiled], check=True)
        objects.append(str(compiled))
    command = [cmake, f"-DNM={nm}", f"-DOBJECTS={';'.join(objects)}", "-P", str(CHECK)]
    done = finished(command)
    return done.returncode == 0, " ".join(done.stderr.split())


pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the build checks on Linux only")


def test_a_kernel_of_its_own_namespace_passes(tmp_path):
    assert check(tmp_path, KERNEL) == (True, "")


@pytest.mark.parametrize(("source", "symbol"), [
    pytest.param(SHARED, "_Z4halfi", id="shared"),
    pytest.param(RUNS_AT_LOAD, "_GLOBAL__sub_I", id="runs at load"),
])  # fmt: skip
def test_what_could_reach_another_cpu_is_refused(tmp_path, source, symbol):
    passes, says = check(tmp_path, KERNEL, source)
    assert not passes
    assert "1.o must define nothing outside its own namespace" in says
    assert symbol in says
