"""The demo scene: counts, sameness, a truth over the render, errors of observation, and its folder."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image, ImageDraw

from messages import refuses
from scoup.base import OutputExistsError, UnknownNameError
from scoup.io import load_cameras, load_gaussians, load_regions
from scoup.models import WordTable
from scoup.raster import project, render_channels
from scoup.scene import LEVELS
from scoup_lab.data.labels import match_frames, read_frame, read_labels
from scoup_lab.synthetic import TABLE, DemoScene, make_demo_scene, write_demo_scene
from scoup_lab.synthetic.art.things import Parts
from scoup_lab.synthetic.masks import mask_polygons, piece_boxes
from scoup_lab.synthetic.observe import make_regions
from scoup_lab.synthetic.splat import make_splat

SMALL: dict[str, Any] = {"n_gaussians": 30_000, "width": 240, "height": 180, "n_building": 6, "n_held_out": 2}
"""The size of the scene that tests share."""


@pytest.fixture(scope="module")
def scene() -> DemoScene:
    """Lit as in the demo; other tests have one direction of light (conftest.py)."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("scoup_lab.synthetic.scene.make_splat", make_splat)
        return make_demo_scene(**SMALL)


# Figures in the documents rest on the scenes. Of the table:
GOLDEN = {
    "means": 53783.474, "scales": 759.73168, "colours": 90783.74, "cameras": 69.126366,
    "words": 2249.6334, "truth": 4331601, "regions": 17303.031,
}  # fmt: skip


def test_the_table_is_what_it_always_was(scene: DemoScene):
    assert scene.layout is TABLE
    found = {
        "means": scene.gaussians.means.double().square().sum(),
        "scales": scene.gaussians.scales.double().sum(),
        "colours": scene.gaussians.sh.double().square().sum(),
        "cameras": torch.stack([camera.viewmat for camera in scene.cameras]).square().sum(),
        "words": np.abs(scene.words.vectors).sum(),
        "truth": sum(int(view.astype(np.int64).sum()) for view in scene.part_maps.values()),
        "regions": sum(float(scene.regions.embeddings(level)[0].double().abs().sum()) for level in LEVELS),
    }
    assert {name: float(value) for name, value in found.items()} == pytest.approx(GOLDEN, rel=1e-4)


def test_counts_and_values(scene: DemoScene):
    gaussians = scene.gaussians
    assert len(gaussians) == SMALL["n_gaussians"] == len(scene.part_of_gaussian)
    assert bool(gaussians.finite().all())
    assert gaussians.quats.norm(dim=1).sub(1).abs().max() < 1e-5
    assert ((gaussians.opacities > 0) & (gaussians.opacities < 1)).all()
    part = scene.part_of_gaussian.double()  # objects lie in no order
    assert abs(float(torch.corrcoef(torch.stack([part[1:], part[:-1]]))[0, 1])) < 0.05
    haze = scene.part_of_gaussian < 0
    assert 0.01 < haze.float().mean() < 0.06
    assert gaussians.opacities[~haze].min() >= 0.6
    flat = gaussians.scales[~haze].sort(dim=1).values
    assert (flat[:, 0] < 0.6 * flat[:, 1]).float().mean() > 0.95
    assert (len(scene.building), len(scene.held_out)) == (SMALL["n_building"], SMALL["n_held_out"])
    assert (scene.regions.view_names, scene.regions.levels) == (scene.building.names, LEVELS)


def drawn_objects(scene: DemoScene) -> tuple[torch.Tensor, torch.Tensor, dict[str, float]]:
    """[H, W] object that a held-out view shows most, its opacity, and the IoU of each name with the truth."""
    objects = torch.from_numpy(scene.parts.at_level(scene.part_of_gaussian.numpy(), "m"))
    one_hot = torch.nn.functional.one_hot(objects + 1, len(scene.parts.objects) + 1)[:, 1:].float()
    camera = scene.held_out[0]
    weights, alpha = render_channels(project(scene.gaussians, camera), one_hot)
    drawn = weights.argmax(-1)
    overlaps = {}
    for name, mask in scene.labelled_frame(camera.name).masks.items():
        shown = drawn == scene.parts.objects.index(name)
        overlaps[name] = float((shown & mask).sum() / (shown | mask).sum())
    return drawn, alpha, overlaps


