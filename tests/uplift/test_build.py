"""Build: from a scene to a field, gone on with where it was interrupted, and again from kept region sums."""

from __future__ import annotations

import dataclasses
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import scoup
from cli_support import snapshot
from messages import refuses, warns
from scoup.base import Part, ScoupWarning, UnknownNameError
from scoup.field import Field
from scoup.scene import Cameras, RegionMap, Regions
from scoup.uplift.field_build import build
from scoup.uplift.rasterise import add_views, open_sums, region_sums
from scoup.uplift.settings import BUILD_PRESETS, BuildSettings, build_settings
from scoup.uplift.storage.array_file import view_file
from scoup.uplift.stored_sums import RegionSums
from support import changed_regions, make_camera, random_gaussians, small_scene, threads_of_torch, unit

QUICK = BuildSettings(n_atoms=8, k=3, keep=3, rounds=2)


def quick(**changes: Any) -> BuildSettings:
    return dataclasses.replace(QUICK, **changes)


@pytest.fixture(scope="module")
def scene():
    return small_scene()


@pytest.fixture(scope="module")
def built(scene) -> Field:
    return build(*scene, settings=QUICK)


def saved(field: Field, path: Path) -> bytes:
    field.save(path)
    return path.read_bytes()


@pytest.fixture(scope="module")
def whole(built, tmp_path_factory) -> bytes:
    """The file of the field of the scene."""
    return saved(built, tmp_path_factory.mktemp("whole") / "whole.scoup")


def other_embeddings(regions: Regions) -> Regions:
    """The same regions with embeddings of another model."""

    def embedded(name: str, level: str, known: RegionMap) -> RegionMap:
        generator = torch.Generator().manual_seed(int(name[5:7]) * 3 + regions.levels.index(level))
        return RegionMap(known.labels, unit(torch.randn(len(known.embeddings), 24, generator=generator)))

    return changed_regions(regions, embedded)


@pytest.mark.parametrize("at", [("region sums", 2), ("coding m", 0), ("vote", 1)])
def test_an_interrupted_build_goes_on_and_gives_the_same_bytes(scene, whole, tmp_path, at, monkeypatch):
    gaussians, _, regions = scene
    path = tmp_path / "sums"
    sums = open_sums(path, gaussians, regions, QUICK)

    def press_ctrl_c(stage: str, done: int, _: int) -> None:
        if (stage, done) == at:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        build(*scene, settings=QUICK, sums=sums, progress=press_ctrl_c)
    taken = {"region sums": 2, "vote": 4, "coding m": 0}[at[0]]
    sums = open_sums(path, gaussians, regions, QUICK)
    assert len(sums) == taken
    projected = []
    project = scoup.raster.project
    monkeypatch.setattr(
        scoup.raster, "project", lambda *a, **k: projected.append(a[1].name) or project(*a, **k)
    )
    again = build(*scene, settings=quick(check_fit=False), sums=sums)
    assert len(projected) == 4 - taken  # no view is done again
    assert saved(again, tmp_path / "resumed.scoup") == whole


def test_what_changed_during_an_interruption_is_rasterised_again(scene, built, tmp_path):
    gaussians, cameras, regions = scene
    sums = region_sums(*scene, path=tmp_path / "sums")

    def turned(name: str, _: str, known: RegionMap) -> RegionMap:
        return RegionMap(known.labels.flip(1), known.embeddings) if name == cameras.names[1] else known

    changed = changed_regions(regions, turned)
    moved = Cameras([cameras[0].resized(30, 20), *list(cameras)[1:]])
    before = dict(sums.views)
    again = build(gaussians, moved, changed, settings=QUICK, sums=sums)
    assert sums.views == before  # what was passed stays as it is
    grown = region_sums(gaussians, moved, changed, sums=sums)
    assert [name for name in before if grown.views[name] is not before[name]] == list(cameras.names[:2])
    assert set(RegionSums.open(tmp_path / "sums").views) == set(before)
    fresh = build(gaussians, moved, changed, settings=QUICK)
    assert saved(again, tmp_path / "a.scoup") == saved(fresh, tmp_path / "b.scoup")
    assert fresh.info.provenance["label_maps"] != built.info.provenance["label_maps"]


