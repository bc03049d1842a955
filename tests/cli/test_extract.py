"""scoup extract, views, and builds that begin with them: what is special of them, without models."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
import torch
from PIL import Image

from cli_support import FREE, QUICK, plain_photographs, printed, refused, run, run_json, snapshot, warned
from messages import check_message
from scoup.cli.options import CLIP_MODEL
from scoup.io import (
    load_cameras,
    load_gaussians,
    load_regions,
    save_gaussians,
)
from scoup.io.regions.manifest import MANIFEST
from scoup.models import WordTable
from scoup.query import LanguageField
from scoup.scene import Detections
from scoup_lab.data.colmap_model import write_colmap
from support import table_of

pytestmark = pytest.mark.usefixtures("here")

ROOT = Path(__file__).parents[2]
SPLAT = Path("scene/point_cloud.ply")
SMALL = ("--width", "24", "--height", "18", "--up", "0", "-1", "0")


def photographs() -> None:
    """A scene without regions, whose photographs show something."""
    shutil.rmtree("scene/language_features")
    plain_photographs()


def test_extract_then_build() -> None:
    photographs()
    assert set(run_json("extract", "scene", *FREE)["stages"]) == {"decode", "segment", "embed", "write"}
    settings = json.loads(Path("scene/language_features", MANIFEST).read_text())["settings"]
    assert (settings["segmenter"], settings["max_height"]) == ("felzenszwalb", 1080)
    again = run_json("extract", "scene", *FREE)
    assert (again["made"], again["kept"]) == (0, 4)
    # The photographs alone give the same regions.
    assert run_json("extract", "scene/images", *FREE, "--out", "out")["made"] == 4
    one, other = (load_regions(folder, load_cameras("scene")) for folder in ("out", "scene"))
    for level in one.levels:
        assert torch.equal(one.load("view_02.png", level).labels, other.load("view_02.png", level).labels)
    build = ("build", "scene", *QUICK, "--no-check-fit", "--out")
    run_json(*build, "a.scoup")
    field = LanguageField.load("a.scoup")
    assert field.info.embedding_model == "colors"  # as the features say, not as the verb would guess
    assert field.dim == 72
    run_json(*build, "b.scoup", "--model", "my/model")
    assert LanguageField.load("b.scoup").info.embedding_model == "my/model"


def test_regions_are_shown_and_replaced_by_a_conversion() -> None:
    Path("scene/language_features").rename("langsplat")
    plain_photographs()
    run_json("extract", "scene", *FREE, "--out", "regions")
    shown = run_json("extract", "scene", "--show", "view_00.png", "--out", "regions")
    assert set(shown["covered"].values()) == {1}
    assert "made with other settings" in refused("convert", "langsplat", "regions")
    run_json("convert", "langsplat", "regions", "--overwrite")
    assert len(load_regions("regions", load_cameras("scene"))) == 4


def test_photographs_are_chosen_and_more_are_added() -> None:
    shutil.rmtree("scene/language_features")
    manifest = Path("scene/language_features", MANIFEST)

    def chosen() -> list[str]:
        return json.loads(manifest.read_text()).get("views", [])

    out = printed("extract", "scene", *FREE, "--views", 2)
    assert "2 of 4 photographs; --views all takes all" in out
    first = chosen()
    assert len(first) == 2
    # A build takes the views with regions, and says so.
    assert "2 views with regions of 4 cameras" in run("build", "scene", *QUICK, "--out", "a.scoup")[1]
    assert run_json("extract", "scene", *FREE, "--views", "+1")["made"] == 1
    assert chosen()[:2] == first
    assert len(chosen()) == 3
    manifest.with_name(f"{Path(chosen()[2]).stem}.regions").unlink()  # as an interruption leaves it
    again = run_json("extract", "scene", *FREE, "--views", "+1")
    assert (again["made"], again["kept"], again["chosen"]) == (1, 2, 3)
    assert run_json("extract", "scene", *FREE, "--views", "all")["made"] == 1
    assert chosen() == []


@pytest.mark.parametrize("without", ["point_cloud.ply", "sparse"])
def test_what_the_choice_of_photographs_needs(monkeypatch: pytest.MonkeyPatch, without: str) -> None:
    """COLMAP's points serve without a splat; without cameras all are taken, unless a number is passed."""
    monkeypatch.setattr("scoup.extract.constants.FEW", 1)
    shutil.rmtree("scene/language_features")
    if without == "sparse":
        shutil.rmtree("scene/sparse")
        said = "takes all 4 photographs, for they cannot be compared: scene: contains no cameras"
        assert said in run("extract", "scene", *FREE)[1]
    else:
        points = np.random.default_rng(1).uniform((-2, -2, 5), (2, 2, 5.1), (3000, 3))
        colors = np.zeros(points.shape, np.uint8)
        write_colmap(load_cameras("scene"), "scene/sparse/0", (points, colors), overwrite=True)
        Path("scene/point_cloud.ply").unlink()
        assert run_json("extract", "scene", *FREE, "--views", 3)["chosen"] == 3


