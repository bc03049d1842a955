"""scoup extract, regions and convert, as a user runs them; without models."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from cli_support import FREE, QUICK, plain_photographs, refused, run, run_json
from scoup.cli.options import CLIP_MODEL
from scoup.io import find_detections, load_cameras, load_regions, write_colmap
from scoup.io.regions.manifest import MANIFEST
from scoup.query import LanguageField
from scoup.scene import Detections
from scoup.uplift.naming import things_in_view

pytestmark = pytest.mark.usefixtures("here")

ROOT = Path(__file__).parents[2]


def photographs() -> None:
    """A scene without regions, whose photographs show something."""
    shutil.rmtree("scene/language_features")
    plain_photographs()


def test_extract_then_build(here) -> None:
    photographs()
    record = run_json("extract", "scene", *FREE)
    assert (record["made"], record["kept"], record["skipped"]) == (4, 0, {})
    assert record["embedding_model"] == "colors"
    assert set(record["stages"]) == {"decode", "segment", "embed", "write"}
    settings = json.loads(Path("scene/language_features", MANIFEST).read_text())["settings"]
    assert (settings["segmenter"], settings["max_height"]) == ("felzenszwalb", 1080)
    again = run_json("extract", "scene", *FREE)
    assert (again["made"], again["kept"]) == (0, 4)
    code, out, _ = run("extract", "scene", *FREE, "--overwrite")
    assert code == 0
    assert "4 views made, in" in out
    assert "seconds a view: decode" in out
    assert "look unlike their photographs" in refused("build", "scene", *QUICK, "--out", "a.scoup")
    build = ("build", "scene", *QUICK, "--no-check-fit", "--out")
    run_json(*build, "a.scoup")
    field = LanguageField.load("a.scoup")
    assert field.info.embedding_model == "colors"  # as the features say, not as the verb would guess
    assert field.dim == 72
    run_json(*build, "b.scoup", "--model", "my/model")
    assert LanguageField.load("b.scoup").info.embedding_model == "my/model"


def test_extract_from_photographs_alone(here) -> None:
    photographs()
    record = run_json("extract", "scene/images", *FREE, "--out", "deep/out")
    assert record["made"] == 4
    assert {"view_00.regions", MANIFEST} <= {path.name for path in Path("deep/out").iterdir()}
    assert run("extract", "scene", *FREE, "--out", "other", "--quiet")[:2] == (0, "")
    one, other = (load_regions(folder, load_cameras("scene")) for folder in ("deep/out", "other"))
    for level in one.levels:
        assert torch.equal(one.load("view_02.png", level).labels, other.load("view_02.png", level).labels)


def test_regions_picture(here) -> None:
    photographs()
    run_json("extract", "scene", *FREE)
    record = run_json("extract", "scene", "--show", "view_02")
    assert record["view"] == "view_02.png"
    assert "view_02_regions.png: already exists" in refused("extract", "scene", "--show", "view_02")
    assert all(record["regions"][level] >= 1 for level in "sml")
    with Image.open("view_02_regions.png") as picture:
        assert picture.size[0] == 1800
        assert len(picture.convert("RGB").getcolors(1 << 20)) > 20
    Path("scene/language_features").rename("regions")
    options = ("--show", "view_00.png", "--out", "regions")
    assert "100% covered" in run("extract", "scene", *options)[1]
    Path("scene/images/view_03.png").unlink()
    Path("regions/view_03.regions").unlink()
    said = refused("extract", "scene", "--show", "view_03", "--out", "regions")
    there = "it has view_00.regions, view_01.regions, view_02.regions; make them with scoup extract"
    assert f"has no regions of view_03.png: expected view_03.regions; {there}" in said


def test_langsplats_files_become_compact(here) -> None:
    record = run_json("convert", "scene", "compact", "--bits", "32", "--model", "my/model")
    assert record["views"] == 4
    assert record["bytes_after"] < record["bytes_before"]
    info = run_json("info", "compact")
    assert (info["kind"], info["views"], info["embedding_model"]) == ("region features", 4, "my/model")
    assert run_json("convert", "compact", "half")["bytes_after"] < record["bytes_after"]


def test_convert_into_a_folder_that_extract_has_made(here) -> None:
    Path("scene/language_features").rename("langsplat")
    plain_photographs()
    run_json("extract", "scene", *FREE, "--out", "regions")
    assert "made with other settings" in refused("convert", "langsplat", "regions")
    run_json("convert", "langsplat", "regions", "--overwrite")
    assert len(load_regions("regions", load_cameras("scene"))) == 4


def test_parts_of_an_extraction(here) -> None:
    photographs()
    records = [run_json("extract", "scene", *FREE, "--part", f"{number}/3") for number in (1, 2, 3)]
    assert [(record["part"], record["of_parts"]) for record in records] == [(1, 3), (2, 3), (3, 3)]
    assert [record["made"] for record in records] == [2, 1, 1]
    assert len(load_regions("scene", load_cameras("scene"))) == 4
    assert "(part 1 of 3)" in run("extract", "scene", *FREE, "--part", "1/3", "--out", "other")[1]


def test_photographs_are_chosen_and_more_are_added(here) -> None:
    shutil.rmtree("scene/language_features")
    manifest = Path("scene/language_features", MANIFEST)

    def chosen() -> list[str]:
        return json.loads(manifest.read_text()).get("views", [])

    code, out, err = run("extract", "scene", *FREE, "--views", 2)
    assert code == 0, err
    assert "2 of 4 photographs; --views all takes all" in out
    first = chosen()
    assert len(first) == 2
    # A build takes the views with regions, and says so.
    assert "2 views with regions of 4 cameras" in run("build", "scene", *QUICK, "--out", "a.scoup")[1]
    cameras = LanguageField.load("a.scoup").cameras
    assert cameras is not None
    assert set(cameras.names) == set(first)
    assert run_json("extract", "scene", *FREE, "--views", "+1")["made"] == 1
    assert chosen()[:2] == first
    assert len(chosen()) == 3
    manifest.with_name(f"{Path(chosen()[2]).stem}.regions").unlink()  # as an interruption leaves it
    again = run_json("extract", "scene", *FREE, "--views", "+1")
    assert (again["made"], again["kept"], again["chosen"]) == (1, 2, 3)
    assert run_json("extract", "scene", *FREE, "--views", "all")["made"] == 1
    assert chosen() == []


@pytest.mark.parametrize("without", ["point_cloud.ply", "sparse"])
def test_what_the_choice_of_photographs_needs(here, monkeypatch: pytest.MonkeyPatch, without: str) -> None:
    """COLMAP's points serve without a splat; without cameras all are taken, unless a number is passed."""
    monkeypatch.setattr("scoup.extract.constants.FEW", 1)
    shutil.rmtree("scene/language_features")
    if without == "sparse":
        shutil.rmtree("scene/sparse")
        assert "contains no cameras" in refused("extract", "scene", *FREE, "--views", 2)
        said = "takes all 4 photographs, for they cannot be compared: scene: contains no cameras"
        assert said in run("extract", "scene", *FREE)[1]
    else:
        points = np.random.default_rng(1).uniform((-2, -2, 5), (2, 2, 5.1), (3000, 3))
        colors = np.zeros(points.shape, np.uint8)
        write_colmap(load_cameras("scene"), "scene/sparse/0", (points, colors), overwrite=True)
        Path("scene/point_cloud.ply").unlink()
        assert run_json("extract", "scene", *FREE, "--views", 3)["chosen"] == 3


