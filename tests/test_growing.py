"""Views added to a field later, with atoms for what its codebook has never seen."""

from __future__ import annotations

import warnings
from dataclasses import replace

import pytest
import torch
from torch import Tensor

import scoup
from scoup import raster
from scoup.artefact import accumulators_path
from scoup.cameras import Camera, Cameras
from scoup.coding.encode import encode
from scoup.errors import InputError, ScoupWarning
from scoup.field import LanguageField
from scoup.gaussians import Gaussians
from scoup.growing import append_atoms, bars_of, code_view, provenance_with, widened
from scoup.native import native_core
from scoup.pictures.colors import code_picture
from scoup.pipeline import BuildSettings, build
from scoup.regions import RegionMap, Regions
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


@pytest.fixture(scope="module")
def field(wall: Wall) -> LanguageField:
    return build(wall.gaussians, wall.early, wall.regions, settings=SETTINGS, keep_accumulators=True)


@pytest.fixture(scope="module")
def grown(wall: Wall, field: LanguageField) -> LanguageField:
    return field.update(wall.late[0], wall.regions, new_atoms=4)


def answer(wall: Wall, field: LanguageField) -> tuple[bool, float]:
    """Whether the new thing is found in a late view, and the mean relevancy on it minus that beside it."""
    camera = wall.late[1]
    relevancy = field.relevancy(camera, wall.things[[NEW]], wall.canonical)[:, 0]
    on = wall.shows(camera) == NEW
    x, _ = scoup.localize(relevancy).pixel
    return bool(on[x]), float(relevancy[0][:, on].mean() - relevancy[0][:, ~on].mean())


def test_a_thing_seen_only_later_is_found_with_new_atoms(
    wall: Wall, field: LanguageField, grown: LanguageField
) -> None:
    with pytest.warns(
        ScoupWarning, match=r"% of the regions of 'late_0.png' are badly explained .*new_atoms"
    ):
        without = field.update(wall.late[0], wall.regions)
    assert without.n_atoms == 6
    assert "added_atoms" not in without.info.provenance
    found, contrast = answer(wall, grown)
    _, contrast_without = answer(wall, without)
    print(f"contrast with new atoms {contrast:.3f}, without {contrast_without:.3f}")
    assert found
    assert contrast > 0.3
    assert contrast > contrast_without + 0.2
    # The Gaussians themselves: those of the new thing are selected, and hardly any other.
    chosen = scoup.select(grown, wall.things[NEW], wall.canonical)
    on_it = wall.gaussians.means[:, 0] > EDGES[NEW]
    assert float(on_it[chosen].float().mean()) > 0.9
    assert int(chosen.sum()) > 100


def test_what_grows_and_what_stays(wall: Wall, field: LanguageField, grown: LanguageField) -> None:
    new = grown.info.provenance["added_atoms"]["late_0.png"]
    assert 1 <= new["s"] <= 4
    assert new["m"] == 0
    count = 6 + new["s"]
    assert grown.codebook.shape == (2, count, DIM)
    assert grown.codebook[:, :6].equal(field.codebook)
    torch.testing.assert_close(torch.linalg.vector_norm(grown.codebook[0, 6:], dim=1), torch.ones(new["s"]))
    assert not grown.codebook[1, 6:].any()
    assert grown.accumulators is not None
    assert field.accumulators is not None
    assert grown.accumulators.shape == (len(field), 2, count)
    assert field.accumulators.shape == (len(field), 2, 6)
    assert not grown.accumulators[:, 1, 6:].any()
    # Gaussians that the view does not see keep their codes; the sums of the others only gain.
    unseen = wall.gaussians.means[:, 0] < 0
    assert grown.code_indices[unseen].equal(field.code_indices[unseen])
    assert grown.code_weights[unseen].equal(field.code_weights[unseen])
    assert bool((grown.accumulators[..., :6] >= field.accumulators).all())
    assert grown.info.provenance["added_views"] == ["late_0.png"]
    assert grown.info.provenance["coding"] == field.info.provenance["coding"]
    assert grown.cameras is not None
    assert grown.cameras.names[-1] == "late_0.png"
    again = field.update(wall.late[0], wall.regions, new_atoms=4)
    assert again.codebook.equal(grown.codebook)
    assert again.code_weights.equal(grown.code_weights)


