"""Inputs that vanish in the midst of the work, as a build opens them for the last time: one sentence, nothing lost."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from cli_support import BUILD, run, snapshot

FILES = (
    "point_cloud.ply", "sparse/0/cameras.bin", "language_features/view_02_s.npy", "language_features/view_02_f.npy",
    "images/view_02.png",
)  # fmt: skip
heard: Callable[[str], None] | None = None


def hear(event: str, arguments: tuple[Any, ...]) -> None:
    """Tell of every file that is opened for reading."""
    if heard is None or event != "open" or not isinstance(arguments[0], (str, os.PathLike)):
        return
    if not (isinstance(arguments[2], int) and arguments[2] & (os.O_WRONLY | os.O_RDWR)):
        heard(os.path.abspath(arguments[0]))


@pytest.fixture(scope="module", autouse=True)
def hearing() -> None:
    sys.addaudithook(hear)  # none can be removed; where nobody hears, it does nothing


@contextmanager
def vanishing(file: Path, time: int) -> Iterator[list[str]]:
    """Within the block a file moves away when it is opened so many times; gives all openings of it."""
    global heard
    opened, away = [], file.with_name("away")

    def listen(name: str) -> None:
        if name == os.path.abspath(file):
            opened.append(name)
            if len(opened) == time:
                file.rename(away)

    heard = listen
    try:
        yield opened
    finally:
        heard = None
        if away.exists():
            away.rename(file)


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("name", FILES)
def test_inputs_that_vanish(name: str) -> None:
    file = Path("scene", name)
    with vanishing(file, time=0) as opened:
        assert run(*BUILD)[0] == 0
    assert opened
    before = snapshot(Path())
    with vanishing(file, len(opened)):
        code, _, err = run(*BUILD, "--overwrite")
    assert snapshot(Path()) == before  # the same field where the file was read already, else that of before
    if name == "images/view_02.png":  # which a build can do without
        assert code == 0
    else:
        assert (code, err) == (
            2,
            f"error: scene/{name}: disappeared while being read; restore it and retry\n",
        )
