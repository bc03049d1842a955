"""Inputs that vanish in the midst of the work, as the verb opens them for the last time: one sentence, nothing lost."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
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
BUILD = ("build", "scene", *QUICK, "--out", "a.scoup", "--overwrite")
VERBS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "build": ((*BUILD, "--keep-sums", "a.sums"), (PLY, CAMERAS, IMAGES, LABELS, ROWS, PHOTO)),
    "build --part": (("build", "scene", "--keep-sums", "a.sums", "--part", "1/2"), (PLY, LABELS)),
    "build --sums": ((*BUILD, "--sums", "kept.sums"), (f"kept.sums/{SUMS}", ROWS)),
    "build --codebook": ((*BUILD, "--keep-sums", "few.sums", "--codebook", "kept.scoup"),
                         ("kept.scoup", f"few.sums/{SUMS}", LAST_LABELS)),
    "transfer": (("transfer", "kept.scoup", "edited.ply", "--out", "a.scoup", "--overwrite"),
                 ("kept.scoup", "edited.ply", PLY)),
    "extract": (("extract", "photographs", *FREE, "--out", "regions"), ("photographs/view_02.png",)),
}  # fmt: skip
"""Verbs, and files that they read."""


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


@pytest.mark.usefixtures("fields_are_heard")
@pytest.mark.parametrize(("name", "file"), [(name, file) for name in VERBS for file in VERBS[name][1]])
def test_inputs_that_vanish(
    begun: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, file: str
) -> None:
    verb, _ = VERBS[name]
    monkeypatch.chdir(shutil.copytree(begun, tmp_path / "whole"))
    with vanishing(file, time=0) as opened:
        assert run(*verb)[0] == 0
    assert opened
    wanted = snapshot(Path())
    monkeypatch.chdir(shutil.copytree(begun, tmp_path / "here"))
    before = snapshot(Path())
    with vanishing(file, len(opened)):
        code, _, err = run(*verb)
    left, said = snapshot(Path()), err.splitlines()
    if code == 0:  # it was read already, or can be left out
        assert left == wanted or any(
            line.startswith("warning: ") and Path(file).name in line for line in said
        )
        return
    assert code == 2
    assert said[-1].startswith("error: ")
    assert Path(file).name in said[-1]
    assert file.endswith(".png") or said[-1].endswith("disappeared while being read; restore it and retry")
    assert all(line.startswith("warning: ") for line in said[:-1]), err
    assert {path: left.pop(path) for path in before} == before
    assert all(Path(path).parts[0].endswith(".sums") for path in left), "only complete sums are kept"
