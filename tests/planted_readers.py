"""Readers that misbehave on purpose, for the tests of benchmarks/hostile."""

from __future__ import annotations

import os
import signal
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
from benchmarks.hostile.readers import Memory, Reader

from scoup.base.errors import FileFormatError, ScoupWarning

FILE, VALID = "a.planted", b"fine, and long enough to be damaged anywhere"


def write_planted(folder: Path) -> None:
    (folder / FILE).write_bytes(VALID)


def _unless_valid(misbehave: Callable[[Path], object]) -> Reader:
    def read(folder: Path) -> None:
        path = folder / FILE
        if path.read_bytes() != VALID:
            misbehave(path)

    return Reader(FILE, read, memory=Memory(64, 64))


def _loop(path: Path) -> None:
    while True:
        pass


def _take(size: int) -> None:
    np.ones(size, np.uint8)


def _take_and_hide(path: Path) -> None:
    try:
        _take(1 << 30)
    except MemoryError as error:
        raise FileFormatError(path, "is damaged") from error


def _refuse(path: Path) -> None:
    warnings.warn("said beforehand", ScoupWarning, stacklevel=2)
    raise FileFormatError(path, "is damaged")


def _refuse_namelessly(path: Path) -> None:
    raise FileFormatError("somewhere", "is damaged")


def _warn(path: Path) -> None:
    _ = np.float32(1e30) * np.float32(1e30)


def _fail(path: Path) -> None:
    raise ValueError("no refusal")


PLANTED = {
    "good": _unless_valid(_refuse),
    "accepting": _unless_valid(lambda path: None),
    "crash": _unless_valid(lambda path: os.kill(os.getpid(), signal.SIGSEGV)),
    "exit": _unless_valid(lambda path: os._exit(0)),
    "loop": _unless_valid(_loop),
    "sleep": _unless_valid(lambda path: time.sleep(1 << 20)),
    "much": _unless_valid(lambda path: _take(1 << 30)),
    "much, untouched": _unless_valid(lambda path: np.empty(1 << 34, np.uint8)),
    "much, hidden": _unless_valid(_take_and_hide),
    "not so much": _unless_valid(lambda path: _take(40 << 20)),
    "ValueError": _unless_valid(_fail),
    "nameless": _unless_valid(_refuse_namelessly),
    "RuntimeWarning": _unless_valid(_warn),
}
