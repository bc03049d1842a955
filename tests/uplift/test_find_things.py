"""Things against a literal clustering, and the same things from all ways to the same views."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.sparse import csr_array

from planted_wall import COUNT, LEVELS, SETTINGS, Wall, planted_wall
from scoup.base import spread
from scoup.field import NO_THING, Field, ThingTable
from scoup.scene import Cameras, RegionMap
from scoup.uplift.constants import LEAST_IOU, LEAST_REGIONS
from scoup.uplift.field_build import build
from scoup.uplift.merging import ROOT_STEPS, merge_regions
from scoup.uplift.rasterise import region_sums
from scoup.uplift.settings import BUILD_PRESETS
from scoup.uplift.things import mean_embeddings
from support import changed_regions, examples

DECIDED = ("owners", "levels", "parents", "n_regions")


@pytest.fixture(scope="module")
def wall() -> Wall:
    return planted_wall()


@pytest.fixture(scope="module")
def things(wall: Wall) -> ThingTable:
    return of_field(built(wall))


def built(wall: Wall, views: Sequence[str] | None = None) -> Field:
    cameras = Cameras(camera for camera in wall.cameras if views is None or camera.name in views)
    return build(wall.gaussians, cameras, wall.regions, SETTINGS)


def of_field(field: Field) -> ThingTable:
    assert field.thing_table is not None
    return field.thing_table


def assert_same(one: ThingTable | None, other: ThingTable | None, names: Sequence[str] = ()) -> None:
    assert one is not None
    assert other is not None
    for name in names or vars(one):
        assert getattr(one, name).equal(getattr(other, name)), name


# Regions merged.


def roots(contributions: NDArray[np.floating]) -> NDArray[np.float64]:
    return np.rint(ROOT_STEPS * np.sqrt(contributions.astype(np.float64)))


def roots_of_views(matrix: NDArray[np.float32], views: NDArray[np.int64]) -> NDArray[np.float64]:
    """[N, R] of what each Gaussian contributes to all regions of the view of a region."""
    return roots(matrix.astype(np.float64) @ (views[:, None] == views).astype(np.float64))


def literal_clusters(
    matrix: NDArray[np.float32], views: NDArray[np.int64], least_iou: float = LEAST_IOU
) -> list[int]:
    """Average linkage, best pair first, by comparing all pairs of clusters again and again. Pairs of regions of one
    view overlap by nothing.
    """
    count = len(views)
    root, seen = roots(matrix), roots_of_views(matrix, views)
    overlap, union = np.zeros((count, count)), np.zeros((count, count))
    for one, other in itertools.product(range(count), repeat=2):
        overlap[one, other] = (
            0.0 if views[one] == views[other] else float((root[:, one] * root[:, other]).sum())
        )
        union[one, other] = (
            root[:, one] @ seen[:, other] + root[:, other] @ seen[:, one] - overlap[one, other]
        )
    members = {region: [region] for region in range(count)}
    while True:
        found = []
        for one, other in itertools.combinations(sorted(members), 2):
            places = np.ix_(members[one], members[other])
            iou = overlap[places].sum() / max(1.0, union[places].sum())
            if iou > least_iou:
                found.append((-iou, one, other))
        if not found:
            break
        _, one, other = min(found)
        members[one] += members.pop(other)
    labels = np.zeros(count, int)
    for number, first in enumerate(sorted(members)):
        labels[members[first]] = number
    return labels.tolist()


@dataclass(frozen=True, eq=False)
class Seen:
    """What Gaussians contribute [N, R] to regions of views [R]."""

    matrix: NDArray[np.float32]
    views: NDArray[np.int64]


@st.composite
def seen(draw: st.DrawFn) -> Seen:
    """Objects seen from several views, whose regions bleed, split and join them; some have nothing."""
    generator = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n_gaussians, n_objects = draw(st.integers(0, 14)), draw(st.integers(1, 4))
    thing = generator.integers(n_objects, size=n_gaussians)
    sizes = draw(st.lists(st.integers(0, 4), min_size=1, max_size=5))  # regions of each view; some have none
    bleeds = draw(st.sampled_from([0.0, 0.1, 0.9]))
    alike = draw(st.sampled_from([False, False, False, True]))
    columns, views = [], []
    for view, size in enumerate(sizes):
        region_of = generator.integers(max(1, size), size=n_objects)
        weight = np.ones(n_gaussians) if alike else generator.gamma(1.0, 5.0, size=n_gaussians)
        weight *= generator.random(n_gaussians) >= draw(st.sampled_from([0.0, 0.0, 0.5]))
        for region in range(size):
            inside = region_of[thing] == region
            columns.append(
                weight * np.where(inside, 1.0 - bleeds / 2, bleeds * generator.random(n_gaussians))
            )
            views.append(view)
    if draw(st.booleans()):
        columns = [column * (generator.random() > 0.2) for column in columns]
    matrix = np.array(columns, np.float32).reshape(len(columns), n_gaussians).T
    return Seen(matrix, np.array(views, np.int64))


def same(n_gaussians: int, views: Sequence[int]) -> Seen:
    return Seen(np.ones((n_gaussians, len(views)), np.float32), np.array(views, np.int64))


@settings(max_examples=examples(200), deadline=None)
@given(seen(), st.sampled_from([LEAST_IOU, 0.1, 0.6]))
@example(same(3, [0]), LEAST_IOU)
@example(same(3, []), LEAST_IOU)
@example(same(0, [0, 1, 1]), LEAST_IOU)
@example(same(4, [0, 1, 2, 3]), LEAST_IOU)
@example(same(4, [0, 0, 0]), LEAST_IOU)
@example(same(4, [0, 0, 3, 3, 7]), 0.1)
def test_regions_merge_as_in_the_literal_clustering(each: Seen, least_iou: float) -> None:
    found = merge_regions(csr_array(each.matrix), each.views, least_iou)[0].tolist()
    assert found == literal_clusters(each.matrix, each.views, least_iou)


@settings(max_examples=examples(60), deadline=None)
@given(st.integers(0, 2**31), st.integers(1, 12), st.integers(1, 4), st.sampled_from([0.1, LEAST_IOU, 0.6]))
def test_stability_is_the_ratio_over_regions_and_other_views(
    seed: int, count: int, n_views: int, least_iou: float
) -> None:
    """Of what its regions share with those of other views, to what these views segment there."""
    random = np.random.default_rng(seed)
    matrix = (random.random((9, count)) * (random.random((9, count)) < 0.5) * 50).astype(np.float32)
    views = random.integers(0, n_views, count)
    labels, found = merge_regions(csr_array(matrix), views, least_iou)
    root, seen = roots(matrix), roots_of_views(matrix, views)
    assert found.shape == (labels.max() + 1,)
    for cluster, stability in enumerate(found):
        shared = union = 0.0
        for region in np.flatnonzero(labels == cluster):
            for view in set(views.tolist()) - {views[region]}:
                mine = np.flatnonzero((labels == cluster) & (views == view))
                overlap = sum(root[:, region] @ root[:, other] for other in mine)
                shared += overlap
                union += root[:, region] @ seen[:, views == view][:, 0] - overlap
                union += sum(root[:, other] @ seen[:, region] for other in mine)
        assert stability == pytest.approx(shared / max(union, 1), rel=1e-6, abs=1e-9)


# Embeddings of things.


def test_mean_embeddings_are_weighed_by_square_roots_of_masses() -> None:
    generator = torch.Generator().manual_seed(0)
    embeddings = 3 * torch.randn(30, 6, generator=generator)  # of any norm
    embeddings[[4, 9]] = 0
    member = np.arange(30) % 5 - 1  # four things, and what is of none
    mass = np.abs(np.random.default_rng(0).normal(size=30)) * 100
    means, agreement = mean_embeddings(embeddings, member, mass, 4)
    rows = embeddings.half().double().numpy()
    for thing in range(4):
        summed, total = np.zeros(6), 0.0
        for region in range(30):
            length = np.linalg.norm(rows[region])
            if member[region] == thing and length:
                summed += np.sqrt(mass[region]) * rows[region] / length
                total += np.sqrt(mass[region])
        np.testing.assert_allclose(means[thing], summed / np.linalg.norm(summed), atol=1e-6)
        assert agreement[thing] == pytest.approx(np.linalg.norm(summed) / total, abs=1e-6)
    assert (means.dtype, agreement.dtype) == (np.float32, np.float32)


@pytest.mark.parametrize(
    ("embeddings", "member", "expected"),
    [
        ([[0, 0], [0, 0], [0, 2], [0, 0]], [0, 0, 1, 1], ([[0, 0], [0, 1], [0, 0]], [1, 1, 1])),
        ([[1, 0], [-1, 0]], [0, 0], ([[0, 0]], [0])),  # opposed
        ([], [], ([], [])),
    ],
)
def test_zero_embeddings_say_nothing(embeddings: list, member: list[int], expected: tuple) -> None:
    rows = torch.tensor(embeddings).float().reshape(-1, 2)
    found = mean_embeddings(rows, np.array(member, np.int64), np.ones(len(member)), len(expected[1]))
    assert tuple(part.tolist() for part in found) == expected


# Things of scenes.


def test_the_things_of_a_wall_are_found(wall: Wall, things: ThingTable) -> None:
    """Four whole ones with two parts each, from all five views."""
    assert things.levels.tolist() == [0] * 2 * COUNT + [1] * COUNT
    assert things.n_regions.tolist() == [5] * 3 * COUNT
    assert bool((things.owners != NO_THING).all())
    cosines = things.embeddings.float() @ wall.vectors.T
    of_thing = cosines.argmax(1)
    assert of_thing[:8].bincount().tolist() == [2] * COUNT
    assert of_thing[8:].sort().values.tolist() == list(range(COUNT))
    assert float(cosines.amax(1).min()) > 0.97
    assert float(things.agreement.min()) > 0.95
    for number, level in enumerate(things.levels.tolist()):
        mine = things.members(torch.tensor([number]))
        planted = wall.thing == of_thing[number]
        if not level:
            planted &= wall.is_upper == bool(wall.is_upper[mine].float().mean() > 0.5)
            assert int(of_thing[things.parents[number]]) == int(of_thing[number])
        else:
            assert int(things.parents[number]) == NO_THING
        # But for a column of Gaussians on a border, which pixels cannot tell apart.
        assert int((mine & planted).sum()) > 0.8 * int((mine | planted).sum())
    for level in range(2):  # largest first
        mass = things.mass[things.levels == level]
        assert float(mass.max()) == pytest.approx(float(mass[0]), rel=0.01)


def test_owners_are_the_things_that_gaussians_contribute_most_to(wall: Wall, things: ThingTable) -> None:
    sums = region_sums(wall.gaussians, wall.cameras, wall.regions)
    of_thing = (things.embeddings.float() @ wall.vectors.T).argmax(1)
    assert sums.rows is not None
    contributes = np.zeros((len(wall.gaussians), COUNT))
    of_all = sums.matrix(1).toarray()  # every view has its four regions from left to right
    for rows in sums.rows[1].values():
        contributes += of_all[:, rows]
    expected = torch.from_numpy(contributes.argmax(1))
    assert of_thing[things.owners[:, 1].long()].equal(expected)
    # Its mass is what is contributed to its regions, but for small Gaussians and weak entries.
    share = things.mass[things.levels == 1] / torch.from_numpy(contributes.sum(0))[of_thing[2 * COUNT :]]
    assert 0.9 < float(share.min()) <= float(share.max()) <= 1


def test_what_no_other_view_confirms_is_no_thing(wall: Wall) -> None:
    assert LEAST_REGIONS == 2
    alone = of_field(built(wall, wall.cameras.names[:1]))
    assert len(alone) == 0
    assert bool((alone.owners == NO_THING).all())
    two = of_field(built(wall, wall.cameras.names[:2]))
    assert two.n_regions.tolist() == [2] * 3 * COUNT


def test_a_level_may_have_no_things(wall: Wall) -> None:
    """The finer one has regions in one view only, or the coarser one."""
    first = wall.cameras.names[0]
    for bare in LEVELS:

        def load(name: str, level: str, known: RegionMap, bare: str = bare) -> RegionMap:
            if level != bare or name == first:
                return known
            return RegionMap(torch.full_like(known.labels, -1), known.embeddings[:0])

        found = of_field(built(replace(wall, regions=changed_regions(wall.regions, load))))
        other = 1 - LEVELS.index(bare)
        assert found.levels.tolist() == [other] * (2 * COUNT, COUNT)[other]
        assert bool((found.parents == NO_THING).all())
        assert bool((found.owners[:, 1 - other] == NO_THING).all())


def test_zero_embeddings_merge_as_others(wall: Wall, things: ThingTable) -> None:
    """Embeddings do not decide what is merged, and a thing of zeros has none."""

    def load(_: str, level: str, known: RegionMap) -> RegionMap:
        embeddings = known.embeddings.clone()
        embeddings[: 1 if level == "m" else 2] = 0
        return RegionMap(known.labels, embeddings)

    found = of_field(built(replace(wall, regions=changed_regions(wall.regions, load))))
    assert_same(found, things, (*DECIDED, "mass"))
    bare = ~found.embeddings.any(1)
    assert int(bare.sum()) == 3
    assert bool((wall.thing[found.members(bare.nonzero()[-1])] == 0).all())
    assert found.agreement[bare].tolist() == [1, 1, 1]


def test_a_field_may_have_no_things(wall: Wall) -> None:
    paper = replace(BUILD_PRESETS["paper"], n_atoms=6, k=2, keep=2, epochs=5, check_fit=False)
    assert build(wall.gaussians, wall.cameras, wall.regions, paper).thing_table is None


# The same views give the same things, whichever way they came.


def test_the_order_of_views_does_not_matter(wall: Wall, things: ThingTable) -> None:
    found = built(replace(wall, cameras=Cameras(reversed(list(wall.cameras)))))
    assert found.info.provenance["views"] != list(wall.cameras.names)
    assert_same(found.thing_table, things, (*DECIDED, "mass"))
    torch.testing.assert_close(of_field(found).embeddings, things.embeddings, atol=1e-3, rtol=0)
    torch.testing.assert_close(of_field(found).agreement, things.agreement)


def test_of_many_views_some_make_the_things(wall: Wall, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("scoup.uplift.constants.MOST_VIEWS", 2)
    fewer = of_field(built(wall))
    turned = replace(wall, cameras=Cameras([*wall.cameras][1:] + [wall.cameras[0]]))
    names = spread(sorted(camera.name for camera in wall.cameras), 2)
    for other in (built(wall, names), built(turned)):
        assert_same(of_field(other), fewer, ("levels", "n_regions", "mass"))
    assert int(fewer.n_regions.max()) <= 2
    assert bool((fewer.owners != NO_THING).any())
