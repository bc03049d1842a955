"""Region sums of all views, in memory and in files: kept as they are, and refused where they are damaged."""

from __future__ import annotations

import dataclasses
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from safetensors.numpy import load_file, save
from tests.fuzzing.containers import SAFETENSORS, SEALED

import scoup
from cli_support import snapshot
from messages import refuses
from raster.parity import needs_native
from scoup import raster
from scoup.base import FileFormatError, MissingFileError, SealedFile
from scoup.raster import RASTER_PRESETS, ViewSums, reference
from scoup.scene import SparseCodes
from scoup.uplift.rasterise import read_labels, region_sums
from scoup.uplift.storage import entries
from scoup.uplift.storage.array_file import read_arrays, view_file
from scoup.uplift.stored_sums import RegionSums
from support import small_scene

Arrays = dict[str, NDArray[Any]]


@pytest.fixture(scope="module")
def scene():
    return small_scene(count=600)


@pytest.fixture(scope="module")
def kept(scene) -> RegionSums:
    return region_sums(*scene)


@pytest.fixture(scope="module")
def whole(scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of the same sums, read-only."""
    folder = tmp_path_factory.mktemp("sums") / "f.sums"
    region_sums(*scene, path=folder)
    return folder


@pytest.fixture
def path(whole: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(whole, tmp_path / "f.sums"))


NONE = torch.zeros(0, dtype=torch.int32)
NOTHING = ViewSums(NONE, NONE, torch.zeros(0), torch.zeros(0, 3, dtype=torch.int32))


def folder_bytes(path: Path) -> int:
    return sum(file.stat().st_size for file in path.iterdir())


def assert_same(one: RegionSums, other: RegionSums) -> None:
    assert list(one.views) == list(other.views)
    for name, view in one.views.items():
        assert view.labels_digest == other.views[name].labels_digest
        assert view.camera_digest == other.views[name].camera_digest
        for mine, theirs in zip(view.parts, other.views[name].parts, strict=True):
            for field, array in mine.arrays().items():
                np.testing.assert_array_equal(array, theirs.arrays()[field])


def test_the_matrix_holds_what_each_gaussian_paints_of_each_region(scene, kept):
    """Against the blending weights of single pixels."""
    gaussians, cameras, regions = scene
    matrices = [kept.matrix(level).toarray() for level in range(len(regions.levels))]
    for camera in cameras:
        labels, _ = regions.load_view(camera.name, camera.width, camera.height)
        projection = reference.project(gaussians, camera, RASTER_PRESETS["inria"])
        for level, matrix in enumerate(matrices):
            rows, parts = regions.embeddings(regions.levels[level])
            part = parts[camera.name]
            assert matrix.shape == (len(gaussians), len(rows))
            chosen = labels[level] == torch.arange(part.stop - part.start)[:, None, None]
            tiles = (reference.to_tiles(region, projection.bins, fill=0) for region in chosen.float())
            tiled = torch.stack([*tiles], 1)
            painted = torch.zeros(len(gaussians), len(chosen))
            for tile, ids, weights in reference.tile_weights(projection):
                painted[ids] += weights @ tiled[tile].T
            np.testing.assert_allclose(matrix[:, part], painted.numpy(), rtol=1e-3, atol=1e-4)


def test_a_file_gives_back_what_it_was_given(scene, kept, path):
    made, back = region_sums(*scene, path=path), RegionSums.open(path)
    assert_same(made, kept)
    assert_same(back, kept)
    assert torch.equal(back.order, kept.order)
    assert (back.fingerprint, back.levels, back.raster_preset) == (kept.fingerprint, kept.levels, "inria")
    assert back.scale == "auto"
    assert back.bytes == made.bytes == folder_bytes(path)
    assert back.matrix(0, kept.rows[0]).nnz == kept.matrix(0).nnz
    with refuses():
        back.append("another", NOTHING)


def test_the_last_one_of_a_view_counts(scene, kept, tmp_path):
    gaussians, cameras, regions = scene
    sums = region_sums(gaussians, cameras[:2], regions, path=tmp_path / "f.sums")
    second = cameras.names[1]
    sums.append(second, NOTHING)
    assert len(sums.views[second].parts[0].places) == 0
    assert sums.bytes == folder_bytes(tmp_path / "f.sums")
    again = region_sums(*scene, path=tmp_path / "f.sums")
    assert set(again.views) == set(kept.views)
    for name in kept.views:
        np.testing.assert_array_equal(again.views[name].parts[0].weights, kept.views[name].parts[0].weights)


def test_many_combinations_are_kept_in_parts(scene, kept, monkeypatch):
    regions = scene[2]
    monkeypatch.setattr(entries, "MOST_COMBINATIONS", 7)
    sums = region_sums(*scene)
    assert all(len(view.parts) > 1 for view in sums.views.values())
    for level in range(3):
        np.testing.assert_array_equal(sums.matrix(level).toarray(), kept.matrix(level).toarray())
    generator = torch.Generator().manual_seed(0)
    counts = [len(regions.embeddings(level)[0]) for level in regions.levels]
    codes = [SparseCodes.from_dense(torch.rand(count, 9, generator=generator), 3) for count in counts]
    codebook = torch.randn(3, 9, 16, generator=generator)
    for backend in ("native", "reference"):
        found, expected = (scoup.vote(each, codes, codebook, 2, 3, backend=backend) for each in (sums, kept))
        torch.testing.assert_close(found.weights, expected.weights, atol=1e-5, rtol=0)


def test_what_was_complete_stays(scene, kept, path):
    """Whichever files are there, and whatever a killed process was writing."""
    whole, names = snapshot(path), scene[1].names
    for count in range(len(kept)):
        for name in names[count:]:
            (path / view_file(name)).unlink()
        (path / f".{view_file(names[count])}.partial").write_bytes(b"half a view")
        assert list(RegionSums.open(path).views) == list(names[:count])
        assert_same(region_sums(*scene, path=path), kept)
        assert snapshot(path) == whole


def test_views_of_any_name(scene, tmp_path):
    gaussians, _, regions = scene
    names = ["a/b.png", "A/b.png", "a-b.png", "..", "", "x" * 300, "ü\n", '"checksum": "00000000"']
    sums = RegionSums.empty(gaussians, regions.levels, path=tmp_path / "f.sums")
    for name in names:
        sums.append(name, NOTHING)
    assert list(RegionSums.open(tmp_path / "f.sums").views) == sorted(names)


def test_they_are_safetensors(kept, path):
    """For other programs; of few and of many views, none of whose files is held open."""
    view, found = kept.views["view_00.png"], load_file(path / view_file("view_00.png"))
    assert {name: array.dtype for name, array in found.items()} == {
        name: array.dtype for name, array in view.arrays().items()
    }
    assert all((found[name] == array).all() for name, array in view.arrays().items())
    before = len(os.listdir("/dev/fd")) if os.path.isdir("/dev/fd") else 0
    opened = [RegionSums.open(path) for _ in range(9)]
    assert (len(os.listdir("/dev/fd")) if os.path.isdir("/dev/fd") else 0) == before
    assert all(one.bytes == folder_bytes(path) for one in opened)


def test_views_are_read_ahead_in_order(scene):
    _, cameras, regions = scene
    read = list(read_labels(regions, list(cameras), torch.device("cpu")))
    assert [camera.name for camera, _ in read] == list(cameras.names)
    for camera, combined in read:
        labels, _ = regions.load_view(camera.name, camera.width, camera.height)
        assert combined.digest() == raster.combine(labels).digest()


def test_a_view_takes_no_space_for_buckets_that_it_does_not_see(scene):
    gaussians, cameras, regions = scene
    many = gaussians.select(torch.arange(len(gaussians)).repeat(30))
    means = many.means.clone()
    means[len(gaussians) :, 2] -= 1e4  # behind all cameras
    sums = region_sums(dataclasses.replace(many, means=means), cameras, regions)
    assert sums.n_buckets > 60
    for view in sums.views.values():
        for part in view.parts:
            assert len(part.buckets) == len(part.starts) - 1 <= len(gaussians) // entries.BUCKET + 2


# Damaged files.


@pytest.mark.parametrize("file", ["scene.safetensors", view_file("view_01.png")])
def test_a_flipped_bit_is_refused_with_the_name_of_the_file(path, file):
    whole = (path / file).read_bytes()
    for place in (40, len(whole) // 3, len(whole) - 1):
        damaged = bytearray(whole)
        damaged[place] ^= 4
        (path / file).write_bytes(damaged)
        with refuses(FileFormatError):
            RegionSums.open(path)


def test_what_is_something_else_is_refused(path):
    first = path / view_file("view_00.png")
    others = (path / view_file("view_01.png")).read_bytes()
    foreign = save({"weights": np.ones(3)}, {"made by": "another program"})
    for other in (b"a picture, or the like" * 9, b"", others, foreign):
        first.write_bytes(other)
        with refuses(FileFormatError):
            RegionSums.open(path)
    (path / "scene.safetensors").unlink()
    for nowhere in (path, path.with_name("g.sums")):
        with refuses(MissingFileError):
            RegionSums.open(nowhere)


@pytest.mark.parametrize(("container", "old", "new"), [
    (SEALED, '"version": 1', '"version": Infinity'),
    (SAFETENSORS, '"order"', '"deep":' + "[" * 100_000 + ',"order"'),
    (SAFETENSORS, '"shape":[600]', '"shape":[1099511627776,0]'),
    (SAFETENSORS, '"shape":[600]', '"shape":[601]'),
    (SAFETENSORS, '"shape":[600]', '"shape":[1e308,1e308]'),
    (SAFETENSORS, "9600]", "9604]"), (SAFETENSORS, '"I32"', '"BOOL"'),
])  # fmt: skip
def test_headers_that_make_no_sense(path, container, old, new):
    file = path / "scene.safetensors"
    whole = file.read_bytes()
    parts = container.split(whole)
    assert old.encode() in parts[0]
    parts[0] = parts[0].replace(old.encode(), new.encode(), 1)
    file.write_bytes(container.join(whole, parts))
    # Reasons of json are worded by Python.
    said = r"scene.safetensors: (is not a file of region sums or is damaged|has an invalid format version)"
    with pytest.raises(FileFormatError, match=said):
        RegionSums.open(path)


def changed(path: Path, change: Callable[[Arrays], object]) -> Path:
    """The folder with other arrays in the file of its first view, whose checksum agrees."""
    file = path / view_file("view_00.png")
    stored = read_arrays(file)
    arrays = {name: array.copy() for name, array in stored.arrays.items()}
    change(arrays)
    SealedFile.write(file, stored.header, arrays, overwrite=True)
    return path


@pytest.mark.parametrize(
    "change",
    [
        lambda arrays: arrays.pop("places.0"),
        lambda arrays: arrays.update({"weights.0": arrays["weights.0"].astype(np.float16)}),
        lambda arrays: arrays.update({"starts.0": arrays["starts.0"][:-1]}),
    ],
    ids=["none", "types", "shapes"],
)
def test_entries_that_are_none_are_refused_at_once(path, change):
    with refuses(FileFormatError):
        RegionSums.open(changed(path, change))


@pytest.mark.parametrize(("name", "value"), [("combinations.0", 2**16 - 1), ("table.0", 2**31 - 1)])
@pytest.mark.parametrize("backend", ["reference", pytest.param("native", marks=needs_native)])
def test_entries_and_regions_that_point_outside_are_refused_where_they_are_used(path, backend, name, value):
    def beyond(arrays: Arrays) -> None:
        arrays[name].flat[0] = value

    sums = RegionSums.open(changed(path, beyond))
    rows = [{view: slice(0, 16) for view in sums.views} for _ in sums.levels]
    codes = [SparseCodes(torch.zeros(16, 1, dtype=torch.uint8), torch.ones(16, 1), 2) for _ in sums.levels]
    with refuses():
        scoup.vote(sums.select(sums.views, rows), codes, torch.ones(3, 2, 4), keep=1, backend=backend)
    if name == "combinations.0":
        with refuses():
            sums.triplets("view_00.png", 0)


@pytest.mark.filterwarnings("error")
def test_weights_that_are_no_numbers_or_too_large_together(path):
    def signalling(arrays: Arrays) -> None:
        arrays["weights.0"].view(np.uint32)[:] = 0x7FA00000

    def large(arrays: Arrays) -> None:
        arrays["weights.0"][:] = np.finfo(np.float32).max
        arrays["table.0"][:] = 0

    for change, shows in ((signalling, np.isnan), (large, np.isinf)):
        sums = RegionSums.open(changed(path, change))
        assert shows(sums.triplets("view_00.png", 0)[2]).any()
