"""The examples run unchanged."""

from __future__ import annotations

import json
import runpy
import shutil
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch
from PIL import Image

import scoup
from children import finished
from cli_support import run, write_scene
from scoup.models import CANONICAL_PHRASES, WordTable
from scoup.models.plain_colors import PlainColors

pytestmark = pytest.mark.usefixtures("quick_python")

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_scene(tmp_path_factory.mktemp("examples") / "scene")


def example(name: object, *arguments: object) -> str:
    """What an example prints."""
    return finished([sys.executable, EXAMPLES / str(name), *arguments], check=True).stdout


def test_pipeline(tmp_path):
    """Field and answer are those of `scoup.build` on the same regions."""
    names = ["kettle", "mug", "table", *CANONICAL_PHRASES]
    solid = np.random.default_rng(0).integers(1, 256, (len(names), 1, 1, 3), np.uint8)
    vectors = PlainColors().embed(torch.from_numpy(np.tile(solid, (1, 64, 64, 1)))).numpy()
    WordTable.save(tmp_path / "colors.npz", names, vectors)
    scene, out = write_scene(tmp_path / "scene"), tmp_path / "f.scoup"
    shutil.rmtree(scene / "language_features")
    printed = example(
        "00_pipeline.py", scene, "felzenszwalb", "colors", "kettle", out, tmp_path / "colors.npz"
    )
    assert printed.startswith("Answer('kettle'")
    assert "('kettle' in 'view_00.png'" in printed
    made = scoup.LanguageField.load(out)
    cameras = scoup.load_cameras(scene)
    regions = scoup.load_regions(f"{out}.regions", cameras)
    settings = scoup.BuildSettings(check_fit=False)
    built = scoup.build(scoup.load_gaussians(scene), cameras, regions, settings)
    assert made.code_indices.equal(built.code_indices)
    assert made.code_weights.equal(built.code_weights)
    assert made.codebook.equal(built.codebook)
    shutil.move(f"{out}.regions", scene / "language_features")  # used as they are
    again = example("00_pipeline.py", scene, "no segmenter", "colors", "kettle", out, tmp_path / "colors.npz")
    assert again == printed


@pytest.mark.parametrize(("command", "said"), [
    ("01_build_and_query.py scene words kettle", ["view_02", "level", "Place('kettle'"]),
    # The embeddings of this scene are random.
    ("05_adding_views.py scene words kettle", ["a new codebook was learned", "2 views", "3 views", "4 views"]),
    ("08_beside_dense_uplift.py scene words kettle", ["bytes a Gaussian: 36 sparse, 192 dense", "correlation of rel"]),
    ("07_label_and_export.py field words out kettle mug",
     ["GaussianLabels(150 Gaussians", "labels.ply", "labels.glb", "clouds/kettle.ply", "maps/view_00.png"]),
])  # fmt: skip
def test_what_an_example_says(
    scene: Path, field: Path, tmp_path: Path, command: str, said: list[str]
) -> None:
    places = {"scene": scene, "words": scene / "words.npz", "field": field, "out": tmp_path / "out"}
    printed = example(*(places.get(word, word) for word in command.split()))
    assert [part for part in said if part not in printed] == []


def test_cut_out_a_thing(scene, field, tmp_path):
    out, rest = tmp_path / "kettle.ply", tmp_path / "without.scoup"
    printed = example("02_cut_out_a_thing.py", field, scene / "words.npz", "kettle", out, rest)
    assert "of 150 Gaussians saved" in printed
    assert 0 < len(scoup.LanguageField.load(rest)) < 150


@pytest.fixture(scope="module")
def field(scene: Path) -> Path:
    path = scene.parent / "f.scoup"
    assert run("build", scene, "--out", path, "--n-atoms", 8)[0] == 0
    return path


def test_own_embeddings(scene, tmp_path):
    scene = Path(shutil.copytree(scene, tmp_path / "scene"))
    for number, path in enumerate(sorted((scene / "images").iterdir())):
        pixels = np.random.default_rng(number).integers(0, 256, (30, 40, 3), np.uint8)
        Image.fromarray(pixels).save(path)
    printed = example("04_own_embeddings.py", scene, "red")
    assert printed.startswith("red in view_00.png: pixel (")


