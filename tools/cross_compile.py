"""Compile the core for the systems that are not at hand: does it compile, link and, where something emulates them, run?

    python tools/cross_compile.py [TARGET ...] [--headers FOLDER] [--rounds 20] [--out build/cross]

Needs the PyPI packages ziglang, nanobind, cmake and ninja; a target whose compiler is not there is left out, and the
table says so. The core and the programs in native/tests/ are built as native/CMakeLists.txt says, then the files that
know Python are compiled with the headers of this Python, or of another one in a folder; those of 3.12 or newer also for
the stable interface. Programs are run by qemu-aarch64 and wine. clang as clang-cl compiles the kernels for Windows with
Microsoft's conventions. Nothing here needs the real systems, so it proves less than they do: no compiler or library of
Apple or Microsoft is used, and Python's headers are those of Linux.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import re
import shutil
import stat
import subprocess
import sys
import sysconfig
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SOURCES = ROOT / "native" / "src"
OLDEST_STABLE = (3, 12)
"""The oldest Python whose stable interface nanobind can use."""
HEADERS = {
    "stdlib.h": 'extern "C" { void* malloc(__SIZE_TYPE__); void free(void*); }',
    "malloc.h": 'extern "C" { void* _aligned_malloc(__SIZE_TYPE__, __SIZE_TYPE__); void _aligned_free(void*); }',
    "cstdint": "#include <stdint.h>",
    "cstddef": "#include <stddef.h>\nnamespace std { using ::size_t; }",
    "cfloat": "#include <float.h>",
}
"""Stand-ins for the headers of Microsoft that the kernels include."""
LIMIT = 1500
"""Seconds for one program."""
ZIG = (sys.executable, "-m", "ziglang")


@dataclass(frozen=True)
class Target:
    """A system to compile for.

    Attributes:
        name: as given on the command line.
        compiler: the command, or nothing where zig is the compiler.
        zig: what zig calls the system.
        cmake: settings of CMake beside the compiler.
        runner: the program that runs what was built; nothing where it is not run.
        ending: of programs.
        parts: what CMake builds; nothing for everything, with the programs.
    """

    name: str
    zig: str = ""
    compiler: str = ""
    cmake: tuple[str, ...] = ()
    runner: str | None = None
    ending: str = ""
    parts: tuple[str, ...] = ()


def _system(name: str, processor: str) -> tuple[str, ...]:
    return (f"-DCMAKE_SYSTEM_NAME={name}", f"-DCMAKE_SYSTEM_PROCESSOR={processor}")


_WINDOWS = (*_system("Windows", "AMD64"), "-DCMAKE_EXE_LINKER_FLAGS=-static")
_MAC_TOOLS = ("-DCMAKE_INSTALL_NAME_TOOL=true", "-DCMAKE_OSX_SYSROOT=/")
TARGETS = (
    Target("linux-x86_64", zig="x86_64-linux-gnu.2.17", runner=""),
    Target("linux-aarch64", zig="aarch64-linux-gnu.2.17", cmake=_system("Linux", "aarch64")),
    # Linked whole, so that the emulator needs no libraries of that system.
    Target(
        "linux-aarch64-static",
        zig="aarch64-linux-musl",
        cmake=(*_system("Linux", "aarch64"), "-DCMAKE_EXE_LINKER_FLAGS=-static"),
        runner="qemu-aarch64",
    ),
    Target("macos-arm64", zig="aarch64-macos.11.0", cmake=(*_system("Darwin", "arm64"), *_MAC_TOOLS)),
    Target("macos-x86_64", zig="x86_64-macos.11.0", cmake=(*_system("Darwin", "x86_64"), *_MAC_TOOLS)),
    Target("windows-zig", zig="x86_64-windows-gnu", cmake=_WINDOWS, runner="wine", ending=".exe"),
    # Not run: GCC does not align the stack of 64-bit Windows for vectors of 32 bytes.
    Target("windows-mingw", compiler="x86_64-w64-mingw32-g++-posix", cmake=_WINDOWS, ending=".exe"),
    # Kernels only: the rest needs Microsoft's library of C++.
    Target(
        "windows-msvc",
        compiler="clang",
        cmake=(*_system("Windows", "AMD64"), "-DCMAKE_TRY_COMPILE_TARGET_TYPE=STATIC_LIBRARY"),
        parts=("scoup_kernels_baseline", "scoup_kernels_v3", "scoup_kernels_v4"),
    ),
)


class Failed(Exception):
    """A step did not work; the text is what the tool said."""


@dataclass(frozen=True)
class Row:
    """What became of a target; each is one word or a reason."""

    target: str
    core: str
    python: str
    run: str


def call(command: list[str], folder: Path = ROOT) -> str:
    """Runs a command; returns all that it printed.

    Raises:
        Failed: it failed, or took too long.
    """
    environment = {**os.environ, "WINEDEBUG": "-all"}
    try:
        done = subprocess.run(
            command, cwd=folder, env=environment, timeout=LIMIT, text=True, errors="replace",
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL,
        )  # fmt: skip
    except (OSError, subprocess.TimeoutExpired) as error:
        raise Failed(str(error)) from error
    if done.returncode != 0:
        raise Failed(f"{' '.join(command)}\n{done.stdout[-6000:]}")
    return done.stdout


def compiler_of(target: Target, tools: Path) -> list[str] | None:
    """The command of a target's C++ compiler; None where it is not installed."""
    if target.name == "windows-msvc":
        return clang_cl(tools) if shutil.which("clang") else None
    if target.compiler:
        found = shutil.which(target.compiler)
        return [found] if found else None
    if importlib.util.find_spec("ziglang") is None:
        return None
    return [str(script(tools / f"{target.name}-c++", [*ZIG, "c++", "-target", target.zig]))]


