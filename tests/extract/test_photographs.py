"""Photographs of every kind: orientation, depth, transparency, size; and those that cannot be read."""

from __future__ import annotations

import contextlib
import hashlib
import threading
import warnings
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from PIL import Image, ImageOps

from mask_samples import smooth_image
from messages import refuses, warns
from scoup.base import FileFormatError, MissingFileError, ScoupError, ScoupWarning
from scoup.extract.mask_report import report_masks
from scoup.extract.photograph_choice import points_as_gaussians
from scoup.extract.photographs import (
    Photograph,
    Pixels,
    find_photographs,
    read_ahead,
    read_photograph,
)
from scoup.io import load_image, save_gaussians
from scoup.scene import Camera, Cameras
from scoup_lab.data.colmap_model import write_colmap
from support import make_camera

IMAGE = smooth_image(20, 30)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_orientation_is_undone_for_models_and_put_back_for_cameras(tmp_path: Path, orientation: int) -> None:
    path = tmp_path / "a.png"
    exif = Image.Exif()
    exif[0x0112] = orientation
    Image.fromarray(IMAGE).save(path, exif=exif)
    pixels = read_photograph(path)
    with Image.open(path) as stored:
        upright = np.asarray(ImageOps.exif_transpose(stored).convert("RGB"))
    assert (pixels.image == upright).all()
    assert (pixels.as_stored(pixels.image[..., 0].astype(np.int32)) == IMAGE[..., 0]).all()
    left = np.arange(30) < 10  # stored; of twice the size
    mask = Image.fromarray(np.where(left, 0, 9).repeat(2)[None].repeat(40, 0).astype(np.uint8))
    for name, expected in (
        ("m.png", left),
        ("dynamic_mask_a.png", ~left),
    ):  # instant-ngp's: the other way round
        mask.save(tmp_path / name)
        masked = read_photograph(path, mask=tmp_path / name).masked
        assert masked is not None
        assert (pixels.as_stored(masked) == expected).all()
    assert pixels.digest == hashlib.sha256(path.read_bytes()).hexdigest()


def test_depths_and_modes(tmp_path: Path) -> None:
    grey = IMAGE[..., 0]
    deep = (grey.astype(np.uint16) << 8) + 7
    cases = {
        "grey.png": (Image.fromarray(grey), grey),
        "deep.png": (Image.fromarray(deep), grey),
        "deep.tif": (Image.fromarray(deep), grey),
        "wide.tif": (Image.fromarray(deep.astype(np.int32)), grey),
        "wider.tif": (Image.fromarray(grey.astype(np.int32) << 23), grey),
        "float.tif": (Image.fromarray(grey.astype(np.float32) / 255), grey),
        "float_bytes.tif": (Image.fromarray(grey.astype(np.float32)), grey),
        "float_deep.tif": (Image.fromarray(deep.astype(np.float32)), grey),
        "alpha.png": (Image.fromarray(np.dstack([IMAGE, grey])), None),
        "grey_alpha.png": (Image.fromarray(np.dstack([grey, grey]), "LA"), grey),
        "palette.png": (Image.fromarray(IMAGE).convert("P"), None),
        "print.tif": (Image.fromarray(IMAGE).convert("CMYK"), None),
        "bits.png": (Image.fromarray(grey > 128), np.where(grey > 128, 255, 0)),
        "small.webp": (Image.fromarray(IMAGE), None),
    }
    for name, (image, expected) in cases.items():
        image.save(tmp_path / name)
        pixels = read_photograph(tmp_path / name).image
        assert pixels.shape == (20, 30, 3), name
        assert pixels.dtype == np.uint8
        wanted = IMAGE if expected is None else np.repeat(expected[..., None], 3, 2)
        worst = 60 if name in ("palette.png", "small.webp") else 1
        assert np.abs(pixels.astype(int) - wanted).max() <= worst, name
        camera = make_camera(30, 20, image_path=tmp_path / name)
        assert (load_image(camera).numpy() == pixels).all(), name


def test_high_photographs_are_reduced_as_langsplat_does(tmp_path: Path) -> None:
    Image.fromarray(smooth_image(100, 77)).save(tmp_path / "a.png")
    for most, size in ((60, (60, 46)), (100, (100, 77))):  # 46.2, truncated
        assert read_photograph(tmp_path / "a.png", most).image.shape == (*size, 3)


