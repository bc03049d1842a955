"""Photographs, pictures and undistortion."""

from __future__ import annotations

import contextlib
import struct
import tracemalloc
import unicodedata
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from tests.fuzzing.containers import PNG

from messages import refuses
from scoup.base import FileFormatError, MissingFileError
from scoup.io.cameras.undistort import photograph_pixels, sample_bilinear, sample_nearest
from scoup.io.image_folder import ImageFolder, find_beside
from scoup.io.images import image_size, load_image, save_png
from scoup.scene import Camera
from scoup_lab.evaluate.protocols.threed_ovs import read_mask


def camera_of(width=64, height=48, distortion=(), image_path=None) -> Camera:
    intrinsics = torch.tensor([[50.0, 0, 31.0], [0, 52.0, 25.0], [0, 0, 1]])
    return Camera("a.png", torch.eye(4), intrinsics, width, height, image_path, distortion)


def test_png_round_trip(tmp_path):
    image, path = torch.randint(0, 256, (48, 64, 3), dtype=torch.uint8), tmp_path / "deep" / "a.png"
    save_png(image, path)
    assert torch.equal(load_image(camera_of(image_path=path)), image)
    assert image_size(path) == (64, 48)
    save_png(image[..., 0] > 100, path, overwrite=True)
    assert torch.equal(load_image(camera_of(image_path=path))[..., 1] == 255, image[..., 0] > 100)
    with refuses():
        save_png(image.float(), tmp_path / "b.png")
    assert not (tmp_path / "b.png").exists()


def test_image_comes_at_the_size_of_the_camera(tmp_path):
    gradient = torch.arange(128, dtype=torch.uint8).repeat(96, 1)[..., None].repeat(1, 1, 3)
    save_png(gradient, tmp_path / "a.png")
    image = load_image(camera_of(image_path=tmp_path / "a.png"))
    assert image.shape == (48, 64, 3)
    expected = torch.arange(64) * 2.0 + 0.5
    assert (image[20, 4:-4, 0] - expected[4:-4]).abs().max() <= 1.0


def test_missing_and_damaged_images(tmp_path):
    path = tmp_path / "a.png"
    for missing in (None, path):
        with refuses(MissingFileError):
            load_image(camera_of(image_path=missing))
    save_png(torch.randint(0, 256, (48, 64, 3), dtype=torch.uint8), path)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(FileFormatError, match="cannot be decoded"):
        load_image(camera_of(image_path=path))
    path.write_bytes(whole[:16] + b"\x7f\xff\xff\xff" * 2 + whole[24:])
    with refuses(FileFormatError):
        load_image(camera_of(image_path=path))


def touched(folder: Path, *names: str) -> ImageFolder:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(b"")
    return ImageFolder(folder)


def test_images_are_found_by_their_paths(tmp_path):
    folder = touched(tmp_path, "left/view_00.png", "right/view_00.png", "right/view_01.png")
    assert len(folder) == 3
    assert folder.find("left/view_00.png") == tmp_path / "left" / "view_00.png"
    assert folder.find("left/view_00") == tmp_path / "left" / "view_00.png"
    assert folder.find("view_01") == tmp_path / "right" / "view_01.png"  # the only one
    assert folder.find("right/view_01.jpg") == tmp_path / "right" / "view_01.png"  # no .jpg there
    for name in ("left/view_01.png", "elsewhere/view_01.png", "view_00", "", ".."):
        assert folder.find(name) is None, name
    left = ImageFolder(tmp_path / "left")
    for name in ("left/view_00.png", "/old/machine/images/view_00.png", "../left/view_00.png"):
        assert left.find(name) == tmp_path / "left" / "view_00.png"
    half = touched(tmp_path / "images_2", "cam1/a.jpg", "b.JPG")
    assert half.find("images/cam1/a.jpg") == tmp_path / "images_2" / "cam1" / "a.jpg"
    assert half.find("b.jpg") == half.find("b") == tmp_path / "images_2" / "b.JPG"
    assert half.find("a.jpg") is None  # beside those of no sub-folder


def test_masks_and_depth_maps_are_never_photographs(tmp_path):
    names = ("a.jpg", "a.jpg.png", "masks/a.jpg", "b.jpg.png", "masks/b.jpg", "depth/b.png", "c.png")
    more = ("c.old.jpg", "d.jpg", "d.png", "._a.jpg", "dynamic_mask_a.png")
    folder = touched(tmp_path / "top", *names, *more)
    assert folder.find("a") == tmp_path / "top" / "a.jpg"
    for name in ("b", "b.jpg", "b.png", "c.jpg"):
        assert folder.find(name) is None, name
    assert folder.find("masks/b.jpg") == tmp_path / "top" / "masks" / "b.jpg"  # by its path anything
    assert list(folder.photographs()) == ["a.jpg", "c.old.jpg", "c.png", "d.jpg", "d.png"]
    assert touched(tmp_path / "maps", "depth/a.png", "sky_masks/a.png").find("a.png") is None
    both = touched(tmp_path / "both", "rgb/a.png", "depth/a.png")
    assert both.find("a") == tmp_path / "both" / "rgb" / "a.png"
    assert find_beside(tmp_path / "top", "b.jpg") is None


