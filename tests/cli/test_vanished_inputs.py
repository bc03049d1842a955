"""Inputs that vanish in the midst of the work: one sentence that names the file, and nothing is lost.

A file vanishes at the moment at which the verb opens it, for the first time or a later one.
"""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import safetensors
import torch

from cli_support import FREE, QUICK, plain_photographs, run, snapshot
from scoup.io import load_gaussians, save_gaussians
from scoup.uplift.storage.array_file import view_file

PLY, CAMERAS, IMAGES = "scene/point_cloud.ply", "scene/sparse/0/cameras.bin", "scene/sparse/0/images.bin"
LABELS, ROWS = "scene/language_features/view_02_s.npy", "scene/language_features/view_02_f.npy"
LAST_LABELS = "scene/language_features/view_03_s.npy"
PHOTO = "scene/images/view_02.png"
SUMS = view_file("view_01.png")
GONE = "disappeared while being read; restore it and retry"
OUT = ("--out", "a.scoup", "--overwrite")


@dataclass(frozen=True)
class Verb:
    """A verb, the files it reads, and the outputs that are there already and stay as they are after an error."""

    arguments: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]


VERBS = {
    "build": Verb(("build", "scene", *QUICK, *OUT, "--keep-sums", "a.sums"),
                  (PLY, CAMERAS, IMAGES, LABELS, ROWS, PHOTO), ("a.scoup",)),
    "build --part": Verb(("build", "scene", "--keep-sums", "a.sums", "--part", "1/2"),
                         (PLY, IMAGES, LABELS, ROWS), ()),
    "build --sums": Verb(("build", "scene", *QUICK, *OUT, "--sums", "kept.sums"),
                         (PLY, f"kept.sums/{SUMS}", LABELS, ROWS), ("a.scoup",)),
    "build --codebook": Verb(("build", "scene", *QUICK, *OUT, "--keep-sums", "few.sums", "--codebook", "kept.scoup"),
                             ("kept.scoup", f"few.sums/{SUMS}", LAST_LABELS), ("a.scoup",)),
    "transfer": Verb(("transfer", "kept.scoup", "edited.ply", *OUT), ("kept.scoup", "edited.ply", PLY), ("a.scoup",)),
    "extract": Verb(("extract", "photographs", *FREE, "--out", "regions"), ("photographs/view_02.png",), ()),
}  # fmt: skip
CASES = [(name, file) for name, verb in VERBS.items() for file in verb.inputs]
FIRST_READER = {file: name for name, file in reversed(CASES)}
"""Of each file the verb with which every run of the tests tries it; with the others `make test-all` does."""


class Doors:
    """Told of every file that is opened for reading, by its path."""

    listener: Callable[[str], None] | None = None

    @classmethod
    def audit(cls, event: str, arguments: tuple[Any, ...]) -> None:
        if cls.listener is None or event != "open" or not isinstance(arguments[0], (str, os.PathLike)):
            return
        if not (isinstance(arguments[2], int) and arguments[2] & (os.O_WRONLY | os.O_RDWR)):
            cls.listener(os.path.abspath(arguments[0]))


@pytest.fixture(scope="module", autouse=True)
def listening() -> None:
    sys.addaudithook(Doors.audit)  # none can be removed; without a listener it does nothing


@pytest.fixture
def fields_are_heard(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fields and region sums are opened by compiled code, which says nothing."""

    def heard(opened: Callable[..., Any]) -> Callable[..., Any]:
        def heard(path: Any, *more: Any, **how: Any) -> Any:
            if Doors.listener is not None:
                Doors.listener(os.path.abspath(path))
            return opened(path, *more, **how)

        return heard

    monkeypatch.setattr(safetensors, "safe_open", heard(safetensors.safe_open))
    monkeypatch.setattr(torch, "from_file", heard(torch.from_file))


@contextmanager
def vanishing(file: str, time: int) -> Iterator[list[str]]:
    """Within the block a file moves away when it is opened so many times; gives all openings of it."""
    path, opened = os.path.abspath(file), []

    def listen(name: str) -> None:
        if name == path:
            opened.append(name)
            if len(opened) == time:
                os.rename(path, path + "_away")

    Doors.listener = listen
    try:
        yield opened
    finally:
        Doors.listener = None
        if os.path.exists(path + "_away"):
            os.rename(path + "_away", path)


@pytest.fixture(scope="module")
def begun(original: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with all that the verbs begin with."""
    folder = tmp_path_factory.mktemp("vanished") / "begun"
    shutil.copytree(original, folder)
    before = Path.cwd()
    os.chdir(folder)
    try:
        plain_photographs("photographs")
        save_gaussians(load_gaussians(PLY).select(slice(5, None)), "edited.ply")
        code, _, err = run("build", "scene", *QUICK, "--keep-sums", "kept.sums", "--out", "kept.scoup")
        assert code == 0, err
        shutil.copytree("kept.sums", "few.sums")
        for number in (2, 3):
            (Path("few.sums") / view_file(f"view_0{number}.png")).unlink()
        Path("a.scoup").write_text("a.scoup of before")
    finally:
        os.chdir(before)
    return folder


@pytest.fixture
def start(begun: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[], dict[str, bytes]]:
    """Makes the current folder a new copy of ``begun``, and gives what is in it."""

    def start() -> dict[str, bytes]:
        here = tmp_path / "here"
        monkeypatch.chdir(tmp_path)
        shutil.rmtree(here, ignore_errors=True)
        shutil.copytree(begun, here)
        monkeypatch.chdir(here)
        return snapshot(here)

    return start


@pytest.mark.usefixtures("fields_are_heard")
@pytest.mark.parametrize(
    ("name", "file"),
    [
        pytest.param(name, file, marks=() if FIRST_READER[file] == name else pytest.mark.slow)
        for name, file in CASES
    ],
)
def test_inputs_that_vanish(start: Callable[[], dict[str, bytes]], name: str, file: str) -> None:
    verb = VERBS[name]
    before = start()
    with vanishing(file, time=0) as opened:
        assert run(*verb.arguments)[0] == 0
    wanted = snapshot(Path())
    count = len(opened)
    assert count
    for time in sorted({1, count}):
        start()
        with vanishing(file, time):
            code, _, err = run(*verb.arguments)
        left = snapshot(Path())
        if code == 0:  # it was read already, or can be left out
            assert left == wanted or ("warning: " in err and Path(file).name in err), err
            continued = ""
        else:
            continued = check_refused(verb, file, code, err, before, left)
        code, out, err = run(*verb.arguments)
        assert code == 0, err
        assert continued in out
        assert snapshot(Path()) == wanted


def of_outputs(files: dict[str, bytes], verb: Verb) -> dict[str, bytes]:
    return {path: content for path, content in files.items() if Path(path).parts[0] in verb.outputs}


def check_refused(
    verb: Verb, file: str, code: int, err: str, before: dict[str, bytes], left: dict[str, bytes]
) -> str:
    """Check an end by a file that is gone; what the next run must say."""
    *warnings, said = err.splitlines()
    assert code == 2
    assert all(line.startswith("warning: ") for line in warnings), err
    assert said.startswith("error: ")
    assert Path(file).name in said
    assert Path(file).suffix == ".png" or said.endswith(GONE)
    assert of_outputs(left, verb) == of_outputs(before, verb)
    kept = sorted(set(left) - set(before))
    assert all(Path(path).parts[0].endswith(".sums") for path in kept), kept
    assert {path: content for path, content in left.items() if path not in kept} == before
    views = [path for path in left if kept and path.startswith(f"{Path(kept[0]).parts[0]}/view.")]
    return f"contains {len(views)} view" if views else ""