def test_a_damaged_view_is_made_again(scene, whole, tmp_path):
    """After a power cut, a file may have its name and not its contents."""
    gaussians, cameras, regions = scene
    path = tmp_path / "sums"
    region_sums(*scene, path=path)
    before = snapshot(path)
    (path / view_file(cameras.names[1])).write_bytes(b"")
    with warns(ScoupWarning):
        sums = open_sums(path, gaussians, regions, QUICK)
    assert saved(build(*scene, settings=QUICK, sums=sums), tmp_path / "b.scoup") == whole
    assert snapshot(path) == before


@pytest.mark.parametrize("parts", [3, 7])
def test_parts_in_any_order_make_the_field_of_one_process(scene, whole, tmp_path, parts):
    """Also where there are more parts than views, and where a part is made twice."""
    for number in [*reversed(range(1, parts + 1)), 1]:
        sums = region_sums(*scene, path=tmp_path / "sums", part=Part(number, parts))
        assert set(sums.views) >= set(Part(number, parts).of(scene[1].names))
    of_parts = build(*scene, settings=QUICK, sums=RegionSums.open(tmp_path / "sums"))
    assert saved(of_parts, tmp_path / "parts.scoup") == whole
    region_sums(*scene, path=tmp_path / "alone")
    assert snapshot(tmp_path / "sums") == snapshot(tmp_path / "alone")


def test_processes_that_begin_one_folder_at_the_same_time(scene, tmp_path):
    gaussians, cameras, regions = scene
    path = tmp_path / "sums"
    first, second = (RegionSums.empty(gaussians, regions.levels, path=path) for _ in range(2))
    region_sums(gaussians, cameras[:2], regions, sums=first)
    region_sums(gaussians, cameras[2:], regions, sums=second)
    region_sums(*scene, path=tmp_path / "alone")
    assert snapshot(path) == snapshot(tmp_path / "alone")
    other = RegionSums.empty(random_gaussians(len(gaussians), 9), regions.levels)
    other.path = path
    with refuses():
        add_views(other, gaussians, list(cameras), regions)


# ---- the codebook of an earlier field


def test_the_codebook_of_a_field_keeps_its_codes(scene, built):
    again = build(*scene, settings=QUICK, codebook=built)
    assert torch.equal(again.codebook, built.codebook)
    assert torch.equal(again.code_indices, built.code_indices)
    assert torch.equal(again.code_weights, built.code_weights)
    reports = again.info.provenance["coding"]
    assert {report["solver"] for report in reports.values()} == {"codebook of a field"}
    for level, report in built.info.provenance["coding"].items():
        assert reports[level]["explained_from"] == report["explained_from"]
        assert reports[level]["mean_cosine"] == pytest.approx(report["mean_cosine"], abs=1e-6)
    assert again.info.provenance["inputs"] != built.info.provenance["inputs"]


@pytest.mark.filterwarnings("ignore::scoup.base.errors.ScoupWarning")  # random embeddings are not explained
def test_photographs_that_came_later(scene, tmp_path):
    gaussians, cameras, regions = scene
    sums = region_sums(gaussians, cameras[:2], regions, path=tmp_path / "sums")
    first = build(gaussians, cameras[:2], regions, settings=QUICK, sums=sums)
    before = dict(sums.views)
    sums = region_sums(*scene, sums=sums)
    grown = build(*scene, settings=quick(n_atoms=5), sums=sums, codebook=first)
    assert all(sums.views[name] is view for name, view in before.items())
    assert torch.equal(grown.codebook, first.codebook)
    assert grown.info.provenance["settings"]["n_atoms"] == 8
    assert grown.info.provenance["views"] == list(cameras.names)
    fewer = build(gaussians, cameras[:2], regions, settings=QUICK, sums=sums, codebook=first)
    assert torch.equal(fewer.code_weights, first.code_weights)


