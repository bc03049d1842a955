"""Instruction counts of the core's kernels, as a check against slow-downs that no clock on a busy machine would show.

    python tools/count_instructions.py [--update] [--build FOLDER]

Builds native/tests/counted.cpp, runs each of its modes under valgrind, and takes away what only prepares the work.
Fails where a kernel needs over 5 % more than the count in benchmarks/instruction_counts.json. Counts hold for one major
version of a compiler; with another one, or without valgrind, cmake or a compiler, the check is skipped, and says so.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
STORED = ROOT / "benchmarks" / "instruction_counts.json"
MODES = ("project", "alpha", "channels", "regions", "vote", "codes", "cosines", "relevancy", "select")
MARGIN = 0.05


class Skipped(Exception):
    """The check cannot be made here."""


def build(folder: Path) -> Path:
    """Builds the program that is counted; returns its path."""
    if platform.machine() not in ("x86_64", "AMD64"):
        raise Skipped("the stored counts are of x86-64")
    # cmake may be beside the interpreter only.
    os.environ["PATH"] += os.pathsep + str(Path(sys.executable).parent)
    for tool in ("valgrind", "cmake"):
        if shutil.which(tool) is None:
            raise Skipped(f"{tool} is not installed")
    if not any(shutil.which(name) for name in (os.environ.get("CXX", "c++"), "g++", "clang++")):
        raise Skipped("there is no C++ compiler")
    configure = ["cmake", "-S", str(ROOT / "native"), "-B", str(folder), "-DSCOUP_TESTS=ON"]
    done = subprocess.run(configure, capture_output=True, text=True)
    if done.returncode != 0:
        sys.exit(done.stderr)
    done = subprocess.run(
        ["cmake", "--build", str(folder), "--target", "counted", "--parallel", "2"],
        capture_output=True,
        text=True,
    )
    if done.returncode != 0:
        sys.exit(done.stdout + done.stderr)
    return folder / "counted"


def count(program: Path, mode: str, repetitions: int) -> int:
    """Instructions of the whole run of a mode."""
    done = subprocess.run(
        ["valgrind", "--tool=callgrind", "--callgrind-out-file=/dev/null"]
        + [str(program), mode, str(repetitions)],
        capture_output=True,
        text=True,
    )
    if done.returncode != 0:
        sys.exit(done.stderr)
    if not done.stdout.startswith("v3:"):
        raise Skipped(f"the stored counts are of instruction set v3; here it is {done.stdout.split(':')[0]}")
    found = re.search(r"Collected : (\d+)", done.stderr)
    if found is None:
        sys.exit(f"valgrind printed no count:\n{done.stderr}")
    return int(found[1])


def major(compiler: str) -> str:
    """Name and major version: counts hold for these."""
    return compiler.split(".")[0]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--update", action="store_true", help="store what is counted now")
    parser.add_argument("--build", type=Path, default=ROOT / "build" / "counted", help="where to build")
    arguments = parser.parse_args()
    try:
        sys.exit(check(arguments.build, arguments.update))
    except Skipped as reason:
        print(f"Instruction counts are not checked: {reason}.")


def check(folder: Path, update: bool) -> int:
    """Counts, prints a table, compares or stores; returns the exit status."""
    program = build(folder)
    compiler = subprocess.run(
        [str(program), "compiler"], capture_output=True, text=True, check=True
    ).stdout.strip()
    stored = json.loads(STORED.read_text()) if STORED.exists() else None
    if not update:
        if stored is None:
            raise Skipped(f"{STORED.relative_to(ROOT)} is not there; --update makes it")
        if major(stored["compiler"]) != major(compiler):
            raise Skipped(f"the stored counts are of {stored['compiler']}, this is {compiler}")
    prepare = count(program, MODES[0], 0)
    counts = {mode: count(program, mode, 1) - prepare for mode in MODES}
    before = stored["instructions"] if stored else {}
    print(f"| kernel | million instructions | stored | change | (compiler: {compiler})\n|---|--:|--:|--:|")
    failed = []
    for mode, now in counts.items():
        if mode not in before:
            print(f"| {mode} | {now / 1e6:.2f} | | |")
            failed.append(f"{mode} has no stored count")
            continue
        change = now / before[mode] - 1
        print(f"| {mode} | {now / 1e6:.2f} | {before[mode] / 1e6:.2f} | {change:+.1%} |")
        if change > MARGIN:
            failed.append(f"{mode} needs {change:.1%} more instructions than stored")
    if update:
        STORED.write_text(json.dumps({"compiler": compiler, "instructions": counts}, indent=2) + "\n")
        return 0
    for failure in failed:
        print(f"{failure}; at most {MARGIN:.0%} are allowed. If it is meant: --update.")
    return 1 if failed else 0


if __name__ == "__main__":
    main()
