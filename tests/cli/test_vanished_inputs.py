"""An input that vanishes while a verb is at work: one sentence names it, what was done is kept, nothing is changed."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch

from cli_support import QUICK, run, snapshot
from scoup import raster
from scoup.extract.felzenszwalb import Felzenszwalb
from scoup.io import load_gaussians, save_gaussians, save_png

FEATURES = Path("scene/language_features")
SCENE = ("scene", "--model", "scene/words.npz")
FREE = ("--segmenter", "felzenszwalb", "--embedder", "colors")


def gone_after_first(
    owner: Any, name: str, what: Callable[[], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Do ``what`` after the first call of a function."""
    function, calls = getattr(owner, name), []

    def calling(*arguments: Any, **more: Any) -> Any:
        found = function(*arguments, **more)
        if not calls:
            what()
        calls.append(1)
        return found

    monkeypatch.setattr(owner, name, calling)


def features_gone() -> None:
    """Only the features of the first view are left; the next ones may have been read ahead."""
    for path in FEATURES.glob("view_0[1-9]*"):
        path.unlink()


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(
    ("arguments", "partial"),
    [
        (("build", *SCENE, *QUICK, "--out", "a.scoup"), "a.scoup.partial"),
        (("build", *SCENE, "--shard", "1/1", "--out", "a.scoup"), "a.scoup.1-of-1.sums.partial"),
    ],
    ids=["build", "shard"],
)
def test_region_features(
    arguments: tuple[str, ...], partial: str, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code, _, err = run(*arguments)
    assert code == 0, err
    output = Path(partial.removesuffix(".partial"))
    whole = output.read_bytes()
    output.unlink()
    shutil.copytree(FEATURES, "saved")
    before = snapshot(here)
    with monkeypatch.context() as patched:
        gone_after_first(raster, "region_sums", features_gone, patched)
        code, _, err = run(*arguments)
    lines = [line for line in err.splitlines() if not line.startswith("warning: ")]
    assert (code, len(lines)) == (2, 1), err
    assert str(FEATURES) in lines[0], err
    left = snapshot(here)
    assert set(left) - set(before) == {partial}
    assert all(left[name] == content for name, content in before.items() if name in left)
    shutil.copytree("saved", FEATURES, dirs_exist_ok=True)
    code, _, err = run(*arguments)
    assert (code, output.read_bytes() == whole) == (0, True), err
    assert not Path(partial).exists()


@pytest.mark.usefixtures("here")
def test_features_of_views_to_add(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    Path("later").mkdir()
    for path in FEATURES.glob("view_0[1-3]*"):
        path.rename(Path("later") / path.name)
    code, _, err = run("build", *SCENE, *QUICK, "--keep-sums", "--out", "a.scoup")
    assert code == 0, err
    shutil.copytree("later", FEATURES, dirs_exist_ok=True)
    update = ("update", "a.scoup", "--scene", "scene", "--add", "all", "--overwrite")
    before = {name: content for name, content in snapshot(here).items() if not name.startswith(str(FEATURES))}
    gone_after_first(raster, "region_sums", features_gone, monkeypatch)
    code, _, err = run(*update)
    lines = [line for line in err.splitlines() if not line.startswith("warning: ")]
    assert (code, len(lines)) == (2, 1), err
    assert str(FEATURES) in lines[0], err
    left = snapshot(here)
    assert all(left[name] == content for name, content in before.items())
    monkeypatch.undo()
    monkeypatch.chdir(here)
    shutil.copytree("later", FEATURES, dirs_exist_ok=True)
    assert run(*update)[0] == 0


@pytest.mark.usefixtures("here")
def test_a_shard_that_is_gone_before_it_is_opened(here: Path) -> None:
    for share in ("1/2", "2/2"):
        assert run("build", *SCENE, "--out", "a.scoup", "--shard", share)[0] == 0
    Path("a.scoup.2-of-2.sums").unlink()
    before = snapshot(here)
    code, _, err = run("merge", "a.scoup.1-of-2.sums", "a.scoup.2-of-2.sums", *QUICK)
    assert (code, len(err.splitlines())) == (2, 1), err
    assert err.startswith("error: a.scoup.2-of-2.sums: "), err
    assert snapshot(here) == before


@pytest.mark.usefixtures("here")
def test_kept_sums_that_are_gone_before_they_are_opened(here: Path) -> None:
    assert run("build", *SCENE, *QUICK, "--keep-sums", "--out", "a.scoup")[0] == 0
    Path("a.scoup.sums").unlink()
    save_gaussians(load_gaussians("scene").select(slice(5, None)), "edited.ply")
    before = snapshot(here)
    for arguments in (("--remove", "view_00.png"), ("--edited", "edited.ply", "--scene", "scene")):
        code, _, err = run("update", "a.scoup", *arguments, "--overwrite")
        assert (code, len(err.splitlines())) == (2, 1), err
        assert err.startswith("error: a.scoup.sums: is not there"), err
        assert snapshot(here) == before


@pytest.mark.usefixtures("here")
def test_photographs(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    images = Path("photographs")
    for number in range(4):
        pixels = torch.zeros(30, 40, 3, dtype=torch.uint8)
        pixels[:15, : 10 + 5 * number] = 200
        save_png(pixels, images / f"p_{number}.png")
    extract = ("extract", images, *FREE, "--out", "regions")
    shutil.copytree(images, "saved")

    def gone() -> None:
        for path in images.glob("p_[23].png"):
            path.unlink()

    with monkeypatch.context() as patched:
        gone_after_first(Felzenszwalb, "segment", gone, patched)
        code, _, err = run(*extract)
    # It is passed over as one that cannot be read, and the same command makes it once it is there again.
    assert (code, len(err.splitlines())) == (0, 1), err
    assert err.startswith(
        "warning: skipped 1 of 4 photographs that could not be read: photographs/p_3.png: "
    ), err
    kept = {name: content for name, content in snapshot(here).items() if name.endswith(".regions")}
    assert sorted(Path(name).stem for name in kept) == ["p_0", "p_1", "p_2"]
    shutil.copytree("saved", images, dirs_exist_ok=True)
    code, _, err = run(*extract)
    assert (code, err) == (0, "")
    after = snapshot(here)
    assert all(after[name] == content for name, content in kept.items())
    assert "regions/p_3.regions" in after
