"""Every input of build and query, damaged at random: the verb does its work or says what is wrong."""

from __future__ import annotations

import shutil
from pathlib import Path
from random import Random

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.fuzzing.mutation import damage

from cli_support import run, snapshot, warned, write_scene
from support import examples

BUILD = ("--n-atoms", "4", "--k", "4", "--quiet", "--overwrite")
BUILT_FROM = {
    "splat": "point_cloud.ply", "cameras": "sparse/0/cameras.bin", "images": "sparse/0/images.bin",
    "labels": "language_features/view_01_s.npy", "embeddings": "language_features/view_01_f.npy",
    "photograph": "images/view_01.png", "table": "words.npz",
}  # fmt: skip
ASKED_FROM = {"field": "f.scoup", "splat": "point_cloud.ply", "table": "words.npz"}
many = settings(
    max_examples=examples(25),
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene with its field inside."""
    folder = write_scene(tmp_path_factory.mktemp("sound") / "scene", count=40, views=2)
    out = folder / "f.scoup"
    warned("build", folder, *BUILD, "--out", out, "--model", folder / "words.npz", "--embed-geometry")
    return folder


def check(folder: Path, named: Path, *arguments: object) -> None:
    """The verb ends with 0 or 2, says why in one line with a path, and leaves no rubbish."""
    before = snapshot(folder)
    code, _, err = run(*arguments)  # anything raised fails the test
    assert code in (0, 2), err
    errors = [line for line in err.splitlines() if not line.startswith("warning: ")]
    assert len(errors) == (1 if code else 0), err
    assert all(line.startswith("error: ") and named.name in line and len(line) < 600 for line in errors), err
    if code:
        assert snapshot(folder) == before
    assert not list(folder.rglob(".scoup-*"))


@pytest.mark.parametrize(
    ("verb", "target"), [*(("build", of) for of in BUILT_FROM), *(("query", of) for of in ASKED_FROM)]
)
@many
@given(seed=st.integers(0, 2**31))
def test_verbs(sound, tmp_path, verb, target, seed):
    scene = tmp_path / "scene"
    shutil.copytree(sound, scene, dirs_exist_ok=True)
    file = scene / (BUILT_FROM if verb == "build" else ASKED_FROM)[target]
    file.write_bytes(damage(Random(seed), file.read_bytes()))
    if verb == "build":
        build = ("build", scene, *BUILD, "--out", tmp_path / "a.scoup", "--model", scene / "words.npz")
        check(tmp_path, scene, *build)
        return
    # The field has its geometry embedded, so the splat is read only where it is named.
    given = ("--gaussians", file) if target == "splat" else ()
    ask = ("query", scene / "f.scoup", "kettle", "--out", tmp_path / "answers", *given)
    check(tmp_path, file, *ask, "--quiet", "--overwrite")
