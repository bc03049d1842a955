"""Shards of the views, merged: what one process builds, byte for byte."""

from __future__ import annotations

import dataclasses
import random
from collections.abc import Iterable
from itertools import count
from pathlib import Path

import pytest
import torch

from cli_support import snapshot
from scoup import BuildSettings, build
from scoup.base.errors import FileFormatError, InputError, ScoupWarning
from scoup.base.shares import Share
from scoup.scene.cameras import Cameras
from scoup.scene.regions import RegionMap, Regions
from scoup.uplift.rasterise import region_sums
from scoup.uplift.region_sums import RegionSums
from scoup.uplift.shards import add_shard, merge
from scoup.uplift.storage.paths import view_file
from scoup.uplift.update import update
from support import small_scene

SETTINGS = BuildSettings(n_atoms=8, k=3, keep=3)
SCENE = small_scene(count=700, views=5)
NUMBERS = count()


def made(folder: Path, share: str, scene=SCENE, **how) -> Path:
    """The file of a shard."""
    gaussians, cameras, regions = scene
    path = folder / f"{next(NUMBERS)}.sums"
    sums = RegionSums.empty(gaussians, regions.levels, path=path, **how)
    add_shard(sums, gaussians, cameras, regions, Share.parse(share), embedding_model="m",
              geometry_path=folder / "g.ply", check_fit=False)  # fmt: skip
    return path


def merged(paths: Iterable[Path], folder: Path, **how) -> bytes:
    field = merge([RegionSums.open(path) for path in paths], SETTINGS, **how)
    path = folder / f"{next(NUMBERS)}.scoup"
    field.save(path)
    return path.read_bytes()


def alone(folder: Path, views: Iterable[str] = SCENE[1].names, scene=SCENE) -> bytes:
    gaussians, cameras, regions = scene
    chosen = Cameras(camera for camera in cameras if camera.name in set(views))
    path = folder / f"{next(NUMBERS)}.scoup"
    build(gaussians, chosen, regions, SETTINGS, embedding_model="m", geometry_path=folder / "g.ply",
          check_fit=False).save(path)  # fmt: skip
    return path.read_bytes()


@pytest.mark.parametrize("world", [1, 2, 3, 7])
def test_all_shards_in_any_order_make_the_field_of_one_process(world: int, tmp_path: Path) -> None:
    """Also where there are more shards than views."""
    paths = [made(tmp_path, f"{number}/{world}") for number in range(1, world + 1)]
    random.Random(world).shuffle(paths)
    assert merged(paths, tmp_path) == alone(tmp_path)


def test_a_view_may_be_in_several(tmp_path: Path) -> None:
    paths = [made(tmp_path, share) for share in ("1/2", "1/3", "2/2", "1/2")]
    assert merged(paths, tmp_path) == alone(tmp_path)


def test_some_shards_make_the_field_of_their_views(tmp_path: Path) -> None:
    paths = [made(tmp_path, share) for share in ("3/3", "1/3")]
    with pytest.warns(ScoupWarning, match="2 views of 5 are in none of the shards"):
        found = merged(paths, tmp_path)
    names = SCENE[1].names
    assert found == alone(tmp_path, (names[0], names[2], names[3]))


def test_a_level_without_regions_in_a_shard(tmp_path: Path) -> None:
    """It needs regions in the scene only."""
    gaussians, cameras, regions = SCENE
    none = RegionMap(torch.full((30, 40), -1), torch.zeros(0, 16))
    bare = cameras.names[0]

    def load(name: str, level: str) -> RegionMap:
        return none if (name, level) == (bare, "s") else regions.load(name, level)

    scene = gaussians, cameras, Regions(regions.levels, cameras.names, load)
    paths = [made(tmp_path, f"{number}/5", scene) for number in range(1, 6)]
    assert merged(paths, tmp_path) == alone(tmp_path, scene=scene)


def test_sums_are_kept_with_codes_for_updates(tmp_path: Path) -> None:
    gaussians, cameras, regions = SCENE
    paths = [made(tmp_path, share) for share in ("2/2", "1/2")]
    shards = [RegionSums.open(path) for path in paths]
    keep = RegionSums.empty_like(shards[0], tmp_path / "merged.sums")
    field = merge(shards, SETTINGS, keep=keep)
    field.attach(gaussians)
    sums = RegionSums.empty(gaussians, regions.levels, path=tmp_path / "alone.sums")
    build(gaussians, cameras, regions, settings=SETTINGS, sums=sums, check_fit=False)
    assert snapshot(tmp_path / "merged.sums") == snapshot(tmp_path / "alone.sums")
    fewer = update(field, keep, remove=[cameras.names[1]])
    assert list(fewer.info.provenance["views"]) == [n for n in cameras.names if n != cameras.names[1]]


