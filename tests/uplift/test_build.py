"""Build: from a scene to a field, gone on with where it was interrupted, and again from kept region sums."""

from __future__ import annotations

import dataclasses
import tempfile
from pathlib import Path

import pytest
import torch

import scoup
from scoup.base.errors import InputError, ScoupWarning, UnknownNameError
from scoup.raster import morton_order
from scoup.scene.cameras import Cameras
from scoup.scene.regions import RegionMap, Regions
from scoup.uplift.build import build
from scoup.uplift.build_settings import BUILD_PRESETS, BuildSettings, build_settings
from scoup.uplift.rasterise import region_sums, resume_sums
from scoup.uplift.region_codes import RegionCodes
from scoup.uplift.region_sums import RegionSums
from support import make_camera, random_gaussians, small_scene, unit

QUICK = BuildSettings(n_atoms=8, k=3, keep=3, rounds=2)


@pytest.fixture(scope="module")
def scene():
    return small_scene()


def saved(field: scoup.LanguageField, path: Path) -> bytes:
    field.save(path)
    return path.read_bytes()


def flipped(regions: Regions, names: tuple[str, ...]) -> Regions:
    """The same regions, with the label maps of some views turned left to right."""

    def load(name: str, level: str) -> RegionMap:
        found = regions.load(name, level)
        return RegionMap(found.labels.flip(1), found.embeddings) if name in names else found

    return Regions(regions.levels, regions.view_names, load)


def other_embeddings(regions: Regions, seed: int = 5) -> Regions:
    """The same regions with embeddings of another model."""

    def load(name: str, level: str) -> RegionMap:
        found = regions.load(name, level)
        generator = torch.Generator().manual_seed(seed + hash((name, level)) % 1000)
        return RegionMap(found.labels, unit(torch.randn(len(found.embeddings), 24, generator=generator)))

    maps = {name: {level: load(name, level) for level in regions.levels} for name in regions.view_names}
    return Regions.from_maps(maps)


class Stages:
    """A progress that remembers, and presses Ctrl-C when told."""

    def __init__(self, stop: tuple[str, int] | None = None) -> None:
        self.stop = stop
        self.seen: list[tuple[str, int]] = []

    def __call__(self, stage: str, done: int, total: int) -> None:
        self.seen.append((stage, done))
        if (stage, done) == self.stop:
            raise KeyboardInterrupt

    def names(self) -> set[str]:
        return {stage for stage, _ in self.seen}


@pytest.mark.parametrize("at", [("region sums", 2), ("vote", 0), ("vote", 1), ("coding m", 0)])
def test_an_interrupted_build_goes_on_and_gives_the_same_bytes(scene, tmp_path, at, monkeypatch):
    gaussians, _, regions = scene
    whole = saved(build(*scene, settings=QUICK), tmp_path / "whole.scoup")
    path = tmp_path / "f.partial"
    sums = resume_sums(path, gaussians, regions)
    with pytest.raises(KeyboardInterrupt):
        build(*scene, settings=QUICK, sums=sums, progress=Stages(at))
    taken = {"region sums": 2, "vote": 4, "coding m": 0}[at[0]]
    sums = resume_sums(path, gaussians, regions)
    assert len(sums) == taken
    projected = []
    project = scoup.raster.project
    monkeypatch.setattr(
        scoup.raster, "project", lambda *a, **k: projected.append(a[1].name) or project(*a, **k)
    )
    stages = Stages()
    again = build(*scene, settings=QUICK, sums=sums, check_fit=False, progress=stages)
    assert len(projected) == 4 - taken  # no view is done again
    assert ("coding s" in stages.names()) == (
        at[0] == "coding m"
    )  # codes are kept as soon as they are learned
    assert saved(again, tmp_path / "resumed.scoup") == whole


def test_what_changed_during_an_interruption_is_rasterised_again(scene, tmp_path):
    gaussians, cameras, regions = scene
    sums = resume_sums(tmp_path / "f.partial", gaussians, regions)
    build(*scene, settings=QUICK, sums=sums)
    changed = flipped(regions, cameras.names[1:2])
    moved = Cameras([cameras[0].resized(30, 20), *list(cameras)[1:]])
    before = dict(sums.views)
    again = build(gaussians, moved, changed, settings=QUICK, sums=sums)
    assert [name for name in before if sums.views[name] is not before[name]] == list(cameras.names[:2])
    fresh = build(gaussians, moved, changed, settings=QUICK)
    assert saved(again, tmp_path / "a.scoup") == saved(fresh, tmp_path / "b.scoup")
    assert fresh.info.provenance["label_maps"] != build(*scene, settings=QUICK).info.provenance["label_maps"]