def clang_cl(tools: Path) -> list[str]:
    """clang as clang-cl, with stand-ins for Microsoft's headers."""
    folder = tools / "msvc"
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in HEADERS.items():
        (folder / name).write_text(f"#pragma once\n{text}\n", encoding="utf-8")
    options = ["--driver-mode=cl", "--target=x86_64-pc-windows-msvc", "-fms-compatibility-version=19.40"]
    return [str(script(tools / "clang-cl", ["clang", *options, "-imsvc", str(folder)]))]


def script(path: Path, command: list[str]) -> Path:
    """A program of one word that runs a command: CMake wants such ones."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(
        "#!/bin/sh\nexec " + " ".join(f"'{word}'" for word in command) + ' "$@"\n', encoding="utf-8"
    )
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return path


def build_core(target: Target, compiler: list[str], out: Path) -> Path:
    """Builds core and test programs; returns the folder they are in.

    Raises:
        Failed: with what the compiler said.
    """
    folder = out / target.name
    settings = ["-DSCOUP_TESTS=ON", f"-DCMAKE_CXX_COMPILER={compiler[0]}", *target.cmake]
    if target.zig:
        for tool in ("ar", "ranlib"):
            settings.append(f"-DCMAKE_{tool.upper()}={script(out / 'tools' / tool, [*ZIG, tool])}")
    if target.parts:
        named = {"AR": "llvm-lib", "LINKER": "lld-link", "RC_COMPILER": "llvm-rc", "MT": "llvm-mt"}
        settings += [f"-DCMAKE_{role}={shutil.which(tool)}" for role, tool in named.items()]
    call(["cmake", "-S", str(ROOT / "native"), "-B", str(folder), "-G", "Ninja", *settings])
    wanted = ["--target", *target.parts] if target.parts else []
    printed = call(["cmake", "--build", str(folder), "--parallel", "4", *wanted])
    warnings = re.findall(r"^.*native/.*warning: .*$", printed, re.MULTILINE)
    for warning in warnings:
        print(f"{target.name}: {warning}")
    return folder


def compile_bindings(target: Target, compiler: list[str], headers: Path, out: Path) -> str:
    """Compiles what knows Python, and nanobind itself; returns for which interfaces.

    Raises:
        Failed: with what the compiler said.
    """
    spec = importlib.util.find_spec("nanobind")
    if spec is None or spec.origin is None:
        return "nanobind is not installed"
    nanobind = Path(spec.origin).parent
    folders = [headers, nanobind / "include", nanobind / "ext" / "robin_map" / "include", SOURCES]
    flags = ["-std=c++17", "-O1", "-c", "-include", "cstdio", *(f"-I{folder}" for folder in folders)]
    if "windows" not in target.name:
        flags += ["-fPIC"]
    version = header_version(headers)
    interfaces = {f"{version[0]}.{version[1]}": []}
    if version >= OLDEST_STABLE:
        interfaces["stable"] = ["-DPy_LIMITED_API=0x030C0000"]
    for name, define in interfaces.items():
        for source in [*sorted(SOURCES.glob("bindings*.cpp")), nanobind / "src" / "nb_combined.cpp"]:
            to = out / target.name / f"{name}-{source.stem}.o"
            nanobinds = ["-fno-strict-aliasing", "-w"] if source.is_relative_to(nanobind) else []
            call([*compiler, *flags, *define, *nanobinds, str(source), "-o", str(to)])
    return " and ".join(interfaces)


def header_version(headers: Path) -> tuple[int, int]:
    """Of the Python whose headers these are.

    Raises:
        Failed: there are none.
    """
    try:
        text = (headers / "patchlevel.h").read_text(encoding="utf-8")
    except OSError as error:
        raise Failed(f"Python's headers are not in {headers}; give their folder by --headers") from error
    major, minor = (re.search(rf"#define PY_{part}_VERSION\s+(\d+)", text) for part in ("MAJOR", "MINOR"))
    if major is None or minor is None:
        raise Failed(f"{headers / 'patchlevel.h'} does not say a version")
    return int(major[1]), int(minor[1])


def run_programs(target: Target, folder: Path, rounds: int) -> str:
    """Runs what was built; returns one word, or why it was not run.

    Raises:
        Failed: with what a program printed.
    """
    if target.runner is None:
        return "not run"
    runner = [target.runner] if target.runner else []
    if runner and shutil.which(runner[0]) is None:
        return f"not run: {runner[0]} is not installed"
    said = []
    for program in (("test_isa",), ("fuzz", str(rounds)), ("counted",)):
        printed = call([*runner, str(folder / f"{program[0]}{target.ending}"), *program[1:]])
        said.append(printed.strip().splitlines()[-1].strip())
    return "; ".join(said[:2])


def check(target: Target, options: argparse.Namespace) -> Row | None:
    """One row of the table; None where the compiler is not installed."""
    compiler = compiler_of(target, options.out / "tools")
    if compiler is None:
        return None
    folder = build_core(target, compiler, options.out)
    if target.parts:
        return Row(target.name, "kernels compiled", "not compiled", "not run")
    python = compile_bindings(target, compiler, options.headers, options.out)
    return Row(target.name, "linked", python, run_programs(target, folder, options.rounds))


def main(arguments: list[str] | None = None) -> int:
    """Returns the exit code: 1 where a target failed, or none could be tried."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("targets", nargs="*", metavar="TARGET", help=", ".join(each.name for each in TARGETS))
    parser.add_argument(
        "--headers", type=Path, default=Path(sysconfig.get_paths()["include"]), help="of Python"
    )
    parser.add_argument("--rounds", type=int, default=20, help="of the fuzzing where programs are run")
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "cross", help="where to build")
    options = parser.parse_args(arguments)
    options.out = options.out.resolve()
    unknown = set(options.targets) - {each.name for each in TARGETS}
    if unknown:
        parser.error(f"there is no target {sorted(unknown)[0]}")
    # cmake and ninja may be beside the interpreter only.
    os.environ["PATH"] = os.pathsep.join(
        [str(Path(sys.executable).parent), os.environ.get("PATH", os.defpath)]
    )
    status, tried = 0, 0
    print("| target | core | files that know Python | run |\n|---|---|---|---|")
    for target in TARGETS:
        if options.targets and target.name not in options.targets:
            continue
        try:
            row = check(target, options)
        except Failed as failure:
            print(f"| {target.name} | failed | | |\n{failure}", flush=True)
            status = 1
            continue
        tried += row is not None
        row = row or Row(target.name, "left out: its compiler is not installed", "", "")
        print(f"| {row.target} | {row.core} | {row.python} | {row.run} |", flush=True)
    return status or int(tried == 0)


if __name__ == "__main__":
    sys.exit(main())
