"""Fields that follow their splat through an edit, against region sums made from the start."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from scoup.base.errors import InputError, ScoupWarning
from scoup.field.language_field import LanguageField
from scoup.scene.cameras import Cameras
from scoup.scene.codes import index_dtype
from scoup.scene.gaussians import Gaussians
from scoup.scene.regions import Regions
from scoup.scene.things import ThingTable
from scoup.uplift.build import build, thing_table
from scoup.uplift.build_settings import BuildSettings
from scoup.uplift.edited_splat import Followed, KeptSums, follow
from scoup.uplift.matching import Tolerance
from scoup.uplift.rasterise import region_sums
from scoup.uplift.region_codes import RegionCodes
from scoup.uplift.region_sums import RegionSums
from scoup.uplift.update import update, vote_again
from support import KINDS, examples, random_gaussians, small_scene
from uplift.edits import joined

QUICK = BuildSettings(n_atoms=6, k=3, keep=3)


class Scene:
    """A field with its sums, from views all around that see different parts."""

    def __init__(self, gaussians: Gaussians, views: int = 5, **how) -> None:
        _, cameras, self.regions = small_scene(1, views)
        self.cameras = Cameras(self._apart(camera, i) for i, camera in enumerate(cameras))
        self.gaussians = gaussians
        self.sums = RegionSums.empty(gaussians, self.regions.levels, **how)
        self.field = build(gaussians, self.cameras, self.regions, QUICK, sums=self.sums, check_fit=False)

    @staticmethod
    def _apart(camera, number):
        """Each a little further along x and zoomed in, so that an edit is in some views and not in others."""
        viewmat = camera.viewmat.clone()
        viewmat[0, 3] += 0.7 * (number - 2)
        K = camera.K.clone()
        K[:2, :2] *= 3
        return replace(camera, viewmat=viewmat, K=K)

    @property
    def kept(self) -> KeptSums:
        return KeptSums(self.sums, self.cameras, self.regions)

    def from_the_start(self, edited: Gaussians) -> tuple[LanguageField, RegionSums]:
        """Sums of the edited splat, and what they vote with the same codes."""
        how = {"weights": self.sums.weights, "least_weight": self.sums.least_weight}
        sums = region_sums(edited, self.cameras, self.regions, **how)
        coded = RegionCodes.load(self.sums)
        assert coded is not None
        found = vote_again(self.field, sums, coded)
        info = replace(self.field.info, n_gaussians=len(edited), fingerprint=edited.fingerprint())
        return LanguageField(found.indices, found.weights, self.field.codebook, info), sums


def assert_same_codes(one: LanguageField, other: LanguageField) -> None:
    assert one.code_indices.equal(other.code_indices)
    assert one.code_weights.equal(other.code_weights)


def assert_same_things(one: ThingTable | None, other: ThingTable | None) -> None:
    assert one is not None
    assert other is not None
    for name, tensor in vars(one).items():
        assert tensor.equal(getattr(other, name)), name


def assert_same_sums(one: RegionSums, other: RegionSums) -> None:
    assert (one.fingerprint, set(one.views)) == (other.fingerprint, set(other.views))
    assert one.order.equal(other.order)
    for name, view in one.views.items():
        assert (view.labels_digest, view.camera_digest) == (
            other.views[name].labels_digest,
            other.views[name].camera_digest,
        )
        for mine, theirs in zip(view.parts, other.views[name].parts, strict=True):
            for field, array in mine.arrays().items():
                np.testing.assert_array_equal(array, theirs.arrays()[field])


def check_followed(scene: Scene, edited: Gaussians) -> Followed:
    """Codes and sums are those of a vote on the edited splat from the start."""
    found = follow(scene.field, edited, scene.kept)
    field, sums = scene.from_the_start(edited)
    assert found.sums is not None
    assert_same_sums(found.sums, sums)
    assert_same_codes(found.field, field)
    return found


@pytest.fixture(scope="module")
def scene() -> Scene:
    """Half of it is small and faint, so that a few can be deleted unseen by most views."""
    part = random_gaussians(400, 3, KINDS)
    return Scene(Gaussians(part.means, part.quats, part.scales * 0.3, part.opacities, part.sh))


@st.composite
def edits(draw: st.DrawFn) -> tuple[list[int], Gaussians, bool]:
    """Rows of the scene to keep (some twice), Gaussians to append, and whether the order is shuffled."""
    count = 400
    gone = draw(st.sampled_from([0, 1, 3, 40, 399]))
    generator = torch.Generator().manual_seed(draw(st.integers(0, 2**31)))
    rows = torch.randperm(count, generator=generator)[gone:].sort().values
    twice = rows[torch.randint(len(rows), (draw(st.sampled_from([0, 0, 1, 5])),), generator=generator)]
    appended = random_gaussians(draw(st.sampled_from([0, 0, 1, 4])), draw(st.integers(0, 2**31)), KINDS)
    return [*rows.tolist(), *twice.tolist()], appended, draw(st.sampled_from([False, False, True]))


@settings(max_examples=examples(60))
@given(edits(), st.integers(0, 2**31))
def test_codes_and_sums_are_those_of_a_vote_from_the_start(scene, edit, seed):
    rows, appended, shuffled = edit
    edited = joined(scene.gaussians.select(torch.tensor(rows)), appended)
    if shuffled:
        edited = edited.select(torch.randperm(len(edited), generator=torch.Generator().manual_seed(seed)))
    found = check_followed(scene, edited)
    assert found.sums is not None
    assert found.field.fingerprint == edited.fingerprint()
    coded = RegionCodes.load(scene.sums)
    assert coded is not None
    assert_same_things(found.field.thing_table, thing_table(found.sums, coded))


@given(edits(), st.integers(0, 2**31))
def test_without_sums_the_matched_keep_their_codes_bit_by_bit(scene, edit, seed):
    rows, appended, _ = edit
    edited = joined(scene.gaussians.select(torch.tensor(rows)), appended)
    order = torch.randperm(len(edited), generator=torch.Generator().manual_seed(seed))
    found = follow(scene.field, edited.select(order))
    before = found.matching.before
    there = before >= 0
    assert found.field.code_indices[there].equal(scene.field.code_indices[before[there]])
    assert found.field.code_weights[there].equal(scene.field.code_weights[before[there]])
    assert not found.field.code_weights[~there].any()
    assert (found.sums, found.rasterised) == (None, ())
    record = found.field.info.provenance["updates"][-1]["edited"]
    assert record == {"from": scene.field.fingerprint, **found.matching.counts()}


def test_nothing_changed_changes_nothing(scene):
    found = follow(scene.field, scene.gaussians.select(slice(None)), scene.kept)
    assert found.rasterised == ()
    assert_same_codes(found.field, scene.field)
    assert found.sums is not None
    assert_same_sums(found.sums, scene.sums)


def test_only_views_that_show_the_edit_are_rasterised(scene):
    """One Gaussian in sight of some views; one behind all cameras is in no view."""
    entries = [set(scene.sums.triplets(name, 0)[0].tolist()) for name in scene.sums.views]
    seen_once = min(entries[0] - set().union(*entries[1:]))
    rest = torch.arange(400) != seen_once
    found = follow(scene.field, scene.gaussians.select(rest), scene.kept)
    assert "view_00.png" in found.rasterised
    assert len(found.rasterised) < len(scene.cameras)
    behind = random_gaussians(3, 0)
    behind = replace(behind, means=behind.means * torch.tensor([1.0, 1.0, -1.0]))
    found = follow(scene.field, joined(behind, scene.gaussians), scene.kept)
    assert found.rasterised == ()
    assert found.matching.counts() == {"matched": 400, "rounded": 0, "appended": 3, "deleted": 0}
    assert_same_codes(found.field[3:], scene.field)


def test_equal_depths_are_painted_in_the_new_order():
    """On a wall of large Gaussians at one depth, who comes first in the file hides the others."""
    part = random_gaussians(60, 0)
    means = part.means * torch.tensor([1.0, 1.0, 0.0]) + torch.tensor([0.0, 0.0, 4.0])
    wall = Gaussians(means, part.quats, torch.full((60, 3), 0.5), torch.full((60,), 0.9), part.sh)
    scene = Scene(wall)
    edited = wall.select(torch.tensor([*range(1, 60), 0]))
    assert check_followed(scene, edited).rasterised


@pytest.mark.parametrize("how", [{"weights": "float16"}, {"least_weight": 0.05}])
def test_smaller_sums_stay_as_small(how):
    part = random_gaussians(300, 5)
    scene = Scene(replace(part, scales=part.scales * 0.3), **how)
    edited = scene.gaussians.select(torch.arange(300) % 29 > 0)
    check_followed(scene, edited)


def test_views_of_very_many_combinations(scene, monkeypatch):
    """Kept in several parts, which are brought together and apart again."""
    monkeypatch.setattr("scoup.uplift.storage.entries.MOST_COMBINATIONS", 7)
    monkeypatch.setattr("scoup.uplift.edited_splat.MOST_COMBINATIONS", 7)
    parted = Scene(scene.gaussians)
    assert all(len(view.parts) > 1 for view in parted.sums.views.values())
    edited = scene.gaussians.select(torch.arange(400) != 5)
    check_followed(parted, edited)


def test_rounded_gaussians_keep_their_codes_and_are_rasterised_again(scene):
    finite = scene.gaussians.finite()
    edited = replace(scene.gaussians, means=scene.gaussians.means + 1e-5)
    with pytest.raises(InputError, match=r"shares no Gaussian.*with `tolerance`"):
        follow(scene.field, edited.select(finite))
    found = follow(scene.field, edited.select(finite), tolerance=Tolerance(1e-3))
    assert found.matching.n_rounded == int(finite.sum())
    assert_same_codes(found.field, scene.field[finite])
    voted = follow(scene.field, edited, scene.kept, Tolerance(1e-3))
    assert_same_codes(voted.field, scene.from_the_start(edited)[0])


def test_formats_that_round_some_numbers_only_are_named(scene):
    means = scene.gaussians.means.clone()
    means[::3] += 1e-5
    edited = replace(scene.gaussians, means=means)
    with pytest.warns(ScoupWarning, match=r"Gaussians of the field are not in it.*pass `tolerance`"):
        follow(scene.field, edited)
    follow(scene.field, edited, tolerance=Tolerance(1e-3))  # without a warning


def test_the_sums_that_follow_can_be_updated_and_followed_again(scene, tmp_path):
    edited = scene.gaussians.select(torch.arange(400) % 7 > 0)
    once = follow(scene.field, edited, replace(scene.kept, path=tmp_path / "once.sums"))
    assert once.sums is not None
    sums = RegionSums.open(tmp_path / "once.sums", writable=True)
    fewer = update(once.field, sums, remove=["view_02.png"])
    further = edited.select(torch.arange(len(edited)) % 5 > 0)
    twice = follow(fewer, further, KeptSums(sums, scene.cameras, scene.regions))
    assert twice.sums is not None
    assert "view_02.png" not in twice.sums
    there = Cameras(camera for camera in scene.cameras if camera.name != "view_02.png")
    assert_same_sums(twice.sums, region_sums(further, there, scene.regions))
    assert [list(entry) for entry in twice.field.info.provenance["updates"]] == [
        ["edited"],
        ["added", "removed"],
        ["edited"],
    ]


def test_codes_of_many_atoms_are_carried():
    scene = Scene(random_gaussians(30, 0))
    field = scene.field
    codebook = torch.nn.functional.pad(field.codebook, (0, 0, 0, 300))
    wide = LanguageField(
        field.code_indices.to(index_dtype(306)), field.code_weights, codebook, field.info, scene.gaussians
    )
    found = follow(wide, joined(random_gaussians(2, 9), scene.gaussians))
    assert found.field.code_indices.dtype == torch.uint16
    assert found.field.code_indices[2:].equal(wide.code_indices)


def test_what_cannot_be_followed_is_refused(scene, tmp_path):
    edited = scene.gaussians.select(torch.arange(400) > 40)
    for other in (random_gaussians(20, 77), scene.gaussians.select(torch.zeros(0, dtype=torch.int64))):
        with pytest.raises(InputError, match="shares no Gaussian with the field"):
            follow(scene.field, other, scene.kept)
    with pytest.raises(InputError, match="has no camera among"):
        follow(scene.field, edited, replace(scene.kept, cameras=scene.cameras[:2]))
    with pytest.raises(InputError, match="no region maps any more"):
        follow(scene.field, edited, replace(scene.kept, regions=Regions.from_maps({})))
    moved = Cameras(replace(camera, width=44) for camera in scene.cameras)
    with pytest.raises(InputError, match="its camera has changed"):
        follow(scene.field, edited, replace(scene.kept, cameras=moved))
    _, _, others = small_scene(1, 5, seed=8)
    with pytest.raises(InputError, match="its region maps have changed"):
        follow(scene.field, edited, replace(scene.kept, regions=others))
    strange = RegionSums.empty(edited, scene.sums.levels)
    with pytest.raises(InputError, match="another scene"):
        follow(scene.field, edited, replace(scene.kept, sums=strange))