def test_the_truth_lies_over_the_render(scene: DemoScene):
    drawn, alpha, overlaps = drawn_objects(scene)
    assert (alpha > 0.9).float().mean() > 0.94
    truth = scene.parts.at_level(scene.part_maps[scene.held_out[0].name], "m")
    assert (drawn.numpy() == truth).mean() > 0.85
    assert overlaps["teddy bear"] > 0.8
    assert overlaps["table"] > 0.8
    assert np.mean(list(overlaps.values())) > 0.6


@pytest.mark.slow
def test_the_truth_lies_over_the_render_at_full_size():
    overlaps = list(drawn_objects(make_demo_scene(n_held_out=1))[2].values())
    assert np.mean(overlaps) > 0.8
    assert np.quantile(overlaps, 0.75) > 0.88


def test_labelled_frames_hold_what_is_in_sight(scene: DemoScene):
    name = scene.held_out.names[0]
    frame = scene.labelled_frame(name, ("m", "l"))
    assert frame.name == "held_out_00"
    assert {"table", "teapot", "fruit bowl"} <= set(frame.labels)
    for label, mask in frame.masks.items():
        rows, columns = mask.nonzero().unbind(1)
        x0, y0, x1, y1 = frame.boxes[label][0].tolist()
        assert (columns.min(), rows.min(), columns.max(), rows.max()) == (x0, y0, x1, y1)
    group = scene.parts.groups.index("fruit bowl")
    members = [scene.parts.objects[k] for k in np.flatnonzero(scene.parts.group_of_object == group)]
    union = torch.stack([scene.mask(name, member) for member in members]).any(0)
    assert torch.equal(union, scene.mask(name, "fruit bowl"))


def test_what_cannot_be_made_and_names_that_are_not_known_are_refused(scene: DemoScene):
    wrong_sizes: tuple[dict[str, Any], ...] = ({"n_gaussians": 10}, {"width": 4}, {"n_building": 0})
    for wrong in wrong_sizes:
        with refuses():
            make_demo_scene(**wrong)
    room = TABLE.things()
    with refuses():  # two things of one name
        Parts.of((*room, room[-1]))
    with refuses(UnknownNameError):
        scene.level_of("tea pot")
    with refuses(UnknownNameError):
        scene.text_vectors(["ketle"])


def cosines(rows: torch.Tensor) -> torch.Tensor:
    """Between all pairs of unit rows."""
    return (rows @ rows.T)[torch.ones(len(rows), len(rows), dtype=torch.bool).triu(1)]


def test_regions_are_numbered_without_gaps_and_small_ones_dropped():
    truth = np.full((60, 80), -1, np.int32)
    truth[10:40, 10:50] = 3
    truth[50:52, 60:63] = 5
    for seed in range(10):
        labels = make_regions(truth, "s", np.random.default_rng(seed))
        assert labels.dtype == np.int32
        found = np.unique(labels[labels >= 0])
        assert found.tolist() == list(range(len(found)))
        assert (labels[50:52, 60:63] < 0).all()
    assert (make_regions(np.full((40, 40), -1, np.int32), "l", np.random.default_rng(0)) == -1).all()


