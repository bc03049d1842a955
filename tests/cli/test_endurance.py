"""Verbs that are killed and run again, by the functions of ``benchmarks.endurance``.

Kills come at points of the work that a seed chooses, not of the clock. A kill after the end of a run counts as too
late, and fails nothing.
"""

from __future__ import annotations

import shutil

import pytest
from benchmarks.endurance import endure, run_undisturbed
from benchmarks.endurance_runs import Run, snapshot
from benchmarks.endurance_verbs import VERBS, Scene, make_scene

from cli_support import run

pytestmark = pytest.mark.usefixtures("quick_python")

KILLS: dict[str, int] = dict.fromkeys(("build", "build --shard", "merge", "update --add", "extract"), 1)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return make_scene(tmp_path_factory.mktemp("endurance") / "scene", views=6, width=48, n_gaussians=2000)


@pytest.mark.parametrize("name", KILLS)
def test_killed_and_run_again(name: str, scene: Scene) -> None:
    verb = VERBS[name]
    trials = endure(verb, scene, KILLS[name], seed=0, outside=0)
    for trial in trials:
        assert trial.passed, trial
        assert all(kill.begun_again <= verb.may_begin_again for kill in trial.kills), trial
    assert sum(len(trial.kills) for trial in trials) == KILLS[name]


@pytest.mark.parametrize("name", ["build --keep-sums", "update --add"])
def test_killed_between_field_and_sums(name: str, scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """The next verb that is to change the field puts the sums in their place; the same command says that it is done."""
    verb = VERBS[name]
    plain = run_undisturbed(verb, scene)
    point = 1 + max(
        row for row, note in enumerate(plain.notes) if note == "file os.rename .a.scoup.sums.ready"
    )
    verb.prepare(scene)
    assert verb.run(scene, point).code == Run.KILLED
    left = snapshot(scene.work)
    assert left["a.scoup"] == plain.files["a.scoup"]
    assert any(
        left.get(file) != content for file, content in plain.files.items() if file.startswith("a.scoup.sums/")
    )
    killed = scene.work.with_name("killed")
    shutil.rmtree(killed, ignore_errors=True)
    shutil.copytree(scene.work, killed)
    monkeypatch.chdir(scene.work)
    for number, (arguments, code, sentence) in enumerate(
        (
            (verb.command(scene), 2, verb.finished),
            (["update", "a.scoup", "--remove", "view_00.png", "--out", "b.scoup"], 0, ""),
        )
    ):
        if number:
            for path in scene.work.iterdir():
                shutil.rmtree(path) if path.is_dir() else path.unlink()
            shutil.copytree(killed, scene.work, dirs_exist_ok=True)
        found, _, err = run(*arguments)
        assert found == code, err
        assert "a.scoup: completed the renames of a killed process (a.scoup.sums)" in err
        assert sentence in err
        after = snapshot(scene.work)
        assert {file: content for file, content in after.items() if not file.startswith("b.")} == plain.files
        assert ("b.scoup.sums/scene.safetensors" in after) == (code == 0)
