"""The compact layout of region features, its manifest, damage to both, and conversion of LangSplat's."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from safetensors import safe_open
from safetensors.numpy import load_file, save_file

from cli_support import snapshot
from io_samples import (
    MANIFEST_OF_TESTS,
    save_compact,
    save_langsplat,
    some_cameras,
    some_regions,
)
from messages import refuses, warns
from scoup.base import FileFormatError, MissingFileError, OutputExistsError, ScoupWarning
from scoup.io import convert_regions, load_regions
from scoup.io.regions.compact import open_view, write_view
from scoup.io.regions.manifest import RegionManifest, write_manifest
from scoup.io.regions.store import read_view
from scoup.io.regions.views import ViewRegions
from scoup.scene import LEVELS

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


def test_views_that_are_missing_or_given_up(tmp_path: Path) -> None:
    cameras = some_cameras(3)
    save_compact(tmp_path, cameras)
    (tmp_path / "view_01.regions").unlink()
    with warns(ScoupWarning):
        assert load_regions(tmp_path, cameras).view_names == ("view_00.png", "view_02.png")
    write_manifest(tmp_path, replace(MANIFEST_OF_TESTS, settings={"other": 1}), overwrite=True)
    with refuses(MissingFileError):
        load_regions(tmp_path, cameras)


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
    view, tensors = read_view(open_view(tmp_path, "view_00")), load_file(path)
    with safe_open(path, framework="numpy") as stream:
        header = json.loads(stream.metadata()["scoup"])
    assert header.pop("checksums").keys() == tensors.keys()
    save_file(tensors, path, {"scoup": json.dumps(header)})
    with refuses(FileFormatError):
        open_view(tmp_path, "view_00")
    del header["checksum"]
    save_file(tensors, path, {"scoup": json.dumps(header)})
    again = read_view(open_view(tmp_path, "view_00"))
    assert all((again.embeddings[level] == view.embeddings[level]).all() for level in LEVELS)


def test_several_processes_may_write_one_manifest(tmp_path: Path) -> None:
    write_manifest(tmp_path, MANIFEST_OF_TESTS)
    write_manifest(tmp_path, MANIFEST_OF_TESTS)
    with refuses():
        write_manifest(tmp_path, replace(MANIFEST_OF_TESTS, embedding_model="another"))
    assert RegionManifest.read(tmp_path) == MANIFEST_OF_TESTS


# ---- conversion


def test_langsplat_to_compact_is_lossless(tmp_path: Path) -> None:
    """Labels and numbers, the level "default" and levels without pixels included."""
    rng = np.random.default_rng(0)
    source = tmp_path / "language_features"
    source.mkdir()
    for stem, counts in (("a", (5, 4, 3, 2)), ("b", (0, 6, 1, 1)), ("c", (0, 3, 0, 2))):
        planes = np.full((4, 12, 17), -1, np.float32)
        start = 0
        for plane, count in zip(planes, counts, strict=True):
            if count:
                numbers = start + rng.integers(0, count, plane.shape)
                plane[:] = np.where(rng.random(plane.shape) < 0.2, -1, numbers)
                plane.flat[:count] = start + np.arange(count)
            start += count
        np.save(source / f"{stem}_s.npy", planes)
        np.save(source / f"{stem}_f.npy", rng.normal(size=(start, 6)).astype(np.float32))
    report = convert_regions(tmp_path, tmp_path / "32", bits=32, embedding_model="some/model")
    assert report.views == 3
    assert RegionManifest.read(tmp_path / "32") == RegionManifest(
        "some/model", {"bits": 32, "converted_from": "langsplat"}
    )
    convert_regions(tmp_path, tmp_path / "16")
    for bits, stem in product(("16", "32"), "abc"):
        view = open_view(tmp_path / bits, stem)
        stored, planes = np.load(source / f"{stem}_f.npy"), np.load(source / f"{stem}_s.npy")
        rows = np.concatenate([view.embeddings(level) for level in view.levels])
        assert (rows == stored.astype(f"f{int(bits) // 8}")).all()
        if "default" not in view.levels:
            assert (planes[0] == -1).all()
            planes = planes[1:]
        start = 0
        for level, plane, labels in zip(view.levels, planes, view.labels(view.levels), strict=True):
            assert (np.where(labels < 0, -1, labels + start) == plane).all()
            start += view.counts[level]


def test_conversions_that_are_refused(tmp_path: Path) -> None:
    cameras = some_cameras(2)
    save_langsplat(some_regions(cameras), tmp_path / "a")
    with refuses():
        convert_regions(tmp_path / "a", tmp_path / "a")
    with refuses():
        convert_regions(tmp_path / "a", tmp_path / "b", bits=8)
    with refuses(MissingFileError):
        convert_regions(tmp_path / "nowhere", tmp_path / "b")
    (tmp_path / "empty").mkdir()
    with refuses(MissingFileError):
        convert_regions(tmp_path / "empty", tmp_path / "b")
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
    with safe_open(path, framework="numpy") as stream:
        header = stream.metadata()
    tensors = load_file(path)
    for level in LEVELS:
        tensors[f"embeddings.{level}"] = np.zeros((0, 0), np.float32)
    save_file(tensors, path, header)
    raw = path.read_bytes()
    path.write_bytes(raw.replace(b'"shape":[0,0]', b'"shape":[9,0]'))
    with refuses(FileFormatError):
        load_regions(path.parent, CAMERA)
