"""The examples run unchanged."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import scoup
from cli_support import run, write_scene

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_scene(tmp_path_factory.mktemp("examples") / "scene")


def example(name: str, *arguments: object) -> str:
    """What an example prints."""
    command = [sys.executable, str(EXAMPLES / name), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_build_and_query(scene):
    printed = example("01_build_and_query.py", scene, scene / "words.npz", "kettle")
    assert printed.count("view_0") == 3
    assert "level" in printed
    assert "Location('kettle'" in printed


def test_cut_out_a_thing(scene, tmp_path):
    field, out = tmp_path / "f.scoup", tmp_path / "kettle.ply"
    assert run("build", scene, "--out", field, "--epochs", 20, "--n-atoms", 8)[0] == 0
    rest = tmp_path / "without.scoup"
    assert "of 150 Gaussians saved" in example(
        "02_cut_out_a_thing.py", field, scene / "words.npz", "kettle", out, rest
    )
    assert out.is_file()
    assert 0 < len(scoup.LanguageField.load(rest)) < 150


def test_rasterise_once_code_often(scene):
    printed = example("03_rasterise_once_code_often.py", scene)
    assert "32 atoms" in printed
    assert "64 atoms" in printed
