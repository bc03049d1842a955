"""Strays of things: what lies apart from a body is cut, what belongs to it stays."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from planted_wall import COUNT, LEVELS, SETTINGS, planted_wall
from scoup.field import NO_THING
from scoup.io import load_cameras, load_gaussians, load_regions
from scoup.query import build
from scoup.scene import Cameras, Gaussians, Regions
from scoup.uplift.constants import KEPT
from scoup.uplift.settings import BuildSettings
from scoup.uplift.stored_sums import RegionSums
from scoup.uplift.things import find_strays


def ball(count: int, middle: tuple[float, float, float], radius: float, seed: int = 0) -> NDArray[np.float32]:
    rng = np.random.default_rng(seed)
    away = rng.normal(size=(count, 3))
    away *= radius * rng.random((count, 1)) ** (1 / 3) / np.linalg.norm(away, axis=1, keepdims=True)
    return (np.array(middle) + away).astype(np.float32)


def strays(
    parts: list[NDArray[np.float32]], owners: list[int] | None = None, weights: list[float] | None = None
) -> list[float]:
    """Return the share of each part that is cut, in hundredths; by default all are of thing 0 and weigh 1."""
    sizes = [len(part) for part in parts]
    owner = np.repeat(owners or [0] * len(parts), sizes)
    found = find_strays(owner, np.concatenate(parts), np.repeat(weights or [1.0] * len(parts), sizes))
    return [round(float(each.mean()), 2) for each in np.split(found, np.cumsum(sizes)[:-1])]


BODY = ball(2000, (0, 0, 0), 1.0)


@pytest.mark.parametrize("scale", [1e-4, 1.0, 1e5])
def test_what_lies_apart_from_a_body_is_cut(scale: float) -> None:
    near, far = ball(150, (2.0, 0, 0), 0.2), ball(100, (0, 40, 0), 5.0)
    assert strays([scale * BODY, scale * near, scale * far]) == [0, 1, 1]


def test_a_thing_seen_in_pieces_stays_whole() -> None:
    heavy = round(KEPT * len(BODY)) + 20
    assert strays([BODY, ball(heavy, (3, 0, 0), 0.5)]) == [0, 0]
    assert strays([BODY, ball(heavy - 40, (3, 0, 0), 0.5)]) == [0, 1]


def test_weights_decide_not_numbers() -> None:
    few = ball(200, (3, 0, 0), 0.5)
    assert strays([BODY, few]) == [0, 1]
    assert strays([BODY, few], weights=[1.0, 5.0]) == [0, 0]


def test_thin_legs_and_sparse_things_stay() -> None:
    seat = ball(3000, (0, 0, 0), 1.0)
    legs = [ball(60, (x, 0.0, -1.0 - 0.05 * step), 0.03, step) for x in (-0.3, 0.3) for step in range(30)]
    assert max(strays([seat, *legs])) == 0
    assert strays([ball(40, (0, 0, 0), 1.0)]) == [0]


def test_every_thing_has_its_own_body() -> None:
    """The stray of one lies inside another, and things are of any number."""
    other = ball(500, (6, 0, 0), 1.0)
    inside = ball(50, (6, 0, 0), 0.1)
    assert strays([BODY, other, inside, BODY + 6], owners=[70, 3, 70, -1]) == [0, 0, 1, 0]


def test_odd_gaussians() -> None:
    assert find_strays(np.zeros(0, np.int64), np.zeros((0, 3), np.float32), np.zeros(0)).tolist() == []
    assert strays([np.zeros((5, 3), np.float32)]) == [0]  # all at one place
    assert strays([BODY[:1]]) == [0]
    assert strays([BODY], weights=[0.0]) == [0]
    odd = np.array([[np.nan, 0, 0], [np.inf, 0, 0]], np.float32)  # never seen
    assert strays([BODY, odd]) == [0, 0]
    huge = np.array([[3e38, 0, 0], [-3e38, 3e38, 0]], np.float32)
    assert strays([BODY, huge]) == [0, 1]


# In fields.


def smeared() -> tuple[Gaussians, Cameras, Regions, torch.Tensor]:
    """A wall of which some Gaussians, inside the thing at the left as seen by all cameras, are far behind it."""
    wall = planted_wall()
    behind = (wall.thing == 0) & (
        (wall.gaussians.means[:, :2] - torch.tensor([-1.8, -0.6])).norm(dim=1) < 0.16
    )
    means = torch.where(behind[:, None], 8.0 * wall.gaussians.means, wall.gaussians.means)
    scales = torch.where(behind[:, None], 8.0 * wall.gaussians.scales, wall.gaussians.scales)
    return replace(wall.gaussians, means=means, scales=scales), wall.cameras, wall.regions, behind


def test_no_thing_owns_strays() -> None:
    gaussians, cameras, regions, behind = smeared()
    sums = RegionSums.empty(gaussians, LEVELS)
    field = build(gaussians, cameras, regions, SETTINGS, sums=sums)
    assert field.thing_table is not None
    owners = field.thing_table.owners
    assert int(behind.sum()) >= 4
    assert bool((owners[behind] == NO_THING).all())
    assert len(field.thing_table) == 3 * COUNT
    cut = (owners == NO_THING).sum(0).tolist()
    assert field.info.provenance["strays"] == dict(zip(LEVELS, cut, strict=True))


def test_a_build_adds_means_that_the_sums_lack() -> None:
    gaussians, cameras, regions, behind = smeared()
    sums = RegionSums.empty(gaussians, LEVELS)
    sums.means = None
    field = build(gaussians, cameras, regions, SETTINGS, sums=sums)
    assert field.thing_table is not None
    assert bool((field.thing_table.owners[behind] == NO_THING).all())


@pytest.mark.data
def test_the_teddy_bear_of_a_table_lies_at_one_place(data_folder: Path) -> None:
    """Before strays were cut, a seventh of what it contributed lay on the wall, at 14 times its size from it."""
    scene = data_folder / "real" / "table-20"
    if not scene.is_dir():
        pytest.skip(f"no table-20 in {data_folder}")
    gaussians, cameras = load_gaussians(scene / "point_cloud.splat"), load_cameras(scene)
    field = build(
        gaussians, cameras, load_regions(scene / "language_features", cameras), BuildSettings(check_fit=False)
    )
    words = data_folder / "desk" / "desk_words.npz"
    field = field.with_encoder(words)
    bear = field.things(field.question("teddy bear", always=True))[0]
    away = (gaussians.means[bear.gaussians].double() - bear.position).norm(dim=1)
    assert float(away.max()) < 2 * bear.size
    share = sum(field.info.provenance["strays"].values()) / field.thing_table.owners.numel()  # pyright: ignore
    assert 0.01 < share < 0.06