def test_what_is_explained_now_brings_no_more_atoms(wall: Wall, grown: LanguageField) -> None:
    for new_atoms in (0, 4):
        further = grown.update(wall.late[1], wall.regions, new_atoms)
        assert further.codebook.equal(grown.codebook)
        assert further.info.provenance["added_views"] == ["late_0.png", "late_1.png"]
        assert list(further.info.provenance["added_atoms"]) == ["late_0.png"]


@pytest.mark.parametrize("weight_bits", [16, 8])
def test_a_grown_field_lasts_and_goes_on_growing(
    wall: Wall, grown: LanguageField, tmp_path, weight_bits
) -> None:
    path = tmp_path / "grown.scoup"
    grown.save(path, embed_geometry=True, weight_bits=weight_bits)
    back = LanguageField.load(path)
    assert back.info == grown.info
    for name in ("code_indices", "codebook", "accumulators"):
        assert torch.equal(getattr(back, name), getattr(grown, name))
    assert answer(wall, back)[0]
    further = back.update(wall.late[1], wall.regions, new_atoms=4)
    expected = grown.update(wall.late[1], wall.regions, new_atoms=4)
    assert further.code_indices.equal(expected.code_indices)
    assert further.code_weights.equal(expected.code_weights)
    further.save(path, overwrite=True, weight_bits=weight_bits)
    assert accumulators_path(path).exists()
    assert torch.equal(LanguageField.load(path).accumulators, further.accumulators)  # type: ignore[arg-type]


def test_places_without_an_atom_do_no_harm(wall: Wall, grown: LanguageField) -> None:
    camera = wall.late[1]
    relevancy = grown.relevancy(camera, wall.things, wall.canonical)
    if native_core() is not None:
        reference = grown.relevancy(
            camera, wall.things, wall.canonical, raster.look(grown.gaussians, camera, backend="reference")
        )
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
    field = build(gaussians, cameras[:3], regions, settings=wide, keep_accumulators=True)
    assert field.code_indices.dtype == torch.uint8
    grown = field.update(cameras[3], regions, new_atoms=10)
    assert grown.n_atoms == 260
    assert grown.code_indices.dtype == torch.uint16
    assert grown.code_indices.shape[2] == (260 if keep == 0 else 3)
    assert int(grown.code_indices[grown.code_weights > 0].long().max()) >= 256
    grown.save(tmp_path / "f.scoup", weight_bits=8)
    back = LanguageField.load(tmp_path / "f.scoup", gaussians)
    assert back.code_indices.dtype == torch.uint16
    assert torch.equal(back.code_indices, grown.code_indices)
    assert torch.equal(back.accumulators, grown.accumulators)  # type: ignore[arg-type]
    queries = unit(torch.randn(2, 16))
    expected = grown.relevancy(cameras[3], queries, queries)
    assert torch.allclose(back.relevancy(cameras[3], queries, queries), expected, atol=0.05)


def test_append_atoms_fills_empty_places_first() -> None:
    codebook = torch.arange(1.0, 13).view(2, 2, 3)
    once = append_atoms(codebook, [torch.ones(2, 3), torch.ones(0, 3)])
    assert once.shape == (2, 4, 3)
    assert once[:, :2].equal(codebook)
    assert once[0, 2:].equal(torch.ones(2, 3))
    assert not once[1, 2:].any()
    twice = append_atoms(once, [torch.ones(0, 3), 2 * torch.ones(3, 3)])
    assert twice.shape == (2, 5, 3)
    assert twice[0].equal(torch.cat([once[0], torch.zeros(1, 3)]))
    assert twice[1].equal(torch.cat([codebook[1], 2 * torch.ones(3, 3)]))
    assert append_atoms(once, [torch.ones(0, 3)] * 2).equal(once)
    assert append_atoms(torch.zeros(1, 2, 3), [torch.ones(1, 3)])[0, :, 0].tolist() == [1.0, 0.0]


