"""scoup views, and scoup build of a splat alone, as a user runs them; without models."""

from __future__ import annotations

import shutil
from functools import partial
from pathlib import Path

import pytest
from PIL import Image

from cli_support import FREE, QUICK, refused, run, run_json, snapshot
from scoup.cli.views import MakeViews, OwnViews
from scoup.io import load_cameras, load_gaussians, save_gaussians, write_transforms
from scoup.query import LanguageField

pytestmark = pytest.mark.usefixtures("here")

SPLAT = Path("scene/point_cloud.ply")
SMALL = ("--width", "24", "--height", "18", "--up", "0", "-1", "0")


def test_a_splat_becomes_a_scene_that_is_extracted_and_built() -> None:
    record = run_json("views", SPLAT, *SMALL, "--views", 4, "--out", "own")
    assert record["views"] == 4
    assert record["coverage"] >= record["coverage_by_three"] > 0
    cameras = load_cameras("own")
    assert [camera.image_path is not None for camera in cameras] == [True] * 4
    assert {(camera.width, camera.height) for camera in cameras} == {(24, 18)}
    with Image.open("own/views.png") as sheet:
        assert sheet.width == 1200
    run_json("extract", "own", *FREE)
    # The renders are those of the splat: the check that photographs fit it passes.
    built = run_json("build", "own", "--gaussians", SPLAT, *QUICK, "--out", "a.scoup")
    assert built["views"] == 4


def test_views_that_are_there_are_replaced_on_request() -> None:
    """Their images go, and no others."""
    run_json("views", SPLAT, *SMALL, "--views", 3, "--out", "own")
    shutil.copy("own/images/own_000.png", "own/images/own_009.png")
    assert "own/transforms.json" in refused("views", SPLAT, *SMALL, "--views", 1, "--out", "own")
    run_json("views", SPLAT, *SMALL, "--views", 1, "--out", "own", "--overwrite")
    assert len(load_cameras("own")) == 1
    assert sorted(path.name for path in Path("own/images").iterdir()) == ["own_000.png", "own_009.png"]


def test_photographs_whose_cameras_are_replaced_stay() -> None:
    before = sorted(Path("scene/images").iterdir())
    write_transforms(load_cameras("scene"), "scene/transforms.json")
    shutil.rmtree("scene/sparse")
    run_json("views", SPLAT, *SMALL, "--views", 1, "--out", "scene", "--overwrite")
    assert set(before) < set(Path("scene/images").iterdir())


@pytest.mark.slow  # views of the usual size
def test_a_build_of_a_splat_alone_makes_its_views() -> None:
    built = run_json("build", SPLAT, *FREE, *QUICK, "--out", "alone.scoup")
    assert built["views"] == len(load_cameras("alone_views")) > 1


def test_a_build_of_a_splat_alone_continues() -> None:
    run_json("views", SPLAT, *SMALL, "--views", 3, "--out", "all alone_views")
    built = run_json("build", SPLAT, *FREE, *QUICK, "--out", "all alone.scoup")
    cameras = LanguageField.load("all alone.scoup").cameras
    assert cameras is not None
    assert cameras.names == load_cameras("all alone_views").names
    assert built["views"] == 3
    kept = snapshot(Path("all alone_views"))
    code, said, _ = run("build", SPLAT, *FREE, *QUICK, "--out", "all alone.scoup", "--overwrite")
    assert code == 0
    again = f"scoup views {SPLAT} --out 'all alone_views' --overwrite"
    assert f"uses the existing views; to replace them: {again}" in said
    assert "already there" in said
    assert snapshot(Path("all alone_views")) == kept


def test_interrupted_builds_of_a_splat_say_that_its_views_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    run_json("views", SPLAT, *SMALL, "--views", 3, "--out", "alone_views")
    build = ("build", SPLAT, *FREE, *QUICK, "--out", "alone.scoup")
    for place, expected in (
        ("scoup.extract.pipeline.describe_masks", "the views are kept"),
        ("scoup.uplift.field_build.build", "3 of 3 views are kept"),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(place, interrupt)
            code, said, error = run(*build)
        assert code == 130
        assert f"interrupted; {expected}, run the same command again to continue" in error
        assert "scoup extract" not in said  # which the build does itself
    assert run(*build)[0] == 0


def test_views_that_are_not_whole_are_replaced_on_request(monkeypatch: pytest.MonkeyPatch) -> None:
    run_json("views", SPLAT, *SMALL, "--views", 2, "--out", "alone_views")
    Path("alone_views/transforms.json").unlink()
    monkeypatch.setattr(
        "scoup.cli.views.MakeViews",
        partial(MakeViews, view=OwnViews(width=24, height=18, views=2, up=(0, -1, 0))),
    )
    build = ("build", SPLAT, *FREE, *QUICK, "--out", "alone.scoup")
    assert "alone_views/views.png: already exists; pass --overwrite" in refused(*build)
    assert run_json(*build, "--overwrite")["views"] == 2


@pytest.mark.parametrize(("options", "sign"), [((), -1), (("--keep-axes",), 1)])
def test_up_in_the_axes_of_the_file(options: tuple[str, ...], sign: int) -> None:
    """-y of a PLY whose numbers an .spz keeps is +y of the scene."""
    save_gaussians(load_gaussians(SPLAT), "kept.spz", keep_axes=True)
    run_json("views", "kept.spz", *SMALL, *options, "--views", 2, "--out", "own")
    for camera in load_cameras("own"):
        assert sign * -float(camera.viewmat[1, 1]) > 0
    code, _, err = run("views", "kept.spz", *SMALL[:4], *options, "--views", 2, "--out", "guessed")
    assert code == 0
    assert "up is a guess" in err
    assert "--keep-axes for" in err


def interrupt(*_: object, **__: object) -> None:
    raise KeyboardInterrupt