def test_list_shows_every_model_and_whether_its_weights_are_here(tmp_path: Path, monkeypatch) -> None:
    commit = tmp_path / "models--facebook--sam-vit-base" / "snapshots" / "abc"
    commit.mkdir(parents=True)
    (commit / "model.safetensors").touch()
    (commit.parents[1] / "refs").mkdir()
    (commit.parents[1] / "refs" / "main").write_text("abc")
    pytest.importorskip("huggingface_hub")
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_CACHE", str(tmp_path))
    listed = run_json("extract", "--list")
    assert {"owlv2", "grounding-dino", "sam3"} <= {row["name"] for row in listed.pop("concepts")}
    rows = {row["name"]: row for rows in listed.values() for row in rows}
    assert [name for name, row in rows.items() if row["weights"] == "here"] == ["sam-vit-b"]
    assert (rows["mobile-sam"]["weights"], rows["colors"]["weights"]) == ("not here", "-")
    measured = json.loads((ROOT / "docs/benchmarks/extract.json").read_text())["rows"]
    seconds = {row["way"]: f"{row['seconds']:.1f}" for row in measured}
    assert rows["mobile-sam"]["CPU seconds"] == seconds["fast"]
    measured = json.loads((ROOT / "docs/benchmarks/embed.json").read_text())["rows"]
    assert rows[CLIP_MODEL]["CPU seconds"] == f"{measured['clip/crops']['cpu_seconds']:.1f}"
    assert rows["dense:MODEL"]["CPU seconds"] == f"{measured['clip/dense']['cpu_seconds']:.1f}"
    assert [row["CPU seconds"] for row in rows.values()].count("-") == len(rows) - 3
    assert all(name in printed("extract", "--list") for name in rows)


def test_words_looked_for_name_the_things_of_a_build(monkeypatch: pytest.MonkeyPatch) -> None:
    class Finder:
        def to_dict(self) -> dict[str, str]:
            return {}

        def detect(self, image: np.ndarray, texts: Sequence[str]) -> Detections:
            height, width = image.shape[:2]
            rows, box = torch.full((1,), texts.index("robot")), torch.tensor([[0.0, 0, width, height]])
            return Detections(rows, torch.tensor([0.7]), box, (width, height))

    monkeypatch.setattr("scoup.models.open_concepts", lambda name, device: Finder())
    Path("words.txt").write_text("kettle\nrobot\n")
    said = run_json("extract", "scene", *FREE, "--out", "regions", "--concepts", "words.txt", "--part", "1/1")
    assert (said["concepts"]["words"], said["concepts"]["made"]) == (2, 4)
    run_json("build", "scene", *QUICK, "--features", "regions", "--out", "named.scoup", "--no-check-fit")
    names = table_of(LanguageField.load("named.scoup")).names
    assert names is not None
    assert names.texts == ("kettle", "robot")
    assert float(names.presence[0]) == 0 < float(names.presence[1])


# ---- views of a splat alone