def test_views_that_a_codebook_explains_badly_are_named(scene):
    gaussians, cameras, regions = scene
    rows = unit(torch.randn(len(regions.levels), 1, 16, generator=torch.Generator().manual_seed(3)))
    alike = dict(zip(regions.levels, rows, strict=True))  # all regions of the early views are of one thing

    def early(name: str, level: str, known: RegionMap) -> RegionMap:
        rows = known.embeddings if name == "view_03.png" else alike[level].expand(len(known.embeddings), -1)
        return RegionMap(known.labels, rows)

    changed = changed_regions(regions, early)
    first = build(gaussians, cameras[:3], changed, settings=QUICK)
    with warns(ScoupWarning):
        build(gaussians, cameras, changed, settings=QUICK, codebook=first)
    build(gaussians, cameras[:3], changed, settings=QUICK, codebook=first)  # a warning would be an error


def test_a_codebook_of_other_regions_is_refused(scene, built):
    gaussians, cameras, regions = scene
    one = Regions.from_maps({name: {"m": regions.load(name, "m")} for name in regions.view_names})
    for other in (other_embeddings(regions), one):
        with refuses():
            build(gaussians, cameras, other, settings=QUICK, codebook=built)


@pytest.mark.parametrize("change", [
    {"n_atoms": 5, "k": 2, "keep": 2, "seed": 4},
    {"rounds": 1}, {"rounds": 3, "keep": 0}, {"solver": "adam", "epochs": 5}, "embeddings", "views",
])  # fmt: skip
def test_from_kept_sums_other_settings_embeddings_and_views_equal_a_whole_build(scene, tmp_path, change):
    gaussians, cameras, regions = scene
    region_sums(*scene, path=tmp_path / "f.sums")
    given = {
        "cameras": cameras[1:3] if change == "views" else cameras,
        "regions": other_embeddings(regions) if change == "embeddings" else regions,
        "settings": QUICK if isinstance(change, str) else quick(**change),
    }
    kept = build(gaussians, sums=RegionSums.open(tmp_path / "f.sums"), **given)
    assert kept.dim == (24 if change == "embeddings" else 16)
    assert saved(kept, tmp_path / "kept.scoup") == saved(build(gaussians, **given), tmp_path / "whole.scoup")


def test_more_views_than_kept_sums_have(scene, whole, tmp_path):
    gaussians, cameras, regions = scene
    region_sums(gaussians, cameras[:2], regions, path=tmp_path / "f.sums")
    with refuses():
        build(*scene, settings=QUICK, sums=RegionSums.open(tmp_path / "f.sums"))
    grown = build(*scene, settings=QUICK, sums=RegionSums.open(tmp_path / "f.sums", writable=True))
    assert saved(grown, tmp_path / "grown.scoup") == whole


def test_sums_of_another_scene_are_refused(scene):
    gaussians, cameras, regions = scene
    sums = region_sums(*scene)
    other = random_gaussians(len(gaussians), 9)
    for splat, changes in (
        (other, {}),
        (gaussians, {"raster_preset": "gsplat"}),
        (gaussians, {"scale": 0.5}),
    ):
        with refuses():
            build(splat, cameras, regions, settings=quick(**changes), sums=sums)


@pytest.mark.parametrize(("scale", "factor"), [("auto", 23 / 41), (0.3, 0.3)])
def test_region_sums_are_those_of_scaled_cameras(scene, tmp_path, monkeypatch, scale, factor):
    """Also of odd sizes; the field keeps the cameras it was given."""
    gaussians, cameras, regions = scene
    monkeypatch.setattr("scoup.uplift.constants.AUTO_SIDE", 23)
    odd = Cameras(camera.resized(41, 29) for camera in cameras)
    sums = region_sums(gaussians, odd, regions, BuildSettings(scale=scale), path=tmp_path / "sums")
    whole = region_sums(gaussians, odd.scaled(factor), regions, BuildSettings(scale=1.0))
    for level in range(len(regions.levels)):
        np.testing.assert_array_equal(sums.matrix(level).toarray(), whole.matrix(level).toarray())
    settings = quick(scale=scale)
    field = build(gaussians, odd, regions, settings, sums=RegionSums.open(tmp_path / "sums"))
    assert field.cameras is not None
    assert {camera.width for camera in field.cameras} == {41}
    assert field.info.provenance["settings"]["scale"] == scale
    fresh = build(gaussians, odd, regions, settings)
    assert saved(field, tmp_path / "a.scoup") == saved(fresh, tmp_path / "b.scoup")


