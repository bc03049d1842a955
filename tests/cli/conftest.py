"""A scene and its field, built once, and a copy of both for every test."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from cli_support import QUICK, run_json, write_scene


@pytest.fixture(scope="session")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with ``scene`` and its field ``f.scoup``; nobody writes into it."""
    folder = tmp_path_factory.mktemp("cli")
    write_scene(folder / "scene")
    table = folder / "scene" / "words.npz"
    run_json("build", folder / "scene", *QUICK, "--out", folder / "f.scoup", "--model", table)
    return folder


@pytest.fixture(autouse=True)
def _quick_choices(few_candidates: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Few cameras of a splat alone, and in small photographs of noise few regions, not one a pixel."""
    monkeypatch.setattr("scoup.extract.felzenszwalb._REFERENCE", 10_000)


@pytest.fixture
def here(original: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder: a copy of ``original``."""
    folder = tmp_path / "here"
    shutil.copytree(original, folder)
    monkeypatch.chdir(folder)
    return folder
