"""The region store: the same rules for both layouts, of which one is written."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, get_args

import pytest
import torch

from cli_support import snapshot
from io_samples import save_compact, save_langsplat, some_cameras, some_regions, stored_view
from messages import refuses
from scoup.base import MissingFileError, OutputExistsError
from scoup.io import RegionManifest, RegionStore, ViewRegions, convert_regions, load_regions, save_regions
from scoup.io.regions.manifest import MANIFEST
from scoup.io.regions.store import Layout, read_view
from scoup.io.regions.views import match_stems
from scoup.scene import LEVELS, Cameras, RegionMap, Regions, resize_labels


def view(name: str, seed: int = 0, photograph: str = "digest") -> ViewRegions:
    (camera,) = some_cameras(1, 9, 6)
    regions = some_regions(Cameras([replace(camera, name=name)]), seed=seed)
    return stored_view(regions, name, photograph=photograph)


def manifest_of(**settings: object) -> RegionManifest:
    return RegionManifest.of("some/model", settings, 32)


@pytest.mark.parametrize("bits", [16, 32, None])
def test_regions_come_back(tmp_path: Path, bits: int | None) -> None:
    cameras, folder = some_cameras(3), tmp_path / "language_features"
    if bits is None:
        regions = some_regions(cameras)
        save_regions(regions, folder)
        with pytest.raises(OutputExistsError):
            save_regions(regions, folder)
        save_regions(regions, folder, overwrite=True)
    else:
        regions = save_compact(folder, cameras, bits)
    for place in (tmp_path, folder):
        again = load_regions(place, cameras)
        assert (again.levels, again.view_names) == (LEVELS, cameras.names)
        for name in cameras.names:
            for level in LEVELS:
                one, other = regions.load(name, level), again.load(name, level)
                assert torch.equal(one.labels, other.labels)
                tolerance = 1e-3 if bits == 16 else 1e-7
                torch.testing.assert_close(one.embeddings, other.embeddings, rtol=0, atol=tolerance)
                assert torch.equal(again.load_embeddings(name, level), other.embeddings)
                torch.testing.assert_close(other.embeddings.norm(dim=1), torch.ones(len(other.embeddings)))
            each = torch.stack([regions.load(name, level).labels for level in LEVELS])
            labels, embeddings = again.load_view(name, 9, 5)
            assert torch.equal(labels, resize_labels(each, 9, 5))
            assert torch.equal(embeddings[1], again.load_embeddings(name, "m"))


def test_views_come_back_as_they_were_written(tmp_path: Path) -> None:
    store, stems = RegionStore.create(tmp_path / "a", manifest_of()), ["a.0001", "left/b"]
    assert not (tmp_path / "a").exists()
    store.begin()
    written = {stem: view(f"{stem}.png", seed) for stem, seed in zip(stems, (2, 1), strict=True)}
    for stem, item in written.items():
        assert store.write(item) == sum(path.stat().st_size for path in store.files(stem))
    again = RegionStore.open(tmp_path / "a")
    assert (again.layout, again.manifest, again.stems()) == ("compact", manifest_of(), stems)
    for stem, item in written.items():
        opened = again.open_view(stem)
        assert (opened.width, opened.height, opened.dim) == (9, 6, 8)
        assert sum(opened.counts.values()) == len(item) == 12
        read = read_view(opened)
        for level in LEVELS:
            assert (read.labels[level] == item.labels[level]).all()
            assert (read.embeddings[level] == item.embeddings[level]).all()
    assert again.view("c") is None
    with pytest.raises(MissingFileError):
        again.open_view("c")


def test_a_view_counts_for_its_manifest_and_photograph(tmp_path: Path) -> None:
    store = RegionStore.create(tmp_path, manifest_of())
    store.begin()
    store.write(view("a.png"))
    assert store.has("a.png", "digest")
    assert not store.has("a.png", "another")
    assert not store.has("b.png", "digest")
    with pytest.raises(OutputExistsError):
        store.write(view("a.png"))
    before = snapshot(tmp_path)
    with refuses():
        RegionStore.create(tmp_path, manifest_of(side=3))
    assert snapshot(tmp_path) == before
    renewed = RegionStore.create(tmp_path, manifest_of(side=3), overwrite=True)
    assert snapshot(tmp_path) == before
    renewed.begin(overwrite=True)
    assert not renewed.has("a.png", "digest")
    renewed.write(view("a.png", photograph=""), overwrite=True)  # of an unknown photograph
    assert not renewed.has("a.png", "digest")


@pytest.mark.parametrize("layout", get_args(Layout))
def test_folders_without_a_manifest(tmp_path: Path, layout: Layout) -> None:
    """They are read, by the files that are there; new features are not mixed with them."""
    cameras = some_cameras(2)
    if layout == "langsplat":
        save_langsplat(some_regions(cameras), tmp_path)
    else:
        save_regions(some_regions(cameras), tmp_path)
        (tmp_path / MANIFEST).unlink()
    assert RegionStore.open(tmp_path).layout == layout
    assert load_regions(tmp_path, cameras).view_names == cameras.names
    before = snapshot(tmp_path)
    for overwrite in (False, True):
        with refuses():
            RegionStore.create(tmp_path, manifest_of(), overwrite=overwrite)
    assert snapshot(tmp_path) == before


def test_a_folder_is_not_listed_for_each_view(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store, listed = RegionStore.create(tmp_path, manifest_of()), []
    store.begin()
    for name in ("listdir", "scandir"):

        def counted(path: Path, function: Callable[[Path], Any]) -> Any:
            listed.extend([tmp_path] if str(path) == str(tmp_path) else [])
            return function(path)

        monkeypatch.setattr(os, name, partial(counted, function=getattr(os, name)))
    for number in range(5):
        store.write(view(f"view_{number}.png"))
    assert len(listed) <= 1


def test_equal_names_in_several_folders(tmp_path: Path) -> None:
    names = [
        "cam1/0000.png", "cam2/0000.png", "scan.0000.png", "scan.0001.png", "../up/a.png", "C:\\b\\a.png",
    ]  # fmt: skip
    store = RegionStore.create(tmp_path / "compact", manifest_of())
    store.begin()
    for number, name in enumerate(names):
        store.write(view(name, number))
    assert store.stems() == ["b/a", "cam1/0000", "cam2/0000", "scan.0000", "scan.0001", "up/a"]
    for number, name in enumerate(names):
        labels = store.views([name])[name].labels(["s"])[0]
        assert (labels == view(name, number).labels["s"]).all()
    for overwrite in (False, True):
        convert_regions(store.folder, tmp_path / "again", overwrite=overwrite)
    assert RegionStore.open(tmp_path / "again").stems() == store.stems()
    with refuses():
        store.check_names(["a.jpg", "a.png"])


def test_saving_needs_three_levels_of_one_size(tmp_path):
    item = RegionMap(torch.zeros(4, 4, dtype=torch.int32), torch.ones(1, 1))
    same: dict[str, RegionMap] = dict.fromkeys(LEVELS, item)
    smaller = replace(item, labels=item.labels[:3])
    for maps in ({"a": {"s": item}}, {"a": {**same, "l": smaller}}, {"a.jpg": same, "a.png": same}):
        with refuses():
            save_regions(Regions.from_maps(maps), tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("wanted", "there", "expected"), [
    (["K\u00fcche/a"], ["Ku\u0308che/a", "a"], {"K\u00fcche/a": "Ku\u0308che/a"}),
    (["cam1/a", "cam2/b"], ["a", "b"], {"cam1/a": "a", "cam2/b": "b"}),  # LangSplat's
    (["a"], ["images/a"], {"a": "images/a"}),
    (["a.0001"], ["a"], {"a.0001": "a"}),
    (["cam1/a", "cam2/a"], ["a"], {}),
    (["a"], ["cam1/a", "cam2/a"], {}),
    (["cam1/a"], ["cam2/a"], {}),
    (["a.0000"], ["a.0001"], {}),
])  # fmt: skip
def test_files_that_can_only_mean_an_image(wanted: list[str], there: list[str], expected: Any) -> None:
    assert match_stems(wanted, there) == expected
