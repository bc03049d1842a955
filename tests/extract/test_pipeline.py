"""The pipeline: resumes, refuses, renews, skips and shares out; nothing is ever half written."""

from __future__ import annotations

import json
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

import scoup
from cli_support import snapshot
from mask_samples import smooth_image
from messages import refuses, warns
from scoup.base import Part, ScoupError, ScoupWarning
from scoup.extract import (
    Masks,
    extract,
    find_photographs,
    open_embedder,
    open_segmenter,
    pipeline,
    registry,
)
from scoup.extract.masks import paint
from scoup.extract.photographs import Photograph
from scoup.extract.pipeline import embed_masks
from scoup.extract.settings import MaskSettings
from scoup.io import RegionManifest
from scoup.io.regions.manifest import MANIFEST, write_manifest
from scoup.models.plain_colors import PlainColors
from scoup.scene import LEVELS, Cameras
from support import make_camera
from tiny_models import saved, tiny_clip, tiny_sam2


class Blocks:
    """A quick segmenter: squares of three sizes; interrupted once it has segmented some photographs, if asked to."""

    cut_last = False
    drop_hidden = False

    def __init__(self, side: int = 8, interrupted_after: int | None = None) -> None:
        self.side = side
        self.calls, self.most = 0, interrupted_after

    def to_dict(self) -> dict[str, object]:
        return {"segmenter": "blocks", "side": self.side}

    def segment(self, image: np.ndarray) -> dict[str, Masks]:
        if self.calls == self.most:
            raise KeyboardInterrupt
        self.calls += 1
        result = {}
        for number, level in enumerate(LEVELS):
            side = self.side * 2**number
            rows, columns = (np.arange(length) // side for length in image.shape[:2])
            labels = rows[:, None] * (columns.max() + 1) + columns[None]
            result[level] = Masks.from_labels(labels.astype(np.int32))
        return result


def scene(folder: Path, count: int = 4) -> tuple[Path, Cameras]:
    (folder / "images").mkdir(parents=True)
    cameras = []
    for number in range(count):
        height, width = (24, 32) if number % 2 else (30, 20)  # any mix of sizes
        Image.fromarray(smooth_image(height, width, number)).save(folder / "images" / f"{number}.png")
        cameras.append(make_camera(width, height, name=f"{number}.png"))
    return folder, Cameras(cameras)


def test_regions_are_read_back(tmp_path: Path) -> None:
    folder, cameras = scene(tmp_path)
    segmenter, embedder = Blocks(), PlainColors()
    out = folder / "language_features"
    report = extract(find_photographs(folder), out, segmenter, embedder)
    assert (report.made, report.kept, report.skipped) == ([f"{n}.png" for n in range(4)], 0, {})
    regions = scoup.load_regions(folder, cameras)
    assert regions.view_names == cameras.names
    total = 0
    for number, camera in enumerate(cameras):
        image = smooth_image(camera.height, camera.width, number)
        for level, masks in segmenter.segment(image).items():
            item = regions.load(camera.name, level)
            assert (item.labels.numpy() == paint(masks)).all()
            assert item.embeddings.shape == (len(masks), embedder.dim)
            total += len(masks)
    assert report.regions == total
    assert json.loads((out / MANIFEST).read_text())["embedding_model"] == "colors"


def test_what_is_masked_gets_no_regions(tmp_path: Path) -> None:
    folder, cameras = scene(tmp_path, 1)
    mask = np.zeros((30, 20), np.uint8)
    mask[:, 12:] = 255
    Image.fromarray(mask).save(tmp_path / "m.png")
    photograph = Photograph("0.png", folder / "images" / "0.png", tmp_path / "m.png")
    extract([photograph], folder / "language_features", Blocks(), PlainColors())
    item = scoup.load_regions(folder, cameras).load("0.png", "s")
    assert (item.labels[:, :12] == -1).all()
    assert (item.labels[:, 12:] >= 0).all()
    assert len(item.embeddings) == 8  # of 12 squares of 8 pixels, those of columns 8 to 15 and 16 to 19


def test_work_goes_on_where_it_stopped(tmp_path: Path) -> None:
    folder, _ = scene(tmp_path)
    photographs = find_photographs(folder)
    whole, out = tmp_path / "whole", tmp_path / "out"
    seen: list[tuple[int, int]] = []
    extract(photographs, whole, Blocks(), PlainColors(), progress=lambda _, *at: seen.append(at))
    assert seen == [(done, 4) for done in range(5)]
    with pytest.raises(KeyboardInterrupt):
        extract(photographs, out, Blocks(interrupted_after=2), PlainColors())
    before, segmenter = snapshot(out), Blocks()
    report = extract(photographs, out, segmenter, PlainColors(), progress=lambda _, *at: seen.append(at))
    assert seen[5:] == [(2, 4), (3, 4), (4, 4)]
    assert (len(report.made), report.kept, segmenter.calls) == (2, 2, 2)
    after = snapshot(out)
    assert {name: after[name] for name in before} == before  # nothing is done twice
    assert after == snapshot(whole)


@pytest.mark.parametrize("kind", ["cut", "gone", "empty", "changed photograph", "changed mask", "new mask"])
def test_damaged_views_and_changed_photographs_are_done_again(tmp_path: Path, kind: str) -> None:
    folder, _ = scene(tmp_path)
    out, mask = tmp_path / "out", folder / "masks" / "1.png"
    mask.parent.mkdir()
    pixels = np.zeros((30, 20), np.uint8)
    pixels[:, 12:] = 255
    if kind == "changed mask":
        Image.fromarray(255 - pixels).save(mask)
    extract(find_photographs(folder), out, Blocks(), PlainColors())
    whole, victim = snapshot(out), out / "1.regions"
    if kind == "changed photograph":
        Image.fromarray(smooth_image(24, 32, 99)).save(folder / "images" / "1.png")
    elif "mask" in kind:
        Image.fromarray(pixels).save(mask)
    elif kind == "gone":
        victim.unlink()
    else:
        victim.write_bytes(victim.read_bytes()[: 0 if kind == "empty" else 20])
    report = extract(find_photographs(folder), out, Blocks(), PlainColors())
    assert (report.made, report.kept) == (["1.png"], 3)
    assert (snapshot(out) == whole) == (not kind.endswith(("photograph", "mask")))
    for masks in ("white", "black", False, None):  # what a mask means is part of it; None means white here
        report = extract(find_photographs(folder, masks=masks), out, Blocks(), PlainColors())
        expected = ["1.png"] if "mask" in kind and masks != "white" else []
        assert (report.made, report.kept) == (expected, 4 - len(expected))


def test_changed_settings_are_refused_with_a_choice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, cameras = scene(tmp_path)
    photographs, out = find_photographs(folder), tmp_path / "out"
    extract(photographs, out, Blocks(), PlainColors())
    before = snapshot(out)
    for side, most in ((8, 10), (16, 1080)):
        with refuses(), monkeypatch.context() as patch:
            patch.setattr(pipeline, "MAX_HEIGHT", most)
            extract(photographs, out, Blocks(side), PlainColors())
    assert snapshot(out) == before
    # Given up for other settings, and interrupted: what is left of the old ones does not count.
    with pytest.raises(KeyboardInterrupt):
        extract(photographs, out, Blocks(16, interrupted_after=1), PlainColors(), overwrite=True)
    with warns(ScoupWarning):
        assert scoup.load_regions(out, cameras).view_names == ("0.png",)
    report = extract(photographs, out, Blocks(16), PlainColors())
    assert (len(report.made), report.kept) == (3, 1)
    assert len(scoup.load_regions(out, cameras)) == 4


def test_photographs_that_cannot_be_read_are_counted(tmp_path: Path) -> None:
    folder, _ = scene(tmp_path)
    photographs = find_photographs(folder)
    for name in ("1.png", "3.png"):
        (folder / "images" / name).write_text("damaged")
    with warns(ScoupWarning):
        report = extract(photographs, tmp_path / "out", Blocks(), PlainColors())
    assert (report.made, list(report.skipped)) == (["0.png", "2.png"], ["1.png", "3.png"])
    with refuses(ScoupError):
        extract(photographs[1:2], tmp_path / "other", Blocks(), PlainColors())


def test_two_photographs_of_one_stem_are_refused(tmp_path: Path) -> None:
    folder, _ = scene(tmp_path)
    Image.fromarray(smooth_image(9, 9)).save(folder / "images" / "1.jpg")
    with refuses():
        extract(find_photographs(folder), tmp_path / "out", Blocks(), PlainColors())
    assert not (tmp_path / "out").exists()


def test_hidden_masks_are_dropped_where_wanted(tmp_path: Path) -> None:
    class Covered(Blocks):
        def segment(self, image: np.ndarray) -> dict[str, Masks]:
            dense = np.zeros((3, *image.shape[:2]), bool)
            dense[0, :5], dense[1, :9], dense[2, 12:] = True, True, True
            return {level: Masks.from_dense(dense) for level in LEVELS}

    folder, cameras = scene(tmp_path, 1)
    for drop, rows in ((False, 3), (True, 2)):
        segmenter = Covered()
        segmenter.drop_hidden = drop
        extract(find_photographs(folder), tmp_path / str(drop), segmenter, PlainColors())
        item = scoup.load_regions(tmp_path / str(drop), cameras).load("0.png", "s")
        assert len(item.embeddings) == rows
        assert item.labels.unique().tolist() == ([-1, 0, 1] if drop else [-1, 1, 2])


class Counted(PlainColors):
    """Counts crops, and takes a second for each by a clock of its own."""

    crops = 0
    now = 0.0

    def embed(self, crops: torch.Tensor) -> torch.Tensor:
        self.crops += len(crops)
        self.now += len(crops)
        return super().embed(crops)


@pytest.mark.parametrize(("cut_last", "crops"), [(True, 4), (False, 3)])
def test_a_region_of_two_levels_is_embedded_once(cut_last: bool, crops: int) -> None:
    image = smooth_image(40, 60)
    dense = np.zeros((5, 40, 60), bool)
    dense[0, :20, :30] = dense[1, 20:, :30] = dense[2, :20, :30] = dense[3, 20:, 1:30] = True
    dense[4, :, 30:] = True
    masks = {"s": Masks.from_dense(dense[:2]), "m": Masks.from_dense(dense[2:])}
    embedder = Counted()
    shared = embed_masks(image, masks, embedder, cut_last)
    assert embedder.crops == crops  # of IoU 1 and .97
    for level, level_masks in masks.items():
        (alone,) = embed_masks(image, {level: level_masks}, PlainColors(), cut_last).values()
        assert ((shared[level] * alone).sum(1) > 0.99).all()
    assert embed_masks(image, {"s": Masks.from_dense(dense[:0])}, embedder)["s"].shape == (0, embedder.dim)


def test_how_long_crops_take(monkeypatch: pytest.MonkeyPatch) -> None:
    embedder = Counted()
    monkeypatch.setattr(pipeline.time, "perf_counter", lambda: embedder.now)
    assert pipeline.crops_minutes(embedder, 3) == 3 * 100 / 60  # a second for each crop


def test_memory_does_not_grow_with_the_number_of_photographs(tmp_path: Path) -> None:
    (tmp_path / "images").mkdir()
    for number in range(14):
        Image.fromarray(smooth_image(200, 300, number)).save(tmp_path / "images" / f"{number:02d}.png")
    photographs = find_photographs(tmp_path)
    extract(photographs[:1], tmp_path / "warm", Blocks(64), PlainColors())
    peaks = []
    for count in (4, 14):
        tracemalloc.start()
        extract(photographs[:count], tmp_path / str(count), Blocks(64), PlainColors())
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    # Not ten more images. How many are read ahead at the peak, and copied by decoders, depends on the threads.
    assert peaks[1] < peaks[0] + 8 * 200 * 300 * 3


def test_the_commit_of_a_model_stays_while_work_goes_on(tmp_path: Path, monkeypatch) -> None:
    """A hub model may move on between two runs: the second must not use another one for the rest."""
    opened: list[str | None] = []
    monkeypatch.setattr(registry, "open_segmenter", lambda _, s, revision, *rest: opened.append(revision))
    monkeypatch.setattr(registry, "open_embedder", lambda _, revision, *rest: opened.append(revision))
    record = {
        "segmenter": "facebook/sam-vit-huge", "segmenter_revision": "abc",
        "embedder": "some/clip", "embedder_revision": "",
    }  # fmt: skip
    write_manifest(tmp_path, RegionManifest("some/clip", record))
    for name, resumed in (("h", tmp_path), ("b", tmp_path), ("h", None), ("h", tmp_path / "nowhere")):
        registry.open_pair(f"sam-vit-{name}", "some/clip", MaskSettings(), resumed=resumed)
    assert opened == ["abc", *[None] * 7]


def test_parts_make_together_what_one_makes_alone(tmp_path: Path) -> None:
    folder, _ = scene(tmp_path, 5)
    photographs = find_photographs(folder)
    extract(photographs, tmp_path / "one", Blocks(), PlainColors())
    for number in (3, 1, 2):
        report = extract(photographs, tmp_path / "three", Blocks(), PlainColors(), part=Part(number, 3))
        assert report.made == [item.name for item in photographs[number - 1 :: 3]]
    assert snapshot(tmp_path / "one") == snapshot(tmp_path / "three")


def test_tiny_models_from_end_to_end(tmp_path: Path) -> None:
    """SAM 2 and CLIP as their files are loaded, through the rules, to regions that ``load_regions`` reads."""
    folder, cameras = scene(tmp_path, 2)
    settings = MaskSettings(
        points_per_side=3, predicted_iou=0.0, stability=0.3, stability_offset=0.02, least_score=0.0, crop_layers=0,
        least_area=4,
    )  # fmt: skip
    sam = str(saved(tiny_sam2(), tmp_path / "sam"))
    segmenter = open_segmenter(sam, settings)
    embedder = open_embedder(str(saved(tiny_clip(), tmp_path / "clip")))
    out = tmp_path / "out"
    extract(find_photographs(folder), out, segmenter, embedder)
    regions = scoup.load_regions(out, cameras)
    for level in LEVELS:
        rows, _ = regions.embeddings(level)
        torch.testing.assert_close(rows.norm(dim=1), torch.ones(len(rows)))
    assert sum(len(regions.embeddings(level)[0]) for level in LEVELS) >= 3
    record = json.loads((out / MANIFEST).read_text())["settings"]
    assert record["segmenter"] == str(tmp_path / "sam")
    assert record["points_per_side"] == 3
