"""The layout of LangSplat and the compact layout of region features, damage to them, and conversion."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from itertools import pairwise, product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from safetensors.numpy import load, save
from tests.fuzzing.containers import SEALED

from cli_support import snapshot
from io_samples import (
    MANIFEST_OF_TESTS,
    planes_of,
    save_compact,
    save_langsplat,
    save_npy,
    some_cameras,
    some_regions,
    unit_rows,
)
from messages import refuses, warns
from scoup.base import (
    FileFormatError,
    InputError,
    MissingFileError,
    OutputExistsError,
    ScoupWarning,
    UnknownNameError,
)
from scoup.io import RegionManifest, ViewRegions, convert_regions, load_regions
from scoup.io.cameras.undistort import photograph_pixels, sample_nearest
from scoup.io.regions.compact import open_view, write_view
from scoup.io.regions.langsplat import level_blocks
from scoup.io.regions.manifest import write_manifest
from scoup.io.regions.store import read_view
from scoup.scene import LEVELS, Cameras


def test_what_langsplat_writes(tmp_path):
    """Values are global row numbers; each level is offset by the sizes of those before."""
    rows = unit_rows(9)
    save_npy(tmp_path, "view_00", planes_of([-1, 0, 1], [2, 3, 4], [-1, 5, 6], [7, 8]), rows)
    regions = load_regions(tmp_path, some_cameras(1))
    for level, start, end in (("s", 2, 5), ("m", 5, 7), ("l", 7, 9)):
        item = regions.load("view_00.png", level)
        np.testing.assert_allclose(item.embeddings, rows[start:end], atol=1e-7)
        assert item.labels.max() == end - start - 1
    assert regions.load("view_00.png", "m").labels.unique().tolist() == [-1, 0, 1]


@pytest.mark.parametrize(("values", "count", "ends"), [
    (([0, 1], [3], [6], [8]), 12, [0, 3, 6, 8, 12]),
    (([-1], [0, 1], [-1], [3, 4]), 5, [0, 0, 3, 3, 5]),
    (([-1], [-1], [-1], [-1]), 5, None),
    (([-1], [2], [3], [-1]), 6, [0, 2, 3, 6, 6]),
])  # fmt: skip
def test_rows_without_pixels_belong_to_the_level_before(
    values: Any, count: int, ends: list[int] | None
) -> None:
    blocks = level_blocks(Path("a_s.npy"), planes_of(*values), count).values()
    assert sum(block.stop - block.start for block in blocks) == count
    if ends is not None:
        assert [(block.start, block.stop) for block in blocks] == list(pairwise(ends))


def test_embeddings_are_scaled_to_unit_norm_and_zero_rows_stay(tmp_path):
    rows = unit_rows(4) * np.array([[1], [3], [0], [1e30]], dtype=np.float32)
    save_npy(tmp_path, "view_00", planes_of([0], [1, 2], [3], [-1]), rows)
    regions = load_regions(tmp_path, some_cameras(1))
    for level, norms in (("s", [1.0, 0.0]), ("m", [1.0])):
        found = regions.load_embeddings("view_00.png", level).norm(dim=1)
        torch.testing.assert_close(found, torch.tensor(norms))


@pytest.mark.parametrize("dtype", ["<f4", "<f2", "<f8", ">f4", ">i2", "<i4", "i1", "<i8"])
@pytest.mark.parametrize("distortion", [(), (0.1, -0.05)])
def test_labels_of_every_type_at_every_size(tmp_path, dtype, distortion):
    planes = planes_of([-1, 0], [1, -1, 2, 3], [-1], [5, 7, -1])
    order = "C" if dtype in ("<f4", "i1") else "F"
    save_npy(tmp_path, "view_00", np.asarray(planes, dtype, order), unit_rows(9).astype(np.float16))
    camera = replace(some_cameras(1)[0], distortion=distortion)
    regions = load_regions(tmp_path, [camera])
    if not distortion:
        assert np.array_equal(regions.load("view_00.png", "s").labels, np.maximum(planes[1] - 1, -1))
    for width, height in ((camera.width, camera.height), (13, 7)):
        labels = regions.load_labels("view_00.png", width, height)
        maps = [regions.load("view_00.png", level).resized(width, height) for level in LEVELS]
        assert labels.dtype == torch.int32
        assert torch.equal(labels, torch.stack([item.labels for item in maps]))
        again, embeddings = regions.select(["view_00.png"]).load_view("view_00.png", width, height)
        assert torch.equal(again, labels)
        for item, rows in zip(maps, embeddings, strict=True):
            assert torch.equal(item.embeddings, rows)


def test_labels_alone_do_not_read_embeddings(tmp_path):
    save_npy(tmp_path, "view_00", planes_of([0], [1, 2], [3], [-1, 4]), unit_rows(5))
    regions = load_regions(tmp_path, some_cameras(1))
    regions.embeddings("s")
    (tmp_path / "view_00_f.npy").unlink()
    assert regions.load_labels("view_00.png", 32, 24).amax((1, 2)).tolist() == [1, 0, 0]
    with pytest.raises(UnknownNameError):
        regions.load_labels("view_01.png", 32, 24)


def test_files_that_change_while_they_are_open(tmp_path):
    planes = planes_of([0], [1, 2], [3], [-1, 4])
    save_npy(tmp_path, "view_00", planes, unit_rows(5))
    regions = load_regions(tmp_path, some_cameras(1))
    regions.embeddings("s")
    for value in (0, 3, 1e9, -2, np.nan):
        planes[1, 5, 5] = value
        save_npy(tmp_path, "view_00", planes, unit_rows(5))
        with refuses(FileFormatError):
            regions.load_labels("view_00.png", 32, 24)
    save_npy(tmp_path, "view_00", planes, unit_rows(3))
    with refuses(FileFormatError):
        regions.load_embeddings("view_00.png", "m")


def test_labels_follow_the_size_of_the_camera(tmp_path):
    labels = np.arange(12).reshape(3, 4).astype(np.float32)
    planes = np.stack([np.full((3, 4), -1, np.float32), labels, labels + 12, labels + 24])
    save_npy(tmp_path, "view_00", planes, unit_rows(36))
    camera = some_cameras(1, width=8, height=6)[0]
    large = load_regions(tmp_path, [camera]).load("view_00.png", "m").labels
    assert np.array_equal(large, labels.repeat(2, 0).repeat(2, 1))
    for width, height in ((3, 2), (1, 1)):  # of 4 x 3, less a part of a pixel
        tiny = load_regions(tmp_path, some_cameras(1, width, height)).load("view_00.png", "m").labels
        assert tiny.shape == (height, width)
    camera = replace(camera, distortion=(0.3, 0.0, 0.0, 0.0))
    bent = load_regions(tmp_path, [camera]).load("view_00.png", "m").labels
    expected = sample_nearest(torch.from_numpy(labels).int(), photograph_pixels(camera, 4, 3), -1)
    assert torch.equal(bent, expected)
    assert bent.shape == (6, 8)


def test_stems_are_cut_at_the_first_dot(tmp_path):
    camera = replace(some_cameras(1)[0], name="left/img.0001.tar.png")
    save_npy(tmp_path, "img", planes_of([-1], [0], [1], [2]), unit_rows(3))
    assert load_regions(tmp_path, [camera]).view_names == ("left/img.0001.tar.png",)
    other = replace(camera, name="img.0002.png")
    with refuses():
        load_regions(tmp_path, Cameras([camera, other]))


def test_missing_features(tmp_path):
    cameras, planes = some_cameras(4), planes_of([-1], [0], [1], [2])
    with refuses(MissingFileError):
        load_regions(tmp_path, cameras)
    save_npy(tmp_path, "frame_00001", planes, unit_rows(3))
    with refuses(MissingFileError):
        load_regions(tmp_path, cameras)
    save_npy(tmp_path, "view_02", planes, unit_rows(3))
    with warns(ScoupWarning):
        assert load_regions(tmp_path, cameras).view_names == ("view_02.png",)
    with refuses():
        load_regions(tmp_path, [])
    save_npy(tmp_path, "view_01", planes, unit_rows(3, 5))  # of another model
    with refuses(FileFormatError):
        load_regions(tmp_path, cameras[1:3])


CAMERA = some_cameras(1)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """The file of the only view of a folder, in 16 bits."""
    save_compact(tmp_path, CAMERA, bits=16)
    return tmp_path / "view_00.regions"


ROWS = st.sampled_from([0, 1, 3, 65_535, 65_536, 70_000])


@given(st.integers(1, 50), st.integers(1, 50), ROWS, st.integers(0, 99))
def test_labels_of_every_size(height: int, width: int, rows: int, seed: int) -> None:
    labels = np.random.default_rng(seed).integers(-1, rows, (height, width)).astype(np.int32)
    with TemporaryDirectory() as folder:
        regions = ViewRegions("a.png", {"s": labels}, {"s": np.zeros((rows, 2), np.float16)})
        write_view(Path(folder), "a", regions, "")
        view = open_view(Path(folder), "a")
        assert (view.name, view.width, view.height, view.counts) == ("a.png", width, height, {"s": rows})
        assert (view.labels(("s",))[0] == labels).all()
        assert view.embeddings("s").dtype == np.float16


def test_every_flipped_bit_and_every_cut_is_noticed(path: Path) -> None:
    whole = path.read_bytes()
    rng = np.random.default_rng(0)
    for place in {*range(64), *rng.integers(0, len(whole), 400).tolist()}:
        damaged = bytearray(whole)
        damaged[place] ^= 1 << int(rng.integers(8))
        for content in (bytes(damaged), whole[:place]):
            path.write_bytes(content)
            with pytest.raises(FileFormatError):
                read_view(open_view(path.parent, "view_00"))


def test_files_without_checksums_are_read(path: Path, tmp_path: Path) -> None:
    """Those of before the first release."""
    view, content = read_view(open_view(tmp_path, "view_00")), path.read_bytes()
    header = json.loads(SEALED.split(content)[0])
    assert header.pop("checksums").keys() == load(content).keys()
    path.write_bytes(save(load(content), {"scoup": json.dumps(header)}))
    with refuses(FileFormatError):
        open_view(tmp_path, "view_00")
    del header["checksum"]
    path.write_bytes(save(load(content), {"scoup": json.dumps(header)}))
    again = read_view(open_view(tmp_path, "view_00"))
    assert all((again.embeddings[level] == view.embeddings[level]).all() for level in LEVELS)


def test_several_processes_may_write_one_manifest(tmp_path: Path) -> None:
    write_manifest(tmp_path, MANIFEST_OF_TESTS)
    write_manifest(tmp_path, MANIFEST_OF_TESTS)
    with refuses():
        write_manifest(tmp_path, replace(MANIFEST_OF_TESTS, embedding_model="another"))
    assert RegionManifest.read(tmp_path) == MANIFEST_OF_TESTS


# ---- conversion


VIEWS = {  # stem -> rows of the embeddings that each plane has; some have no level "default", or no pixels of another
    "a": ([0, 1, -1, 2, 3, 4], [5, 8, 7, 6, -1], [9, 10, 11], [13, 12]),
    "b": ([-1], [3, 4, 0, 1, 2, 5], [-1, 6], [7]), "c": ([-1], [0, 1, 2], [-1], [4, 3, -1]),
}  # fmt: skip


def test_langsplat_to_compact_is_lossless(tmp_path: Path) -> None:
    for stem, values in VIEWS.items():
        rows = np.random.default_rng(0).normal(size=(1 + max(map(max, values)), 6)).astype(np.float32)
        save_npy(tmp_path / "language_features", stem, planes_of(*values), rows)
    report = convert_regions(tmp_path, tmp_path / "32", bits=32, embedding_model="some/model")
    assert report.views == 3
    assert RegionManifest.read(tmp_path / "32") == RegionManifest(
        "some/model", {"bits": 32, "converted_from": "langsplat"}
    )
    convert_regions(tmp_path, tmp_path / "16")
    for bits, stem in product(("16", "32"), VIEWS):
        view = open_view(tmp_path / bits, stem)
        planes, stored = (np.load(tmp_path / "language_features" / f"{stem}_{part}.npy") for part in "sf")
        rows = np.concatenate([view.embeddings(level) for level in view.levels])
        assert (rows == stored.astype(f"f{int(bits) // 8}")).all()
        assert ("default" in view.levels) == (stem == "a")
        start = 0
        for level, plane in zip(view.levels, planes[-len(view.levels) :], strict=True):
            labels = view.labels((level,))[0]
            assert (np.where(labels < 0, -1, labels + start) == plane).all()
            start += view.counts[level]


def test_conversions_that_are_refused(tmp_path: Path) -> None:
    cameras = some_cameras(2)
    save_langsplat(some_regions(cameras), tmp_path / "a")
    (tmp_path / "empty").mkdir()
    cases: list[tuple[str, str, dict[str, Any], type[Exception]]] = [
        ("a", "a", {}, InputError), ("a", "b", {"bits": 8}, InputError),
        ("nowhere", "b", {}, MissingFileError), ("empty", "b", {}, MissingFileError),
    ]  # fmt: skip
    for source, target, options, kind in cases:
        with refuses(kind):
            convert_regions(tmp_path / source, tmp_path / target, **options)
    assert not (tmp_path / "b").exists()
    convert_regions(tmp_path / "a", tmp_path / "b")
    before = snapshot(tmp_path / "b")
    with pytest.raises(OutputExistsError):
        convert_regions(tmp_path / "a", tmp_path / "b")
    with refuses():
        convert_regions(tmp_path / "a", tmp_path / "b", bits=32)
    with refuses():
        convert_regions(tmp_path / "b", tmp_path / "a", overwrite=True)
    assert snapshot(tmp_path / "b") == before
    convert_regions(tmp_path / "a", tmp_path / "b", bits=32, overwrite=True)
    assert len(load_regions(tmp_path / "b", cameras)) == 2


def test_a_damaged_source_leaves_nothing(tmp_path: Path) -> None:
    cameras = some_cameras(2)
    save_langsplat(some_regions(cameras), tmp_path / "a")
    os.truncate(tmp_path / "a" / "view_01_f.npy", 150)
    with pytest.raises(FileFormatError, match=r"view_01_f\.npy"):
        convert_regions(tmp_path / "a", tmp_path / "b")
    assert {path.name for path in tmp_path.iterdir()} == {"a"}


def test_rows_of_nothing_are_refused(path: Path) -> None:
    """Any number of embeddings without a dimension fits into a file."""
    content = path.read_bytes()
    tensors = load(content) | {f"embeddings.{level}": np.zeros((0, 0), np.float32) for level in LEVELS}
    whole = save(tensors, {"scoup": SEALED.split(content)[0].decode()})
    path.write_bytes(whole.replace(b'"shape":[0,0]', b'"shape":[9,0]'))
    with refuses(FileFormatError):
        load_regions(path.parent, CAMERA)