def test_region_embeddings_have_the_stated_statistics(scene: DemoScene):
    own, by_name = [], {}
    for view in scene.regions.view_names:
        truth = scene.parts.at_level(scene.part_maps[view], "m")
        found = scene.regions.load(view, "m")
        for region, vector in enumerate(found.embeddings):
            inside = truth[(found.labels == region).numpy()]
            number = int(np.bincount(inside[inside >= 0]).argmax())
            by_name.setdefault(number, []).append(vector)
            own.append(float(vector @ scene.text_vectors([scene.parts.objects[number]])[0]))
    low, middle, high = np.percentile(own, [15, 50, 90])
    assert low > 0.17
    assert 0.23 < middle < 0.28
    assert 0.26 < high < 0.31
    same = torch.cat([cosines(torch.stack(rows)) for rows in by_name.values()])
    assert 0.72 < same.median() < 0.9
    assert 0.45 < cosines(scene.regions.embeddings("m")[0]).median() < 0.65


@pytest.fixture(scope="module")
def folder(scene: DemoScene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("demo") / "scene"
    return write_demo_scene(scene, path)


def test_gaussians_cameras_regions_and_words_come_back(scene: DemoScene, folder: Path):
    gaussians = load_gaussians(folder)
    assert torch.allclose(gaussians.means, scene.gaussians.means)
    assert torch.allclose(gaussians.scales, scene.gaussians.scales, rtol=1e-5)
    cameras = load_cameras(folder)
    assert cameras.names == scene.building.names
    for camera in cameras:
        assert torch.allclose(camera.viewmat, scene.building[camera.name].viewmat, atol=1e-9)
        assert torch.allclose(camera.K, scene.building[camera.name].K)
    regions = load_regions(folder, cameras)
    for level in LEVELS:
        there, here = regions.load(cameras[0].name, level), scene.regions.load(cameras[0].name, level)
        assert torch.equal(there.labels, here.labels)
        assert torch.allclose(there.embeddings, here.embeddings, atol=1e-6)
    table = WordTable.load(folder / "text.npz")
    assert table.names == scene.words.texts
    assert np.abs(table.vectors - scene.words.vectors).max() < 1e-6


def test_labels_of_held_out_views_are_the_truth(scene: DemoScene, folder: Path):
    cameras = load_cameras(folder / "held_out")
    assert cameras.names == scene.held_out.names
    matched = match_frames(read_labels(folder / "held_out" / "label"), cameras)
    assert len(matched) == len(scene.held_out)
    for frame, camera in matched:
        truth = scene.labelled_frame(camera.name, ("m", "l"))
        assert set(frame.labels) == set(truth.labels)
        for label, mask in truth.masks.items():
            assert torch.equal(frame.masks[label], mask), label
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*") if path.is_file()}
    with pytest.raises(OutputExistsError):
        write_demo_scene(scene, folder)
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*") if path.is_file()} == before


def painted(mask: np.ndarray) -> np.ndarray:
    canvas = Image.new("1", mask.shape[::-1])
    for corners, _ in mask_polygons(mask):
        filled = corners + corners[-1:] * (3 - len(corners))
        ImageDraw.Draw(canvas).polygon(filled, fill=1, outline=1)
    return np.array(canvas, bool)


@pytest.mark.parametrize("seed", range(12))
def test_polygons_paint_the_mask_they_came_from(tmp_path: Path, seed: int):
    rng = np.random.default_rng(seed)
    blobs = rng.random((13, 17)) < rng.uniform(0.2, 0.9)
    assert (painted(blobs) == blobs).all()
    large = np.kron(blobs, np.ones((3, 2), bool))
    assert (painted(large) == large).all()
    blobs[[0, -1]] = blobs[:, [0, -1]] = True  # now one piece is around the others
    objects = [{"category": "a", "segmentation": corners} for corners, _ in mask_polygons(blobs)]
    (tmp_path / "a.json").write_text(json.dumps({"info": {"width": 17, "height": 13}, "objects": objects}))
    assert (read_frame(tmp_path / "a.json").masks["a"].numpy() == blobs).all()
    assert {box for _, box in mask_polygons(blobs)} == set(piece_boxes(blobs, 1))