def test_a_splat_becomes_a_scene_that_is_extracted_and_built() -> None:
    record = run_json("views", SPLAT, *SMALL, "--views", 4, "--out", "own")
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
    photographs = {path.name for path in Path("scene/images").iterdir()}
    shutil.rmtree("scene/sparse")
    views = ("views", SPLAT, *SMALL, "--out", "scene", "--views")
    run_json(*views, 3)
    assert "scene/transforms.json" in refused(*views, 1)
    run_json(*views, 1, "--overwrite")
    assert len(load_cameras("scene")) == 1
    assert {path.name for path in Path("scene/images").iterdir()} == {*photographs, "own_000.png"}


def test_a_build_of_a_splat_alone_continues_with_views_that_are_whole(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    folder, views = (
        Path("all alone_views"),
        ("views", SPLAT, *SMALL, "--views", 2, "--out", "all alone_views"),
    )
    run_json(*views)
    build = ("build", SPLAT, *FREE, *QUICK, "--out", "all alone.scoup")
    for place, expected in (
        ("scoup.extract.pipeline.describe_masks", "the views are kept"),
        ("scoup.uplift.build", "2 of 2 views are kept"),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(place, Mock(side_effect=KeyboardInterrupt))
            code, said, error = run(*build)
        assert code == 130
        assert f"interrupted; {expected}, run the same command again to continue" in error
        assert "scoup extract" not in said  # which the build does itself
    kept = snapshot(folder)
    said = run(*build)[1]
    again = f"scoup views {SPLAT} --out 'all alone_views' --overwrite"
    assert f"uses the existing views; to replace them: {again}" in said
    assert "already there" in said
    assert len(LanguageField.load("all alone.scoup").cameras or ()) == 2
    assert snapshot(folder) == kept
    (folder / "transforms.json").unlink()
    Path("all alone.scoup").unlink()
    assert "all alone_views/views.png: already exists; pass --overwrite" in refused(*build)
    run_json(*views, "--overwrite")
    assert len(load_cameras(folder)) == 2


def test_up_in_the_axes_of_the_file() -> None:
    """-y of a PLY whose numbers an .spz keeps is +y of the scene."""
    save_gaussians(load_gaussians(SPLAT), "kept.spz", keep_axes=True)
    for out, options, sign in (("plain", (), -1), ("axes", ("--keep-axes",), 1)):
        run_json("views", "kept.spz", *SMALL, *options, "--views", 1, "--out", out)
        assert sign * -float(load_cameras(out)[0].viewmat[1, 1]) > 0
    said = warned("views", "kept.spz", *SMALL[:4], "--views", 1, "--out", "guessed")
    assert "up is a guess" in said
    assert "--keep-axes for" in said


BEFORE = {
    "build, point cloud": "build scene --gaussians points.ply --no-check-fit",
    "build, splat of elsewhere": "build scene --gaussians elsewhere.ply",
    "build, table": "build scene --model table.npz --no-check-fit",
    "build, no table": "build scene --model missing.npz --no-check-fit",
    "build, codebook": "build scene --codebook f.scoup --no-check-fit",
    "build, near plane": "build scene --raster-preset inria:-1 --no-check-fit",
    "build, full disk": "build scene --no-check-fit",
    "extract, point cloud": "extract scene --gaussians points.ply",
    "extract, model of words": "extract scene --concepts words.txt --concept-model missing",
    "extract, full disk": "extract scene",
}


@pytest.mark.parametrize("mistake", BEFORE)
def test_a_mistake_is_found_before_the_first_photograph(
    mistake: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    gaussians = load_gaussians(SPLAT)
    photographs()
    Path("words.txt").write_text("mug\n")
    Path("points.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n0\n"
    )
    save_gaussians(replace(gaussians, means=gaussians.means + 1000), "elsewhere.ply")
    WordTable.save("table.npz", ["a", "b"], np.eye(2, 5))
    segmented = Mock(side_effect=AssertionError("a photograph was segmented"))
    monkeypatch.setattr("scoup.extract.felzenszwalb.Felzenszwalb.segment", segmented)
    if "full disk" in mistake:
        monkeypatch.setattr(shutil, "disk_usage", lambda path: shutil._ntuple_diskusage(10, 9, 1))
    check_message(refused(*BEFORE[mistake].split(), *FREE))
