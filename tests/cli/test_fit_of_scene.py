"""What scoup build and info say of splats and cameras that do not fit."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from cli_support import BUILD, printed, refused, run_json, write_scene
from scoup.base import Registry
from scoup.io import load_gaussians, save_gaussians
from scoup.io.splats import formats
from scoup.io.splats.ply import FORMAT, read_ply
from scoup.io.splats.splat_format import SplatFormat
from scoup.scene import Gaussians


@pytest.fixture(autouse=True)
def _scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A scene, and another splat."""
    monkeypatch.chdir(tmp_path)
    write_scene(Path("scene"))
    write_scene(Path("elsewhere"), seed=9)


def test_a_scene_that_fits_is_silent():
    printed(*BUILD, "--model", "scene/words.npz")
    fit = run_json("info", "scene")["fit"]
    assert (fit["verdict"], fit["views_tried"]) == ("fits", 4)
    assert fit["similarity"] > 0.9


def test_info_reads_a_splat_once(monkeypatch: pytest.MonkeyPatch):
    read: list[Path] = []

    def counted_read(path: Path) -> Gaussians:
        read.append(path)
        return read_ply(path)

    table = [replace(FORMAT, read=counted_read)]
    monkeypatch.setattr(formats, "FORMATS", Registry("splat format", "none", SplatFormat, table))
    assert "fit" in run_json("info", "scene")
    assert read == [Path("scene/point_cloud.ply")]


def test_the_splat_of_another_scene_is_refused_before_the_work():
    message = refused(*BUILD, "--gaussians", "elsewhere/point_cloud.ply")
    assert message.startswith(
        "elsewhere/point_cloud.ply: does not fit the cameras: 4 of 4 renders tried look unlike"
    )
    for remedy in ("of one scene", "--dataparser-transforms", "pass --no-check-fit"):
        assert remedy in message
    shutil.copy("elsewhere/point_cloud.ply", "scene/point_cloud.ply")
    assert run_json("info", "scene")["fit"]["verdict"] == "hopeless"
    assert run_json(*BUILD, "--no-check-fit")["views"] == 4


def test_cameras_follow_a_splat_into_the_frame_of_its_training():
    shift, scale = (3.0, -1.0, 2.0), 0.7
    gaussians = load_gaussians("scene/point_cloud.ply")
    means = scale * (gaussians.means + gaussians.means.new_tensor(shift))
    save_gaussians(replace(gaussians, means=means, scales=scale * gaussians.scales), "trained.ply")
    trained = (*BUILD, "--gaussians", "trained.ply")
    assert "does not fit the cameras" in refused(*trained)
    rows = [[float(row == column) for column in range(3)] + [shift[row]] for row in range(3)]
    Path("dataparser_transforms.json").write_text(json.dumps({"transform": rows, "scale": scale}))
    words = ("--model", "scene/words.npz")
    printed(*trained, *words, "--dataparser-transforms", "dataparser_transforms.json")