def test_linked_folders(tmp_path):
    touched(tmp_path / "store", "a.jpg")
    (tmp_path / "store" / "again").symlink_to(tmp_path / "store")
    (tmp_path / "images").mkdir()
    for name in ("cam1", "cam2"):
        (tmp_path / "images" / name).symlink_to(tmp_path / "store")
    folder = ImageFolder(tmp_path / "images")
    assert list(folder.photographs()) == ["cam1/a.jpg", "cam2/a.jpg"]
    assert folder.find("cam2/a.jpg") == tmp_path / "images/cam2/a.jpg"


@pytest.mark.parametrize("form", ["NFC", "NFD"])
def test_accents_of_either_form(tmp_path, form):
    for other in ("NFC", "NFD"):
        folder = touched(tmp_path / other, unicodedata.normalize(other, "Küche/é.jpg"))
        name = unicodedata.normalize(form, "Küche/é")
        assert folder.find(f"{name}.jpg") == folder.find(name) == folder.photographs()["Küche/é.jpg"]
        assert find_beside(tmp_path / other, name) == folder.find(name)
        assert folder.find(name.upper()) == folder.find(name.replace("/", "\\")) == folder.find(name)
        assert folder.find(f"./{name}") == folder.find(name)


def test_no_distortion_is_the_identity():
    camera = camera_of()
    positions = photograph_pixels(camera, 64, 48)
    assert positions[3, 5].tolist() == pytest.approx([5.5, 3.5])
    labels = torch.randint(-1, 9, (48, 64), dtype=torch.int32)
    assert torch.equal(sample_nearest(labels, positions, -1), labels)
    image = torch.randint(0, 256, (48, 64, 3), dtype=torch.uint8)
    assert torch.equal(sample_bilinear(image, positions), image)


def test_pycolmap_agrees_on_the_lens_model():
    pycolmap = pytest.importorskip("pycolmap")
    coefficients = (0.1, -0.03, 0.002, -0.004)
    camera = camera_of(distortion=coefficients)
    theirs = pycolmap.Camera(model="OPENCV", width=64, height=48, params=[50, 52, 31, 25, *coefficients])
    ours = photograph_pixels(camera, 64, 48)
    for row, column in ((0, 0), (47, 63), (20, 33), (40, 2)):
        ray = np.array([(column + 0.5 - 31) / 50, (row + 0.5 - 25) / 52, 1.0])
        np.testing.assert_allclose(ours[row, column], theirs.img_from_cam(ray).ravel(), atol=1e-9)
    scaled = photograph_pixels(camera, 32, 96)[40, 10] * torch.tensor([2.0, 0.5])
    torch.testing.assert_close(scaled, ours[40, 10])


def test_folded_and_outside_pixels_are_empty():
    labels, nine = torch.ones(48, 64, dtype=torch.int32), torch.full((48, 64, 3), 9, dtype=torch.uint8)
    for distortion, folded in (((-0.9, 0.0, 0.0, 0.0), True), ((0.5, 0.1, 0.0, 0.0), False)):  # and a cushion
        positions = photograph_pixels(camera_of(distortion=distortion), 64, 48)
        assert torch.isnan(positions[0, 0]).all() == folded
        assert sample_nearest(labels, positions, -1)[[0, 25], [0, 31]].tolist() == [-1, 1]
        assert not sample_bilinear(nine, positions)[0, 0].any()


def test_undistorted_image_straightens(tmp_path):
    """A photograph drawn by the forward model of a lens comes back as the ideal picture."""
    camera = camera_of(distortion=(-0.2, 0.05, 0.0, 0.0))
    positions = photograph_pixels(camera, 64, 48)
    x = torch.arange(256, dtype=torch.float64)[None, :].expand(192, 256) / 4 + 0.125
    photograph = (x * 2).clamp(0, 255).to(torch.uint8)[..., None].repeat(1, 1, 3)
    save_png(photograph, tmp_path / "a.png")
    image = load_image(replace(camera, image_path=tmp_path / "a.png"))
    inside = (positions[..., 0] > 2) & (positions[..., 0] < 62)
    assert ((image[..., 0] - 2 * positions[..., 0]).abs()[inside] < 2).all()


def test_no_memory_for_pixels_that_cannot_be_there(tmp_path: Path) -> None:
    """A PNG of many pixels in its header, and none in its data."""
    path = tmp_path / "a.png"
    save_png(torch.zeros(8, 8, 3, dtype=torch.uint8), path)
    whole = path.read_bytes()
    header = struct.pack(">II", 12_000, 12_000) + PNG.split(whole)[0][8:]
    path.write_bytes(PNG.join(whole, [header, b"", b""]))
    assert image_size(path) == (12_000, 12_000)
    for read in (lambda: load_image(camera_of(image_path=path)), lambda: read_mask(path, 0)):
        with refuses(FileFormatError):
            read()


def test_a_chunk_that_claims_gigabytes_takes_no_memory(tmp_path: Path) -> None:
    """Pillow reads the rest of the last chunk at once, by the length that the file says."""
    save_png(torch.zeros(8, 8, 3, dtype=torch.uint8), tmp_path / "a.png")
    whole = (tmp_path / "a.png").read_bytes()
    place = whole.index(b"IDAT") - 4
    (tmp_path / "a.png").write_bytes(whole[:place] + b"\x7f\xff\xff\xff" + whole[place + 4 :])
    tracemalloc.start()
    try:
        with contextlib.suppress(FileFormatError):
            load_image(camera_of(8, 8, image_path=tmp_path / "a.png"))
        assert tracemalloc.get_traced_memory()[1] < 16 << 20
    finally:
        tracemalloc.stop()
