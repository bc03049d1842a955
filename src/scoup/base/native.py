"""The compiled core: loaded when first used; where there is none, why, and the remedy.

The environment variable ``SCOUP_NATIVE`` decides what is used: ``off`` counts the core as absent; ``baseline``, ``v3``
or ``v4`` takes that instruction set (x86-64-v2, v3, v4) instead of the best one that the CPU has.
"""

from __future__ import annotations

import functools
import importlib
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import NamedTuple

from scoup.base.errors import InputError, warn_once

_MODULE = "scoup._native"
_INSTRUCTION_SETS = ("baseline", "v3", "v4")
_COMPILERS = {
    "linux": "Debian and Ubuntu: apt install g++ python3-dev; Fedora: dnf install gcc-c++ python3-devel",
    "darwin": "xcode-select --install",
    "win32": "clang-cl, from the installer of Visual Studio, and the variable CMAKE_GENERATOR_TOOLSET=ClangCL",
}
# Without --no-cache-dir, pip might take the wheel it built without a compiler.
_AGAIN = (
    "install scoup again (in a checkout: python3 tools/install.py; "
    "elsewhere: pip install --force-reinstall --no-deps --no-cache-dir scoup)"
)


class LoadedCore(NamedTuple):
    """The compiled core, or why there is none."""

    core: ModuleType | None
    reason: str | None  # why there is no core
    wanted: bool = True  # the user did not switch it off


def native_core() -> ModuleType | None:
    """Return the module ``scoup._native``, or None where it was not built, does not load, or is switched off."""
    return load_core().core


@contextmanager
def required_core() -> Iterator[ModuleType]:
    """Yield the module ``scoup._native``. Its errors become InputError: what it refuses is the caller's mistake."""
    core, reason, _ = load_core()
    if core is None:
        raise InputError(f"the compiled core cannot be used: {reason}")
    try:
        yield core
    except (ValueError, IndexError) as error:
        raise InputError(str(error)) from None


def missing_reason() -> str | None:
    """Return a sentence: why there is no compiled core, and the remedy. None if there is one."""
    return load_core().reason


def warn_if_missing() -> None:
    """Warn once in the life of the process that slower code serves. Silent if SCOUP_NATIVE is off."""
    loaded = load_core()
    if loaded.core is None and loaded.wanted:
        warn_once(f"slower code serves: {loaded.reason}")


@functools.cache
def load_core() -> LoadedCore:
    """Load the core, as SCOUP_NATIVE says; the answer is remembered (``load_core.cache_clear`` forgets it)."""
    setting = os.environ.get("SCOUP_NATIVE", "")
    if setting == "off":
        return LoadedCore(
            None, "the compiled core is switched off; unset SCOUP_NATIVE to use it", wanted=False
        )
    if setting not in ("", *_INSTRUCTION_SETS):
        choices = ", ".join(("off", *_INSTRUCTION_SETS))
        raise InputError(f"SCOUP_NATIVE is {setting!r}; set it to one of {choices}, or unset it")
    try:
        core = importlib.import_module(_MODULE)
    except ModuleNotFoundError as error:
        if error.name != _MODULE:
            return LoadedCore(None, _broken(error))
        how = f" ({_COMPILERS[sys.platform]})" if sys.platform in _COMPILERS else ""
        return LoadedCore(
            None, f"the compiled core was not built; install a C++ compiler{how}, then {_AGAIN}"
        )
    except ImportError as error:
        return LoadedCore(None, _broken(error))
    if setting and not core.use_isa(setting):
        raise InputError(
            f"SCOUP_NATIVE is {setting!r}, but this CPU or this build has no such instruction set; unset it"
        )
    return LoadedCore(core, None)


def _broken(error: ImportError) -> str:
    return f"the compiled core does not load ({' '.join(str(error).split())}); {_AGAIN}"