def test_a_splat_that_does_not_fit_chooses_nothing(here) -> None:
    photographs()
    assert "does not fit the cameras" in refused("extract", "scene", *FREE, "--views", 2)


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
    assert {"mobile-sam", "sam-vit-h", "sam3", "felzenszwalb", CLIP_MODEL, "colors"} <= set(rows)
    assert [name for name, row in rows.items() if row["weights"] == "here"] == ["sam-vit-b"]
    assert (rows["mobile-sam"]["weights"], rows["colors"]["weights"]) == ("not here", "-")
    measured = json.loads((ROOT / "docs/benchmarks/extract.json").read_text())["rows"]
    seconds = {row["way"]: f"{row['seconds']:.1f}" for row in measured}
    assert rows["mobile-sam"]["CPU seconds"] == seconds["fast"]
    measured = json.loads((ROOT / "docs/benchmarks/embed.json").read_text())["rows"]
    assert rows[CLIP_MODEL]["CPU seconds"] == f"{measured['clip/crops']['cpu_seconds']:.1f}"
    assert rows["dense:MODEL"]["CPU seconds"] == f"{measured['clip/dense']['cpu_seconds']:.1f}"
    assert [row["CPU seconds"] for row in rows.values()].count("-") == len(rows) - 3
    code, out, _ = run("extract", "--list")
    assert code == 0
    assert len(out.split()) > 5 * len(rows)
    assert all(name in out for name in rows)


def test_words_looked_for_name_the_things_of_a_build(monkeypatch: pytest.MonkeyPatch) -> None:
    """Boxes are those of the things as the field without names shows them."""
    run_json("build", "scene", *QUICK, "--out", "plain.scoup", "--no-check-fit")
    field = LanguageField.load("plain.scoup")
    table, cameras = field.thing_table, list(field.cameras or ())
    assert table is not None
    views = [things_in_view(field.gaussians, table, camera, field.raster_preset) for camera in cameras]
    thing = int(torch.stack([view.masks.sum((1, 2)) for view in views]).sum(0).argmax())
    boxes = iter([view.boxes[thing] for view in views])

    class Finder:
        def to_dict(self) -> dict[str, str]:
            return {}

        def detect(self, image: np.ndarray, texts: Sequence[str]) -> Detections:
            height, width = image.shape[:2]
            rows = torch.full((1,), texts.index("robot"))
            return Detections(rows, torch.tensor([0.7]), next(boxes)[None], (width, height))

    monkeypatch.setattr("scoup.models.concepts.open_concepts", lambda name, device: Finder())
    Path("words.txt").write_text("kettle\nrobot\n")
    said = run_json("extract", "scene", *FREE, "--out", "regions", "--concepts", "words.txt", "--part", "1/1")
    assert (said["concepts"]["words"], said["concepts"]["made"]) == (2, len(cameras))
    Path("regions/concepts").rename("scene/language_features/concepts")
    assert find_detections(Path("scene/language_features")) is not None
    run_json("build", "scene", *QUICK, "--out", "named.scoup", "--no-check-fit")
    named = LanguageField.load("named.scoup").thing_table
    assert named is not None
    assert named.names is not None
    assert named.names.texts == ("kettle", "robot")
    assert int(named.names.votes_of(1, len(named)).argmax()) == thing
    assert float(named.names.presence[0]) == 0 < float(named.names.presence[1])