def test_what_is_no_photograph(tmp_path: Path) -> None:
    Image.fromarray(np.linspace(-0.5, 0.5, 81, dtype=np.float32).reshape(9, 9)).save(tmp_path / "float.tif")
    Image.fromarray(IMAGE).save(tmp_path / "whole.jpg")
    (tmp_path / "cut.jpg").write_bytes((tmp_path / "whole.jpg").read_bytes()[:300])
    (tmp_path / "text.png").write_text("no image")
    for name in ("float.tif", "cut.jpg", "text.png"):
        with refuses(FileFormatError):
            read_photograph(tmp_path / name)


def test_reading_ahead_keeps_order_and_errors(tmp_path: Path) -> None:
    for number in range(7):
        Image.fromarray(np.full((4, 5, 3), number, np.uint8)).save(tmp_path / f"{number}.png")
    (tmp_path / "3.png").write_text("damaged")
    photographs = [Photograph(f"{number}.png", tmp_path / f"{number}.png") for number in range(7)]
    seen = list(read_ahead(photographs))
    assert [item.name for item, _ in seen] == [f"{number}.png" for number in range(7)]
    assert isinstance(seen.pop(3)[1], ScoupError)
    for item, result in seen:
        assert not isinstance(result, ScoupError)
        assert (result.image == int(item.name[0])).all()
    stopped = read_ahead(photographs)
    next(stopped)
    stopped.close()  # interrupted: the threads end


def test_which_photographs_a_scene_has(tmp_path: Path) -> None:
    folder = tmp_path / "scene"
    (folder / "images_2" / "left").mkdir(parents=True)
    for name in ("b.png", "a.JPG", "left/c.png", "._a.JPG", "notes.txt"):
        (folder / "images_2" / name).write_bytes(b"")
        if not name.startswith(".") and name.lower().endswith(("png", "jpg")):
            Image.fromarray(IMAGE).save(folder / "images_2" / name)
    assert [item.name for item in find_photographs(folder)] == ["a.JPG", "b.png", "left/c.png"]
    assert [item.name for item in find_photographs(folder / "images_2" / "left")] == ["c.png"]
    assert [item.name for item in find_photographs(tmp_path, folder / "images_2" / "left")] == ["c.png"]
    write_colmap(Cameras([make_camera(30, 20, name="b.png")]), folder / "sparse" / "0")
    assert [item.name for item in find_photographs(folder)] == ["b.png"]  # those of the cameras
    cameras = [make_camera(30, 20, name=name) for name in ("b.png", "gone.png")]
    write_colmap(Cameras(cameras), folder / "sparse" / "0", overwrite=True)
    with warns(ScoupWarning):
        assert [item.name for item in find_photographs(folder)] == ["b.png"]
    (folder / "images_2" / "b.png").unlink()
    with refuses(FileFormatError):
        find_photographs(folder)
    (tmp_path / "empty").mkdir()
    for name in ("nowhere", "empty"):
        with refuses(MissingFileError):
            find_photographs(tmp_path / name)


LEFT = np.arange(30) < 10
PLACES = {
    "COLMAP": "masks/cam.1/a.jpg.png", "LichtFeld": "masks/cam.1/a.png", "mask": "mask/cam.1/a.jpg",
    "dots": "masks/cam.1/a.jpg.mask.png", "in images": "images/masks/cam.1/a.png",
    "RealityScan": "images/cam.1/a.jpg.mask.png", "3DGRUT": "images/cam.1/a_mask.png",
    "beside": "images/cam.1/masks/a.png",
    "doubled": "images/cam.1/a.jpg.png", "instant-ngp": "images/cam.1/dynamic_mask_a.png",
}  # fmt: skip


@pytest.mark.parametrize("cameras", [True, False])
@pytest.mark.parametrize("place", PLACES)
def test_masks_of_other_programs(tmp_path: Path, place: str, cameras: bool) -> None:
    hidden = ~LEFT if place == "instant-ngp" else LEFT
    for name, pixels in (("images/cam.1/a.jpg", IMAGE), (PLACES[place], 255 * ~hidden[None].repeat(20, 0))):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(pixels.astype(np.uint8)).save(tmp_path / name)
    if cameras:
        write_colmap(Cameras([make_camera(30, 20, name="cam.1/a.jpg")]), tmp_path / "sparse/0")
    (item,) = find_photographs(tmp_path)
    assert item.mask == tmp_path / PLACES[place]
    (_, pixels), *_ = read_ahead([item])
    assert isinstance(pixels, Pixels)
    assert pixels.masked is not None
    assert (pixels.masked == LEFT).all()
    assert "1 mask: 33% of the pixels" in report_masks([item])
    (tmp_path / "images/cam.1/a.jpg").unlink()
    with pytest.raises(MissingFileError if not cameras else FileFormatError):
        find_photographs(tmp_path)