def test_widened_is_a_copy() -> None:
    sums = torch.rand(3, 2, 4)
    wide = widened(sums, 6)
    assert wide[..., :4].equal(sums)
    assert not wide[..., 4:].any()
    same = widened(sums, 4)
    same += 1
    assert bool((sums < 1).all())


def test_view_coded_level_by_level() -> None:
    codebook = torch.eye(5)[None, :2].repeat(2, 1, 1)
    embeddings = [
        torch.tensor([[3.0, 1, 0, 0, 0], [0, 0, 0, 2, 0], [0, 0, 0, 0, 1], [0, 0, 0, 0, 0]]),
        torch.zeros(0, 5),
    ]
    plain = code_view(codebook, embeddings, 2, [0.5, 0.5])
    assert (plain.n_regions, plain.n_badly_explained, plain.n_new) == (3, 2, [0, 0])
    assert plain.codebook is codebook
    more = code_view(codebook, embeddings, 2, [0.5, 0.5], new_atoms=8)
    assert (more.n_new, more.n_badly_explained) == ([2, 0], 2)
    assert more.codebook.shape == (2, 4, 5)
    decoded = unit(more.codes[0].to_dense() @ more.codebook[0])
    torch.testing.assert_close(decoded, unit(embeddings[0]))
    assert [len(codes) for codes in more.codes] == [4, 0]
    assert code_view(codebook, embeddings, 2, None).n_badly_explained is None


def test_refusals(wall: Wall, field: LanguageField) -> None:
    with pytest.raises(InputError, match="negative"):
        field.update(wall.late[0], wall.regions, new_atoms=-1)
    with pytest.raises(InputError, match="1 to 65536 atoms, not 65537"):
        field.update(wall.late[0], wall.regions, new_atoms=65531)
    with pytest.raises(InputError, match="levels"):
        field.update(wall.late[0], Regions(("s",), wall.regions.view_names, wall.regions.load))
    blank = torch.full((24, 40), -1, dtype=torch.int32)
    other = {level: RegionMap(blank, torch.zeros(1, 9)) for level in LEVELS}
    with pytest.raises(InputError, match="9 dimensions, the field 32"):
        field.update(wall.late[0], Regions.from_maps({"late_0.png": other}))
    broken = Regions(LEVELS, ["late_0.png"], wall.regions.load, lambda *_: torch.full((3, DIM), float("nan")))
    with pytest.raises(InputError, match="not finite"):
        field.update(wall.late[0], broken, new_atoms=2)


def test_a_field_that_does_not_tell_what_to_expect(wall: Wall, field: LanguageField) -> None:
    """Without coding reports nothing is called badly explained, and no atoms are added on a guess."""
    assert bars_of({}, LEVELS) is None
    assert bars_of({"coding": {"s": {}, "m": 3}}, LEVELS) is None
    provenance = {**field.info.provenance, "coding": {}}
    silent = LanguageField(
        field.code_indices,
        field.code_weights,
        field.codebook,
        replace(field.info, provenance=provenance),
        wall.gaussians,
        accumulators=field.accumulators,
    )
    with pytest.raises(InputError, match="build it again"):
        silent.update(wall.late[0], wall.regions, new_atoms=2)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert silent.update(wall.late[0], wall.regions).n_atoms == 6


def test_provenance_of_several_views() -> None:
    first = provenance_with({"views": ["a"]}, "b", LEVELS, [3, 0])
    second = provenance_with(first, "c", LEVELS, [0, 0])
    assert first == {"views": ["a"], "added_views": ["b"], "added_atoms": {"b": {"s": 3, "m": 0}}}
    assert second == {**first, "added_views": ["b", "c"]}
    third = provenance_with(second, "d", LEVELS, [0, 2])
    assert third["added_atoms"] == {"b": {"s": 3, "m": 0}, "d": {"s": 0, "m": 2}}