def test_a_folder_that_cannot_be_gone_on_from_is_replaced(scene, tmp_path):
    gaussians, _, regions = scene
    path = tmp_path / "f.partial"
    path.mkdir()
    (path / "scene.safetensors").write_bytes(b"damaged" * 100)
    with pytest.warns(ScoupWarning, match=r"f\.partial.*starting over"):
        sums = resume_sums(path, gaussians, regions)
    build(*scene, settings=QUICK, sums=sums)
    other = random_gaussians(len(gaussians), 77)
    with pytest.warns(ScoupWarning, match="other Gaussians"):
        sums = resume_sums(path, other, regions)
    sums.keep_codes({}, {})
    with pytest.warns(ScoupWarning, match="weights"):
        sums = resume_sums(path, other, regions, weights="float16")
    assert len(sums) == 0


@pytest.mark.parametrize(
    "change",
    [{}, {"n_atoms": 5, "k": 2, "keep": 2}, {"seed": 4}, {"rounds": 1}, {"rounds": 3}, {"keep": 0},
     {"solver": "adam", "epochs": 20}],
)  # fmt: skip
def test_other_settings_from_kept_sums_equal_a_whole_build(scene, tmp_path, change):
    gaussians, cameras, regions = scene
    region_sums(gaussians, cameras, regions, path=tmp_path / "f.sums")
    sums = RegionSums.open(tmp_path / "f.sums")
    settings = dataclasses.replace(QUICK, **change)
    kept = build(*scene, settings=settings, sums=sums)
    assert saved(kept, tmp_path / "kept.scoup") == saved(
        build(*scene, settings=settings), tmp_path / "w.scoup"
    )


def test_other_embeddings_from_kept_sums_equal_a_whole_build(scene, tmp_path):
    gaussians, cameras, regions = scene
    sums = region_sums(gaussians, cameras, regions)
    others = other_embeddings(regions)
    kept = build(gaussians, cameras, others, settings=QUICK, sums=sums)
    assert kept.dim == 24
    whole = build(gaussians, cameras, others, settings=QUICK)
    assert saved(kept, tmp_path / "kept.scoup") == saved(whole, tmp_path / "whole.scoup")


def test_fewer_views_from_kept_sums_equal_a_whole_build(scene, tmp_path):
    gaussians, cameras, regions = scene
    sums = region_sums(gaussians, cameras, regions)
    kept = build(gaussians, cameras[1:3], regions, settings=QUICK, sums=sums)
    whole = build(gaussians, cameras[1:3], regions, settings=QUICK)
    assert saved(kept, tmp_path / "kept.scoup") == saved(whole, tmp_path / "whole.scoup")


def test_more_views_than_kept_sums_have(scene, tmp_path):
    gaussians, cameras, regions = scene
    region_sums(gaussians, cameras[:2], regions, path=tmp_path / "f.sums")
    with pytest.raises(InputError, match=r"f\.sums: lacks the view 'view_02.png'"):
        build(*scene, settings=QUICK, sums=RegionSums.open(tmp_path / "f.sums"))
    grown = build(*scene, settings=QUICK, sums=RegionSums.open(tmp_path / "f.sums", writable=True))
    whole = build(*scene, settings=QUICK)
    assert saved(grown, tmp_path / "grown.scoup") == saved(whole, tmp_path / "whole.scoup")


def test_sums_of_another_scene_are_refused(scene):
    gaussians, cameras, regions = scene
    sums = region_sums(gaussians, cameras, regions)
    with pytest.raises(InputError, match="other Gaussians"):
        build(random_gaussians(len(gaussians), 9), cameras, regions, settings=QUICK, sums=sums)
    gsplat = dataclasses.replace(QUICK, raster_preset="gsplat")
    with pytest.raises(InputError, match="other rasteriser preset"):
        build(gaussians, cameras, regions, settings=gsplat, sums=sums)


def test_codes_are_kept_beside_the_sums(scene):
    gaussians, _, regions = scene
    sums = RegionSums(gaussians.fingerprint(), morton_order(gaussians.means), regions.levels)
    field = build(*scene, settings=QUICK, sums=sums)
    coded = RegionCodes.load(sums)
    assert coded is not None
    assert torch.equal(coded.codebook, field.codebook)
    assert RegionCodes.load(sums, "another key") is None
    voters = sums.select(coded.rows[0], coded.rows)
    found = scoup.vote(voters, coded.codes, coded.codebook, 2, 3)
    assert torch.equal(found.indices, field.code_indices)
    assert torch.equal(found.weights.half(), field.code_weights)


@pytest.mark.parametrize("backend", ["native", "reference"])
def test_the_same_bytes_for_any_number_of_threads(scene, tmp_path, backend):
    before = torch.get_num_threads()
    try:
        for threads in (1, 2, 3):
            torch.set_num_threads(threads)
            build(*scene, settings=QUICK, backend=backend).save(tmp_path / f"{threads}.scoup")
    finally:
        torch.set_num_threads(before)
    assert len({path.read_bytes() for path in tmp_path.iterdir()}) == 1