MEANINGS: tuple[tuple[Literal["white", "black", False], str], ...] = (
    ("white", "67%"), ("black", "33%"), (False, ""),
)  # fmt: skip


def test_masks_that_hide_most_are_asked_for(tmp_path: Path) -> None:
    (tmp_path / "masks").mkdir()
    for number in range(3):
        Image.fromarray(IMAGE).save(tmp_path / f"{number}.png")
        Image.fromarray(LEFT[None].repeat(20, 0)).save(tmp_path / f"masks/{number}.png")
    with refuses():
        report_masks(find_photographs(tmp_path))
    for masks, share in MEANINGS:
        found = find_photographs(tmp_path, masks=masks)
        assert report_masks(found) == (f"3 masks: {share} of the pixels get no regions" if share else "")


@pytest.mark.parametrize("known", ["splat", "points", "nothing"])
def test_masks_that_hide_the_scene_are_asked_for(tmp_path: Path, known: str) -> None:
    """It is left in all photographs; where nothing tells that, the middle counts. Less than half of each is hidden."""
    points = np.random.default_rng(0).normal((-1.0, 0, 0), (0.1, 0.1, 0.3), (200, 3))
    eyes = [(0.1 * number, -4.0, 0.0) for number in range(4)]
    cameras = Cameras(
        Camera.look_at(eye, (eye[0], 0, 0), f"{number}.png", 30, 20, 30.0, up=(0, 0, 1))
        for number, eye in enumerate(eyes)
    )
    if known != "nothing":
        write_colmap(cameras, tmp_path / "sparse/0", (points, np.zeros((200, 3), np.uint8)))
    if known == "splat":
        (tmp_path / "sparse/0/points3D.bin").unlink()
        save_gaussians(points_as_gaussians(points), tmp_path / "point_cloud.ply")
    for folder in ("images", "masks"):
        (tmp_path / folder).mkdir()
    columns, rows = np.meshgrid(np.arange(30), np.arange(20))
    middle, left, right = (abs(columns - 14.5) < 8) & (abs(rows - 9.5) < 7), columns < 13, columns > 16
    for hidden, wrong in ((middle, known == "nothing"), (left, known != "nothing"), (right, False)):
        for name in cameras.names:
            Image.fromarray(0 * IMAGE).save(tmp_path / "images" / name)
            Image.fromarray(~hidden).save(tmp_path / "masks" / name)
        asked = refuses() if wrong else contextlib.nullcontext()
        with asked:
            report_masks(find_photographs(tmp_path), tmp_path)
        report_masks(find_photographs(tmp_path, masks="white"), tmp_path)


def test_transparency_is_a_mask(tmp_path: Path) -> None:
    alpha = np.where(LEFT, 0, 255).astype(np.uint8)[None].repeat(20, 0)
    for name, of in (("a.png", alpha), ("opaque.png", 0 * alpha + 255), ("nowhere.png", 0 * alpha)):
        Image.fromarray(np.dstack([IMAGE, of])).save(tmp_path / name)
    masked = {
        name: read_photograph(tmp_path / name).masked for name in ("a.png", "opaque.png", "nowhere.png")
    }
    assert masked["opaque.png"] is masked["nowhere.png"] is None
    assert masked["a.png"] is not None
    assert (masked["a.png"] == LEFT).all()
    assert read_photograph(tmp_path / "a.png", masks_keep="all").masked is None
    assert "transparent photographs: 11%" in report_masks(find_photographs(tmp_path))


def test_threads_that_decode_leave_the_filters_of_warnings_alone(tmp_path: Path, monkeypatch) -> None:
    """Filters belong to the process: two threads that set and restore them may leave all warnings ignored."""
    for number in range(5):
        Image.new("RGB", (8, 6)).save(tmp_path / f"{number}.png")
    entered = []

    class Recorded(warnings.catch_warnings):
        def __enter__(self):
            entered.append(threading.current_thread())
            return super().__enter__()

    photographs = [Photograph(path.name, path) for path in sorted(tmp_path.iterdir())]
    monkeypatch.setattr(warnings, "catch_warnings", Recorded)
    assert len(list(read_ahead(photographs))) == 5
    assert set(entered) == {threading.main_thread()}