def test_backends_build_the_same_field_with_the_same_bytes_for_any_number_of_threads(scene, tmp_path):
    fields = []
    for backend in ("native", "reference"):
        files = []
        for threads in (1, 3):
            with threads_of_torch(threads):
                fields.append(build(*scene, settings=quick(backend=backend)))
            files.append(saved(fields[-1], tmp_path / f"{len(fields)}.scoup"))
        assert files[0] == files[1]
    native, _, reference, _ = fields
    sharpness = native.info.provenance["sharpness"]
    assert native.info.provenance == {**reference.info.provenance, "sharpness": sharpness}
    same = (native.code_indices == reference.code_indices).all(-1)
    assert same.float().mean() > 0.999
    torch.testing.assert_close(native.code_weights[same], reference.code_weights[same], atol=1e-3, rtol=0)


def test_nothing_grows_with_the_number_of_views_but_the_sums(scene, whole, tmp_path, monkeypatch):
    """A build of its own keeps region sums in a temporary folder, which is gone then."""
    gaussians, _, regions = scene
    folders = []
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    append = RegionSums.append
    with monkeypatch.context() as patch:
        patch.setattr(RegionSums, "append", lambda *view: folders.append(view[0].path) or append(*view))
        build(*scene, settings=QUICK)
    assert {path.parent.parent for path in folders} == {tmp_path}
    assert not list(tmp_path.iterdir())
    in_memory = build(*scene, settings=QUICK, sums=RegionSums.empty(gaussians, regions.levels))
    assert saved(in_memory, tmp_path / "a.scoup") == whole


def test_presets():
    assert BUILD_PRESETS["default"] == BuildSettings()
    paper = BUILD_PRESETS["paper"]
    assert (paper.n_atoms, paper.k, paper.keep, paper.solver, paper.epochs) == (64, 4, 4, "adam", 4000)
    assert (paper.rounds, paper.scale, paper.things) == (1, 1.0, False)
    assert build_settings("paper", k=2).keep == 4  # of a Gaussian, whatever a region's code has
    assert build_settings("paper", k=2, keep=0).keep == 0
    assert build_settings("paper", things=None).things is False
    assert build_settings(seed=3, things=False) == BuildSettings(seed=3, things=False)
    few, two, five = build_settings(n_atoms=3), build_settings("paper", n_atoms=2), build_settings(n_atoms=5)
    sizes = [(each.n_atoms, each.k, each.keep) for each in (few, two, five)]
    assert sizes == [(3, 3, 3), (2, 2, 2), (5, 4, 4)]
    with refuses(UnknownNameError):
        build_settings("papers")
    mistakes: list[dict[str, Any]] = [{"n_atoms": 5, "k": 8}, {"rounds": 0}]
    mistakes += [{"scale": scale} for scale in (0, 1.5, -1, "half")]
    for wrong in mistakes:
        with refuses():
            build_settings(**wrong)


def test_cameras_that_see_nothing(scene):
    gaussians, cameras, regions = scene
    away = dataclasses.replace(gaussians, means=gaussians.means - 100)
    with refuses():
        build(away, cameras, regions, settings=QUICK)
    with refuses():
        build(gaussians, Cameras([make_camera(name="other.png")]), regions, settings=QUICK)


def test_regions_that_cannot_be_coded_are_refused(scene):
    gaussians, cameras, _ = scene
    for value, embeddings in (
        (0, {"m": torch.zeros(1, 16)}),
        (0, {"s": torch.ones(1, 16), "m": torch.ones(1, 8)}),
        (-1, {"m": torch.zeros(0, 16)}),
    ):
        labels = torch.full((30, 40), value, dtype=torch.int32)
        maps = {level: RegionMap(labels, rows) for level, rows in embeddings.items()}
        regions = Regions.from_maps({camera.name: maps for camera in cameras})
        with refuses():
            build(gaussians, cameras, regions, settings=QUICK)