def test_backends_build_the_same_field(scene):
    fields = [build(*scene, settings=QUICK, backend=backend) for backend in ("native", "reference")]
    same = (fields[0].code_indices == fields[1].code_indices).all(-1)
    assert same.float().mean() > 0.999
    torch.testing.assert_close(fields[0].code_weights[same], fields[1].code_weights[same], atol=1e-3, rtol=0)


def test_nothing_grows_with_the_number_of_views_but_the_sums(scene, tmp_path, monkeypatch):
    """A build of its own keeps region sums in a temporary folder, which is gone then."""
    gaussians, _, regions = scene
    folders = []
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with monkeypatch.context() as patch:
        append = RegionSums.append
        patch.setattr(
            RegionSums, "append", lambda self, *view: folders.append(self.path) or append(self, *view)
        )
        alone = build(*scene, settings=QUICK)
    assert {path.parent.parent for path in folders} == {tmp_path}
    assert not list(tmp_path.iterdir())
    in_memory = build(*scene, settings=QUICK, sums=RegionSums.empty(gaussians, regions.levels))
    assert saved(in_memory, tmp_path / "a.scoup") == saved(alone, tmp_path / "b.scoup")


def test_presets():
    assert BUILD_PRESETS["default"] == BuildSettings()
    paper = BUILD_PRESETS["paper"]
    assert (paper.n_atoms, paper.k, paper.keep, paper.solver, paper.epochs) == (64, 4, 4, "adam", 4000)
    assert (paper.rounds, paper.things) == (1, False)
    default = BUILD_PRESETS["default"]
    assert (default.n_atoms, default.k, default.keep) == (128, 4, 4)
    assert (default.rounds, default.solver, default.effort, default.things) == (2, "exact", "fast", True)
    assert build_settings("paper", k=2).keep == 4  # of a Gaussian, whatever a region's code has
    assert build_settings("paper", k=2, keep=0).keep == 0
    assert build_settings(things=False) == BuildSettings(things=False)
    assert build_settings("paper", things=None).things is False
    assert build_settings(seed=3) == BuildSettings(seed=3)
    few, two = build_settings(n_atoms=3), build_settings("paper", n_atoms=2)
    assert [(each.n_atoms, each.k, each.keep) for each in (few, two)] == [(3, 3, 3), (2, 2, 2)]
    assert (build_settings(n_atoms=5).k, build_settings(n_atoms=5).keep) == (4, 4)
    with pytest.raises(InputError, match="must not exceed the 5 atoms"):
        build_settings(n_atoms=5, k=8)
    with pytest.raises(UnknownNameError, match="paper"):
        build_settings("papers")
    with pytest.raises(InputError, match="at least one round"):
        BuildSettings(rounds=0)


def test_cameras_that_see_nothing(scene):
    gaussians, cameras, regions = scene
    away = scoup.Gaussians(
        gaussians.means - 100, gaussians.quats, gaussians.scales, gaussians.opacities, gaussians.sh
    )
    with pytest.raises(InputError, match="see nothing"):
        build(away, cameras, regions, settings=QUICK)


def test_almost_nothing_seen_is_reported(scene):
    _, cameras, regions = scene
    many = random_gaussians(400, 3)
    many.means[1:] -= 100
    many.means[0] = torch.tensor([0.0, 0.0, 3.0])
    many.opacities[0] = 0.9
    with pytest.warns(ScoupWarning, match="same frame"):
        build(many, cameras, regions, settings=QUICK)


def test_cameras_and_regions_of_different_scenes(scene):
    gaussians, _, regions = scene
    with pytest.raises(InputError, match="names agree"):
        build(gaussians, Cameras([make_camera(name="other.png")]), regions, settings=QUICK)


def test_embeddings_that_cannot_be_coded_are_refused(scene):
    gaussians, cameras, _ = scene
    labels = torch.zeros(30, 40, dtype=torch.int32)

    def regions_of(**embeddings: torch.Tensor) -> Regions:
        maps = {level: scoup.RegionMap(labels, rows) for level, rows in embeddings.items()}
        return Regions.from_maps({camera.name: maps for camera in cameras})

    with pytest.raises(InputError, match="zero embeddings"):
        build(gaussians, cameras, regions_of(m=torch.zeros(1, 16)), settings=QUICK)
    with pytest.raises(InputError, match="different sizes"):
        build(gaussians, cameras, regions_of(s=torch.ones(1, 16), m=torch.ones(1, 8)), settings=QUICK)


def test_a_level_without_regions_is_refused(scene):
    gaussians, cameras, _ = scene
    empty = scoup.RegionMap(torch.full((30, 40), -1, dtype=torch.int32), torch.zeros(0, 16))
    regions = Regions.from_maps({camera.name: {"m": empty} for camera in cameras})
    with pytest.raises(InputError, match="no regions"):
        build(gaussians, cameras, regions, settings=QUICK)
