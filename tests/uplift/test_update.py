"""Views added to a field, removed from it, or changed, with atoms for what its codebook has never seen."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from scoup.base.errors import InputError, ScoupWarning
from scoup.base.native import native_core
from scoup.coding.encode import encode
from scoup.field.language_field import LanguageField
from scoup.pictures.colors import code_picture
from scoup.query.question import Question
from scoup.query.view_answer import most_relevant_pixel
from scoup.query.votes import select_each
from scoup.scene.cameras import Camera, Cameras
from scoup.scene.codes import SparseCodes
from scoup.scene.directions import normalise_embeddings
from scoup.scene.gaussians import Gaussians
from scoup.scene.regions import RegionMap, Regions
from scoup.uplift.build import build
from scoup.uplift.build_settings import BuildSettings
from scoup.uplift.rasterise import region_sums
from scoup.uplift.region_codes import RegionCodes, concatenate_codes
from scoup.uplift.region_sums import RegionSums
from scoup.uplift.update import append_update, update
from scoup.uplift.vote import vote
from support import make_camera, random_labels, small_scene, unit

DIM = 32
EDGES = (
    -2.8,
    -1.4,
    0.0,
    1.4,
    2.8,
)  # of four things side by side on a wall; nothing sees the last one at first
NEW = 3
LEVELS = ("s", "m")
SETTINGS = BuildSettings(n_atoms=6, k=2, solver="exact")


class Wall:
    """A wall of Gaussians at z = 4. Early cameras see things 0 to 2, late ones thing 3 (and a little of thing 2).
    Level "s" has regions everywhere, level "m" none on thing 3.
    """

    def __init__(self) -> None:
        generator = torch.Generator().manual_seed(0)
        x, y = torch.meshgrid(torch.arange(-2.8, 2.8, 0.1), torch.arange(-1.2, 1.2, 0.1), indexing="ij")
        means = torch.stack([x.flatten(), y.flatten(), torch.full_like(x.flatten(), 4.0)], 1)
        count = len(means)
        quats = torch.tensor([[1.0, 0, 0, 0]]).repeat(count, 1)
        scales, opacities = torch.full((count, 3), 0.06), torch.full((count,), 0.9)
        self.gaussians = Gaussians(means, quats, scales, opacities, torch.zeros(count, 1, 3))
        self.early = Cameras(self._camera(f"early_{i}.png", -1.5 + 0.1 * i) for i in range(8))
        self.late = [self._camera(f"late_{i}.png", 2.1 + 0.1 * i) for i in range(2)]
        self._mean = unit(torch.randn(DIM, generator=generator))
        self.things = unit(torch.randn(len(EDGES) - 1, DIM, generator=generator))
        self.canonical = unit(self._mean + 0.2 * torch.randn(4, DIM, generator=generator))
        maps = {camera.name: self._maps(camera, generator) for camera in [*self.early, *self.late]}
        self.regions = Regions.from_maps(maps)

    def _camera(self, name: str, x: float) -> Camera:
        viewmat = torch.eye(4, dtype=torch.float64)
        viewmat[0, 3] = -x
        return replace(make_camera(40, 24, 60.0, name=name), viewmat=viewmat)

    def shows(self, camera: Camera) -> Tensor:
        """[W]: the thing in each column of a view."""
        columns = torch.arange(camera.width) + 0.5
        x = (columns - camera.cx) / camera.fx * 4.0 - float(camera.viewmat[0, 3])
        return torch.bucketize(x, torch.tensor(EDGES)) - 1

    def _maps(self, camera: Camera, generator: torch.Generator) -> dict[str, RegionMap]:
        shows = self.shows(camera).clamp(0, NEW)
        rows = torch.arange(camera.height) * 3 // camera.height  # three regions a thing, one above the other
        labels = (shows[None] * 3 + rows[:, None]).int()
        which = torch.arange(3 * (NEW + 1)) // 3
        noise = 0.15 * torch.randn(len(which), DIM, generator=generator) / DIM**0.5
        embeddings = unit(self._mean + self.things[which] + noise)
        # Only what is in sight has a region.
        seen = labels.unique().long()
        renumbered = torch.full((len(which),), -1, dtype=torch.int32)
        renumbered[seen] = torch.arange(len(seen), dtype=torch.int32)
        fine = RegionMap(renumbered[labels.long()], embeddings[seen])
        old = seen[which[seen] != NEW]
        renumbered = torch.full((len(which),), -1, dtype=torch.int32)
        renumbered[old] = torch.arange(len(old), dtype=torch.int32)
        return {"s": fine, "m": RegionMap(renumbered[labels.long()], embeddings[old])}


@pytest.fixture(scope="module")
def wall() -> Wall:
    return Wall()


Kept = tuple[LanguageField, RegionSums]


def built(wall: Wall, settings: BuildSettings = SETTINGS) -> Kept:
    """The field of the early views, with its region sums."""
    sums = RegionSums.empty(wall.gaussians, LEVELS)
    return build(wall.gaussians, wall.early, wall.regions, settings=settings, sums=sums), sums


@pytest.fixture
def kept(wall: Wall) -> Kept:
    return built(wall)


def grow(wall: Wall, kept: Kept, number: int = 0, new_atoms: int = 4) -> LanguageField:
    return update(*kept, wall.late[number : number + 1], wall.regions, new_atoms=new_atoms)


@pytest.fixture(scope="module")
def grown_and_sums(wall: Wall) -> Kept:
    field, sums = built(wall)
    return grow(wall, (field, sums)), sums


@pytest.fixture(scope="module")
def grown(grown_and_sums: Kept) -> LanguageField:
    return grown_and_sums[0]


def assert_same(one: LanguageField, other: LanguageField) -> None:
    assert one.code_indices.equal(other.code_indices)
    assert one.code_weights.equal(other.code_weights)
    assert one.codebook.equal(other.codebook)


def answer(wall: Wall, field: LanguageField) -> tuple[bool, float]:
    """Whether the new thing is found in a late view, and the mean relevancy on it minus that beside it."""
    camera = wall.late[1]
    relevancy = field.relevancy(camera, wall.things[[NEW]], wall.canonical)[:, 0]
    on = wall.shows(camera) == NEW
    level = int(relevancy.flatten(1).amax(1).argmax())
    pixel = most_relevant_pixel(relevancy[level], torch.ones_like(relevancy[level], dtype=torch.bool))
    assert pixel is not None
    return bool(on[pixel[0]]), float(relevancy[0][:, on].mean() - relevancy[0][:, ~on].mean())


def test_a_thing_seen_only_later_is_found_with_new_atoms(
    wall: Wall, kept: Kept, grown: LanguageField
) -> None:
    with pytest.warns(
        ScoupWarning, match=r"% of the regions of 'late_0.png' are badly explained .*new_atoms"
    ):
        without = grow(wall, kept, new_atoms=0)
    assert without.n_atoms == 6
    assert without.info.provenance["updates"] == [{"added": ["late_0.png"], "removed": []}]
    found, contrast = answer(wall, grown)
    _, contrast_without = answer(wall, without)
    print(f"contrast with new atoms {contrast:.3f}, without {contrast_without:.3f}")
    assert found
    assert contrast > 0.3
    assert contrast > contrast_without + 0.2
    # The Gaussians themselves: those of the new thing are selected, and hardly any other.
    none = wall.things[:0]
    question = Question(("new",), wall.things[NEW][None], wall.canonical, none)
    chosen = next(select_each(grown, question)).mask
    on_it = wall.gaussians.means[:, 0] > EDGES[NEW]
    assert float(on_it[chosen].float().mean()) > 0.9
    assert int(chosen.sum()) > 100


def test_what_grows_and_what_stays(wall: Wall, kept: Kept, grown: LanguageField) -> None:
    field = kept[0]
    (done,) = grown.info.provenance["updates"]
    assert (done["added"], done["removed"]) == (["late_0.png"], [])
    new = done["new_atoms"]["late_0.png"]
    assert 1 <= new["s"] <= 4
    assert new["m"] == 0
    count = 6 + new["s"]
    assert grown.codebook.shape == (2, count, DIM)
    assert grown.codebook[:, :6].equal(field.codebook)
    torch.testing.assert_close(torch.linalg.vector_norm(grown.codebook[0, 6:], dim=1), torch.ones(new["s"]))
    assert not grown.codebook[1, 6:].any()
    assert int(grown.code_indices[:, 1][grown.code_weights[:, 1] > 0].max()) < 6
    assert grown.info.provenance["views"] == [*wall.early.names, "late_0.png"]
    assert grown.info.provenance["coding"] == field.info.provenance["coding"]
    assert grown.cameras is not None
    assert grown.cameras.names[-1] == "late_0.png"
    assert_same(grow(wall, kept), grown)


def test_gaussians_that_a_view_does_not_see_keep_their_codes(wall: Wall) -> None:
    """With one round: later rounds learn anew how strictly regions are held to the first."""
    field, sums = built(wall, replace(SETTINGS, rounds=1))
    grown = grow(wall, (field, sums))
    unseen = wall.gaussians.means[:, 0] < 0
    assert grown.code_indices[unseen].equal(field.code_indices[unseen])
    assert grown.code_weights[unseen].equal(field.code_weights[unseen])
    assert not grown.code_weights[~unseen].equal(field.code_weights[~unseen])


@pytest.mark.parametrize("rounds", [1, 2])
def test_an_update_equals_the_vote_of_all_views(wall: Wall, rounds: int) -> None:
    """Views added, removed and changed: bytes as of sums and codes made from nothing."""
    field, sums = built(wall, replace(SETTINGS, rounds=rounds))
    coded = RegionCodes.load(sums)
    assert coded is not None
    changed = Regions.from_maps(
        {
            **{
                name: {level: wall.regions.load(name, level) for level in LEVELS}
                for name in wall.regions.view_names
            },
            "early_3.png": {level: wall.regions.load("early_5.png", level) for level in LEVELS},
        }
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ScoupWarning)
        after = update(
            field, sums, [wall.late[0], wall.early[3]], changed, remove=["early_1.png"], new_atoms=0
        )
    views = [camera for camera in [*wall.early, wall.late[0]] if camera.name != "early_1.png"]
    whole = region_sums(wall.gaussians, Cameras(views), changed.select(camera.name for camera in views))
    codes = []
    for s, level in enumerate(LEVELS):
        parts = []
        for camera in views:
            rows = changed.load_embeddings(camera.name, level)
            known = coded.codes[s].rows(coded.rows[s].get(camera.name, slice(0, 0)))
            new = camera.name in ("late_0.png", "early_3.png")
            parts.append(encode(normalise_embeddings(rows), field.codebook[s], 2) if new else known)
        of_level = parts[0]
        for part in parts[1:]:
            of_level = concatenate_codes(of_level, part)
        codes.append(of_level)
    rows = [changed.select(camera.name for camera in views).embeddings(level)[1] for level in LEVELS]
    expected = vote(whole.select(rows[0], rows), codes, field.codebook, rounds, SETTINGS.keep)
    assert after.code_indices.equal(expected.indices)
    assert after.code_weights.equal(expected.weights.half())
    assert after.info.provenance["views"] == [camera.name for camera in views]
    assert after.cameras is not None
    assert list(after.cameras.names) == [camera.name for camera in views]


def test_a_view_that_is_given_again_as_it_was_changes_nothing(wall: Wall) -> None:
    field, sums = built(wall)
    before = RegionCodes.load(sums)
    again = update(field, sums, wall.early[2:3], wall.regions)
    after = RegionCodes.load(sums)
    assert before is not None
    assert after is not None
    for s, rows in enumerate(before.rows):
        old = before.codes[s].rows(rows["early_2.png"])
        new = after.codes[s].rows(after.rows[s]["early_2.png"])
        torch.testing.assert_close(new.to_dense(), old.to_dense(), atol=1e-5, rtol=0)
    assert float((again.code_weights - field.code_weights).abs().max()) < 2e-3


def test_what_is_explained_now_brings_no_more_atoms(wall: Wall) -> None:
    for new_atoms in (0, 4):
        field, sums = built(wall)
        grown = grow(wall, (field, sums))
        further = grow(wall, (grown, sums), 1, new_atoms)
        assert further.codebook.equal(grown.codebook)
        first, second = further.info.provenance["updates"]
        assert "new_atoms" in first
        assert second == {"added": ["late_1.png"], "removed": []}


@pytest.mark.parametrize("weight_bits", [16, 8])
def test_a_grown_field_lasts_and_goes_on_growing(wall: Wall, tmp_path, weight_bits) -> None:
    sums = RegionSums.empty(wall.gaussians, LEVELS, path=tmp_path / "f.sums")
    field = build(wall.gaussians, wall.early, wall.regions, settings=SETTINGS, sums=sums)
    grown = grow(wall, (field, sums))
    path = tmp_path / "grown.scoup"
    grown.save(path, embed_geometry=True, weight_bits=weight_bits)
    back = LanguageField.load(path)
    assert back.info == grown.info
    assert torch.equal(back.code_indices, grown.code_indices)
    assert torch.equal(back.codebook, grown.codebook)
    assert answer(wall, back)[0]
    further = grow(wall, (back, RegionSums.open(tmp_path / "f.sums", writable=True)), 1)
    both, sums = built(wall)
    assert_same(further, grow(wall, (grow(wall, (both, sums)), sums), 1))


def test_places_without_an_atom_do_no_harm(wall: Wall, grown: LanguageField) -> None:
    camera = wall.late[1]
    relevancy = grown.relevancy(camera, wall.things, wall.canonical)
    if native_core() is not None:
        reference = grown.at(camera, backend="reference").relevancy(wall.things, wall.canonical)
        torch.testing.assert_close(relevancy, reference, atol=1e-4, rtol=0)
    assert torch.isfinite(relevancy).all()
    assert torch.isfinite(grown.gaussian_relevancy(wall.things, wall.canonical)).all()
    codes = grown.render_codes(camera)
    assert codes.shape[-1] == grown.n_atoms
    assert not codes[1, ..., 6:].any()
    for level, name in enumerate(LEVELS):
        assert torch.isfinite(grown.render_features(camera, name)).all()
        assert code_picture(codes[level]).shape == (camera.height, camera.width, 3)
    # Codes under such a codebook never name an empty place.
    rows = unit(torch.randn(200, DIM))
    coded = encode(rows, grown.codebook[1], 4)
    assert int(coded.indices[coded.weights > 0].long().max()) < 6
    torch.testing.assert_close(coded.weights, encode(rows, grown.codebook[1, :6], 4).weights)


def scene_with_a_crowded_view() -> tuple[Gaussians, Cameras, Regions]:
    """``small_scene``, whose last view has twelve regions a level."""
    gaussians, cameras, regions = small_scene()
    generator = torch.Generator().manual_seed(9)
    labels = random_labels(3, 30, 40, 12, 9)
    crowded = {
        level: RegionMap(labels[s], unit(torch.randn(12, 16, generator=generator)))
        for s, level in enumerate(regions.levels)
    }
    maps = {
        name: {level: regions.load(name, level) for level in regions.levels} for name in cameras.names[:3]
    }
    return gaussians, cameras, Regions.from_maps({**maps, cameras.names[3]: crowded})


@pytest.mark.parametrize("keep", [3, 0])
def test_past_256_atoms(tmp_path, keep: int) -> None:
    gaussians, cameras, regions = scene_with_a_crowded_view()
    wide = BuildSettings(n_atoms=250, k=3, keep=keep, solver="exact")
    sums = RegionSums.empty(gaussians, regions.levels)
    field = build(gaussians, cameras[:3], regions, settings=wide, sums=sums)
    assert field.code_indices.dtype == torch.uint8
    grown = update(field, sums, cameras[3:], regions, new_atoms=10)
    assert grown.n_atoms == 260
    assert grown.code_indices.dtype == torch.uint16
    assert grown.code_indices.shape[2] == (260 if keep == 0 else 3)
    assert int(grown.code_indices.long()[grown.code_weights > 0].max()) >= 256
    grown.save(tmp_path / "f.scoup", weight_bits=8)
    back = LanguageField.load(tmp_path / "f.scoup", gaussians)
    assert back.code_indices.dtype == torch.uint16
    assert torch.equal(back.code_indices, grown.code_indices)
    queries = unit(torch.randn(2, 16))
    expected = grown.relevancy(cameras[3], queries, queries)
    assert torch.allclose(back.relevancy(cameras[3], queries, queries), expected, atol=0.05)


def test_refusals(wall: Wall, kept: Kept) -> None:
    field, sums = kept
    late = wall.late[:1]
    with pytest.raises(InputError, match="negative"):
        update(field, sums, late, wall.regions, new_atoms=-1)
    with pytest.raises(InputError, match="1 to 65536 atoms, got 65537"):
        update(field, sums, late, wall.regions, new_atoms=65531)
    with pytest.raises(InputError, match="levels"):
        update(field, sums, late, Regions(("s",), wall.regions.view_names, wall.regions.load))
    blank = torch.full((24, 40), -1, dtype=torch.int32)
    other = {level: RegionMap(blank, torch.zeros(1, 9)) for level in LEVELS}
    with pytest.raises(InputError, match="9 dimensions, the field 32"):
        update(field, sums, late, Regions.from_maps({"late_0.png": other}))
    broken = Regions(LEVELS, ["late_0.png"], wall.regions.load, lambda *_: torch.full((3, DIM), float("nan")))
    with pytest.raises(InputError, match="not finite"):
        update(field, sums, late, broken, new_atoms=2)
    with pytest.raises(InputError, match="have no regions; pass regions="):
        update(field, sums, late)
    with pytest.raises(InputError, match=r"'late_0\.png' is not in the field"):
        update(field, sums, remove=["late_0.png"])
    with pytest.raises(InputError, match="no view would be left"):
        update(field, sums, remove=wall.early.names)
    with pytest.raises(InputError, match="another scene"):
        update(field, RegionSums.empty(small_scene()[0], LEVELS), remove=["early_0.png"])
    with pytest.raises(InputError, match="build it with kept `sums`"):
        update(field, RegionSums.empty(wall.gaussians, LEVELS), remove=["early_0.png"])
    assert list(sums.views) == list(wall.early.names)  # nothing was changed


def test_views_without_regions_are_refused_before_any_is_rendered(
    wall: Wall, kept: Kept, monkeypatch: pytest.MonkeyPatch
) -> None:
    def too_early(*_: object, **__: object) -> None:
        raise AssertionError("views were rendered before the arguments were checked")

    monkeypatch.setattr("scoup.uplift.fit.measure_fit", too_early)
    with pytest.raises(InputError, match="have no regions; pass regions="):
        update(*kept, wall.late[:1])


def test_a_field_that_does_not_record_what_to_expect(wall: Wall, kept: Kept) -> None:
    """Without coding reports no region counts as badly explained, and no atoms are added on a guess."""
    field, sums = kept
    field.info = replace(field.info, provenance={**field.info.provenance, "coding": {}})
    with pytest.raises(InputError, match="does not record how well"):
        grow(wall, kept, new_atoms=2)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert grow(wall, (field, sums), new_atoms=0).n_atoms == 6


def test_codes_of_other_lengths_are_joined() -> None:
    short, long = (SparseCodes.from_dense(torch.eye(300)[:2, :n], k) for n, k in ((4, 1), (300, 3)))
    both = concatenate_codes(short, long)
    assert (len(both), both.k, both.n_atoms) == (4, 3, 300)
    assert both.to_dense()[:2, :4].equal(short.to_dense())
    assert both.to_dense()[2:].equal(long.to_dense())


@pytest.mark.filterwarnings("ignore:.*badly explained")
@pytest.mark.parametrize("in_file", [False, True])
def test_a_window_of_views_takes_no_more_room_and_votes_as_its_views_alone(
    wall: Wall, tmp_path, monkeypatch, in_file
):
    """Frames come and go: what they leave is given back, and changes no code."""
    sums = RegionSums.empty(wall.gaussians, LEVELS, path=tmp_path / "a.sums" if in_file else None)
    field = build(wall.gaussians, wall.early[:3], wall.regions, settings=SETTINGS, sums=sums)
    sizes, plain = [], RegionSums.empty(wall.gaussians, LEVELS)
    other = build(wall.gaussians, wall.early[:3], wall.regions, settings=SETTINGS, sums=plain)
    for number in range(24):
        camera, oldest = wall.early[(3 + number) % 8], next(iter(sums.views))
        field = update(field, sums, [camera], wall.regions, [oldest])
        sizes.append(sums.bytes)
        coded = RegionCodes.load(sums)
        assert coded is not None
        assert all(len(level) <= 2 * sum(part.stop - part.start for part in places.values())
                   for level, places in zip(coded.codes, coded.rows, strict=True))  # fmt: skip
    assert max(sizes[12:]) <= max(sizes[:12])
    monkeypatch.setattr(RegionCodes, "compact", lambda self: self)
    for number in range(24):
        other = update(other, plain, [wall.early[(3 + number) % 8]], wall.regions, [next(iter(plain.views))])
    assert field.code_indices.equal(other.code_indices)
    assert field.code_weights.equal(other.code_weights)
    assert plain.bytes > sums.bytes


def test_codes_of_many_atoms_are_compacted(kept: Kept) -> None:
    coded = RegionCodes.load(kept[1])
    assert coded is not None
    books = torch.nn.functional.pad(coded.codebook, (0, 0, 0, 300))
    more = [SparseCodes(level.indices.to(torch.uint16), level.weights, 306) for level in coded.codes]
    wide = RegionCodes(books, more, coded.rows, coded.reports)
    first, *others = coded.rows[0]
    for name in others:
        wide = wide.without_view(name)
    found = wide.compact()
    for old, new, level in zip(wide.rows, found.rows, range(len(more)), strict=True):
        assert new[first].start == 0
        assert len(found.codes[level]) == new[first].stop
        assert found.codes[level].indices.equal(more[level].indices[old[first]])
        assert found.codes[level].weights.equal(more[level].weights[old[first]])


def test_a_field_records_its_newest_updates(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("scoup.uplift.update.MOST_UPDATES", 2)
    provenance: dict[str, Any] = {}
    for number in range(5):
        provenance |= append_update(provenance, {"added": [str(number)]})
        assert provenance.get("earlier_updates", 0) == max(0, number - 1)
    assert provenance["updates"] == [{"added": ["3"]}, {"added": ["4"]}]
