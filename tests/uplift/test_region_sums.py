"""Region sums of all views, in memory and in a file."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.numpy import load_file

import scoup
from cli_support import snapshot
from messages import refuses
from scoup import raster
from scoup.base import FileFormatError, MissingFileError
from scoup.raster import RASTER_PRESETS, ViewSums, reference
from scoup.uplift.rasterise import read_labels, region_sums
from scoup.uplift.storage import entries
from scoup.uplift.storage.array_file import view_file
from scoup.uplift.stored_sums import RegionSums
from support import small_scene


@pytest.fixture(scope="module")
def scene():
    return small_scene(count=600)


@pytest.fixture(scope="module")
def kept(scene) -> RegionSums:
    gaussians, cameras, regions = scene
    return region_sums(gaussians, cameras, regions)


@pytest.fixture
def path(scene, tmp_path: Path) -> Path:
    """A folder of the same sums."""
    gaussians, cameras, regions = scene
    region_sums(gaussians, cameras, regions, path=tmp_path / "f.sums")
    return tmp_path / "f.sums"


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
    for level, name in enumerate(regions.levels):
        matrix = kept.matrix(level).toarray()
        assert matrix.shape == (len(gaussians), len(regions.embeddings(name)[0]))
        for camera in cameras:
            labels, _ = regions.load_view(camera.name, camera.width, camera.height)
            projection = reference.project(gaussians, camera, RASTER_PRESETS["inria"])
            part = regions.embeddings(name)[1][camera.name]
            for region in range(part.stop - part.start):
                chosen = (labels[level] == region).float()
                # What a Gaussian paints of a region is what a picture of it alone gains there.
                weight = torch.zeros(len(gaussians))
                for tile, ids, weights in reference.tile_weights(projection):
                    tiled = reference.to_tiles(chosen[None], projection.bins, fill=0)[tile, 0]
                    weight[ids] += weights @ tiled
                np.testing.assert_allclose(
                    matrix[:, part.start + region], weight.numpy(), rtol=1e-3, atol=1e-4
                )


def test_a_file_gives_back_what_it_was_given(scene, kept, path):
    gaussians, cameras, regions = scene
    made = region_sums(gaussians, cameras, regions, path=path)
    assert_same(made, kept)
    back = RegionSums.open(path)
    assert_same(back, kept)
    assert torch.equal(back.order, kept.order)
    assert (back.fingerprint, back.levels, back.raster_preset) == (kept.fingerprint, kept.levels, "inria")
    assert back.scale == "auto"
    assert back.bytes == made.bytes == folder_bytes(path)
    assert RegionSums.open(path).matrix(0, kept.rows[0]).nnz == kept.matrix(0).nnz
    with refuses():
        back.append("another", NOTHING)


def test_the_last_one_of_a_view_counts(scene, kept, tmp_path):
    gaussians, cameras, regions = scene
    sums = region_sums(gaussians, cameras[:2], regions, path=tmp_path / "f.sums")
    second = cameras.names[1]
    sums.append(second, NOTHING)
    assert len(sums.views[second].parts[0].places) == 0
    assert sums.bytes == folder_bytes(tmp_path / "f.sums")
    again = region_sums(gaussians, cameras, regions, path=tmp_path / "f.sums")
    assert set(again.views) == set(kept.views)
    for name in kept.views:
        np.testing.assert_array_equal(again.views[name].parts[0].weights, kept.views[name].parts[0].weights)


def test_many_combinations_are_kept_in_parts(scene, kept, monkeypatch):
    gaussians, cameras, regions = scene
    monkeypatch.setattr(entries, "MOST_COMBINATIONS", 7)
    sums = region_sums(gaussians, cameras, regions)
    assert all(len(view.parts) > 1 for view in sums.views.values())
    for level in range(3):
        np.testing.assert_array_equal(sums.matrix(level).toarray(), kept.matrix(level).toarray())
    generator = torch.Generator().manual_seed(0)
    codes = [
        scoup.SparseCodes.from_dense(torch.rand(len(regions.embeddings(level)[0]), 9, generator=generator), 3)
        for level in regions.levels
    ]
    codebook = torch.randn(3, 9, 16, generator=generator)
    for backend in ("native", "reference"):
        found, expected = (scoup.vote(each, codes, codebook, 2, 3, backend=backend) for each in (sums, kept))
        torch.testing.assert_close(found.weights, expected.weights, atol=1e-5, rtol=0)


def test_what_was_complete_stays(scene, kept, path):
    """Whichever files are there, and whatever a killed process was writing."""
    gaussians, cameras, regions = scene
    whole = snapshot(path)
    for count in range(len(kept)):
        for name in cameras.names[count:]:
            (path / view_file(name)).unlink()
        (path / f".{view_file(cameras.names[count])}.partial").write_bytes(b"half a view")
        assert list(RegionSums.open(path).views) == list(cameras.names[:count])
        assert_same(region_sums(gaussians, cameras, regions, path=path), kept)
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
    for other in (b"a picture, or the like" * 9, b""):
        (path / view_file("view_00.png")).write_bytes(other)
        with refuses(FileFormatError):
            RegionSums.open(path)
    (path / "scene.safetensors").unlink()
    with refuses(MissingFileError):
        RegionSums.open(path)
    with refuses(MissingFileError):
        RegionSums.open(path.with_name("g.sums"))


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
