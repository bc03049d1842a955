"""scoup build and scoup merge in several processes, as torchrun starts them: the bytes of one process."""

from __future__ import annotations

from pathlib import Path

import pytest

from cli_support import QUICK, run, together, write_scene
from support import environments

pytestmark = pytest.mark.usefixtures("quick_python")

SCENE = ("scene", "--model", "scene/words.npz")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene of more Gaussians than one process votes for, its field, and shards of it."""
    folder = tmp_path_factory.mktemp("several")
    write_scene(folder / "scene", count=1200)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert run("build", *SCENE, *QUICK, "--out", "alone.scoup")[0] == 0
        for number in (3, 1, 2):
            assert run("build", *SCENE, "--out", "s.scoup", "--shard", f"{number}/3")[0] == 0
    return folder


# Builds by two processes and by three are in test_interruption and test_lost_processes. There are three levels and four
# views: of four processes, one learns no codes.
@pytest.mark.parametrize(("verb", "world"), [("merge", 2), ("merge", 3), ("merge", 4), ("build", 4)])
def test_the_bytes_of_one_process(
    verb: str, world: int, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    given = SCENE if verb == "build" else sorted(folder.glob("s.scoup.*-of-3.sums"))
    out = folder / f"{verb}-{world}.scoup"  # beside the other: a field names its splat relative to itself
    with environments(world) as ranks:
        ended = together(ranks, verb, *given, *QUICK, "--out", out)
    assert [(done.returncode, done.stderr) for done in ended] == [(0, "")] * world
    assert [done.stdout.count("merged\n") for done in ended] == [int(verb == "merge")] + [0] * (world - 1)
    assert out.read_bytes() == (folder / "alone.scoup").read_bytes()
    assert {path.name for path in folder.glob(f"{out.stem}*")} == {out.name}


def test_processes_that_merge_keep_no_sums(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    with environments(2) as ranks:
        ended = together(ranks, "merge", *folder.glob("s.scoup.*"), *QUICK, "--keep-sums", "--out", "k.scoup")
    assert [done.returncode for done in ended] == [2, 2]
    assert "--keep-sums works in one process" in ended[0].stderr
    assert not list(folder.glob("k.scoup*"))


def test_processes_refuse_shards_alike(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    with environments(2) as ranks:
        ended = together(ranks, "merge", "alone.scoup", *QUICK, "--out", "k.scoup")
    for done in ended:
        assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
        assert "error: alone.scoup: is not a file of region sums" in done.stderr
    assert not list(folder.glob("k.scoup*"))