@pytest.fixture
def framed(field, tmp_path):
    """The field with a metre, an up and a name."""
    world = scoup.WorldFrame(2.0, (0, -1, 0), name="odom")
    scoup.LanguageField.load(field).with_world(world).save(tmp_path / "framed.scoup")
    return tmp_path / "framed.scoup"


def test_robot(scene, framed):
    printed = example("06_robot.py", framed, scene / "words.npz", "kettle")
    loaded = scoup.LanguageField.load(framed)
    place = loaded.location(loaded.with_encoder(scene / "words.npz").question("kettle"))
    assert printed.startswith(f"kettle: {place.describe()}")
    assert "ahead (m)" in printed


def test_every_example_is_run():
    here = Path(__file__)
    tests = here.read_text() + here.with_name("test_engines.py").read_text()
    assert all(path.name in tests for path in EXAMPLES.glob("*.py"))


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.stem)
def test_an_example_without_arguments_says_how_it_is_run(path, monkeypatch):
    monkeypatch.setattr(sys, "argv", [str(path)])
    for package in ("ray", "rerun"):
        monkeypatch.setitem(sys.modules, package, ModuleType(package))
    with pytest.raises(SystemExit, match=f"python examples/{path.name} "):
        runpy.run_path(str(path), run_name="__main__")


def test_things_for_robots(scene, framed):
    printed = json.loads(example("12_things_for_robots.py", framed, scene / "words.npz", "kettle"))
    loaded = scoup.LanguageField.load(framed)
    thing = loaded.things(loaded.with_encoder(scene / "words.npz").question("kettle", always=True))[0]
    detection = printed["detections"][0]
    assert printed["header"] == detection["header"]
    assert printed["header"]["frame_id"] == "odom"
    right, up, away = loaded.frame().axes
    to_map = torch.stack([away, -right, up])  # x forward, y left, z up
    box, pose = detection["bbox"], detection["results"][0]["pose"]
    assert pose["pose"] == box["center"]
    assert [*box["center"]["position"].values()] == pytest.approx((2 * to_map @ thing.box.centre).tolist())
    covariance = np.reshape(pose["covariance"], (6, 6))
    # The variance of the corners is thrice that of the box.
    corners = (thing.box.corners() - thing.box.centre) @ to_map.T * 2
    assert covariance[:3, :3] == pytest.approx((corners.T @ corners / 8 / 3).numpy())
    x, y, z, w = box["center"]["orientation"].values()
    # The first column of the rotation of a unit quaternion is the first axis of the box.
    first = (1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w))
    assert first == pytest.approx((to_map @ thing.box.axes[0]).tolist(), abs=1e-6)


def test_things_in_rerun(scene, field, tmp_path):
    pytest.importorskip("rerun", reason="rerun-sdk is not installed (pip install 'scoup[rerun]')")
    chunks = pytest.importorskip("rerun.chunk", reason="this rerun-sdk cannot read recordings")
    out, loaded = tmp_path / "things.rrd", scoup.LanguageField.load(field)
    example("13_things_in_rerun.py", field, scene / "words.npz", out, "kettle")
    thing = loaded.things(loaded.with_encoder(scene / "words.npz").question("kettle", always=True))[0]
    read = {str(chunk.entity_path): chunk.to_record_batch() for chunk in chunks.RrdReader(out).stream()}
    boxes = read["/scene/things"].to_pydict()
    assert boxes["Boxes3D:centers"][0][0] == pytest.approx(thing.box.centre.tolist(), abs=1e-5)
    assert boxes["Boxes3D:half_sizes"][0][0] == pytest.approx((thing.box.extent / 2).tolist(), abs=1e-5)
    assert boxes["Boxes3D:labels"][0][0] == "kettle"
    camera = next(iter(loaded.cameras or ()))
    first = next(batch.to_pydict() for path, batch in read.items() if f"/cameras/{camera.stem}" in path)
    # Column by column, as Rerun keeps matrices: the first column is the direction to the right.
    right = first["Transform3D:mat3x3"][0][0][:3]
    assert right == pytest.approx(camera.viewmat[0, :3].tolist(), abs=1e-6)
    assert first["Transform3D:translation"][0][0] == pytest.approx(camera.position.tolist(), abs=1e-5)
    assert len(read["/scene/splat"].to_pydict()["Points3D:positions"][0]) == len(loaded)