def test_an_interrupted_shard_goes_on(tmp_path: Path) -> None:
    """Views that are there are not rasterised again, and its inputs are kept once."""
    gaussians, cameras, regions = SCENE
    path, seen = tmp_path / "a.sums", []

    def stop(stage: str, done: int, total: int) -> None:
        seen.append((done, total))
        if stage == "region sums" and done == 2 and len(seen) < 9:
            seen.extend([(0, 0)] * 9)
            raise KeyboardInterrupt

    for _ in range(2):
        new = not path.exists()
        sums = RegionSums.empty(gaussians, regions.levels, path=path) if new else RegionSums.open(path, True)
        try:
            add_shard(sums, gaussians, cameras, regions, Share.parse("1/1"), embedding_model="m", progress=stop,
                      geometry_path=tmp_path / "g.ply", check_fit=False)  # fmt: skip
        except KeyboardInterrupt:
            assert 1 <= len(sums) < 5
    undisturbed = made(tmp_path, "1/1")
    assert snapshot(path) == snapshot(undisturbed)


def test_inputs_that_have_changed_are_kept_again(tmp_path: Path) -> None:
    gaussians, cameras, regions = SCENE
    path = made(tmp_path, "1/1")
    other = small_scene(count=700, views=5, seed=9)[2]

    def load(name: str, level: str) -> RegionMap:
        old = regions.load(name, level)
        return RegionMap(old.labels, other.load(other.view_names[0], level).embeddings)

    changed = Regions(regions.levels, cameras.names, load)
    sums = RegionSums.open(path, writable=True)
    add_shard(sums, gaussians, cameras, changed, Share.parse("1/1"), embedding_model="m",
              geometry_path=tmp_path / "g.ply", check_fit=False)  # fmt: skip
    assert merged([path], tmp_path) == alone(tmp_path, scene=(gaussians, cameras, changed))


def test_shards_of_other_scenes_are_refused(tmp_path: Path) -> None:
    gaussians, cameras, regions = SCENE
    first = made(tmp_path, "1/2")
    moved = dataclasses.replace(gaussians, means=gaussians.means + 0.01)
    fewer = Cameras(list(cameras)[:4])
    zoomed = Cameras(
        [dataclasses.replace(camera, K=camera.K * torch.tensor([[2.0], [2.0], [1.0]])) for camera in cameras]
    )
    first_maps = {level: regions.load("view_00.png", level) for level in regions.levels}
    other_labels, other_embeddings = (
        Regions(
            regions.levels,
            cameras.names,
            lambda name, level, change=change: (
                RegionMap(*change(first_maps[level])) if name == "view_00.png" else regions.load(name, level)
            ),
        )
        for change in (
            lambda known: (known.labels.flip(1), known.embeddings),
            lambda known: (known.labels, known.embeddings.flip(1)),
        )
    )
    others = {
        "of other scenes": [
            made(tmp_path, "2/2", (moved, cameras, regions)),
            made(tmp_path, "2/2", (gaussians, fewer, regions)),
            made(tmp_path, "2/2", weights="float16"),
            made(tmp_path, "2/2", (gaussians, zoomed, regions)),
            made(tmp_path, "2/2", (gaussians, Cameras(reversed(list(cameras))), regions)),
        ],
        "contain other regions of the view view_00.png": [
            made(tmp_path, "1/1", (gaussians, cameras, changed))
            for changed in (other_labels, other_embeddings)
        ],
    }
    for said, paths in others.items():
        for path in paths:
            with pytest.raises(InputError, match=said):
                merged([first, path], tmp_path)
    with pytest.raises(InputError, match="no shards"):
        merge([], SETTINGS)


def test_what_is_no_shard_is_refused(tmp_path: Path) -> None:
    gaussians, cameras, regions = SCENE
    region_sums(gaussians, cameras, regions, path=tmp_path / "plain.sums")
    with pytest.raises(FileFormatError, match="is not a shard"):
        merged([tmp_path / "plain.sums"], tmp_path)


@pytest.mark.parametrize(
    "change",
    [
        {"places": [0, 0, 1]},
        {"places": [0, 2, 9]},
        {"n_views": "many"},
        {"cameras": []},
        {"cameras": [{}] * 3},
        {"ends": [[6, 12, 18]] * 2},
        {"ends": [[6, 12, 99]] * 3},
        {"ends": [[6, 3, 18]] * 3},
    ],
    ids=str,
)
def test_inputs_that_make_no_sense_are_refused(change: dict[str, object], tmp_path: Path) -> None:
    path = made(tmp_path, "1/2")
    sums = RegionSums.open(path, writable=True)
    assert sums.inputs is not None
    header = {**sums.inputs["header"], **change}
    sums.keep_inputs(header, sums.inputs["tensors"])
    with pytest.raises(FileFormatError, match="is not a valid shard"):
        merged([path], tmp_path)


def test_a_shard_that_lacks_a_file_is_refused(tmp_path: Path) -> None:
    path = made(tmp_path, "1/1")
    (path / view_file(SCENE[1].names[1])).unlink()
    with pytest.raises(FileFormatError, match=r"lacks the region sums of view_01\.png"):
        merged([path], tmp_path)
