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
from scoup.uplift.constants import KEPT
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
    return [
        round(float(each.sum()) / max(1, len(each)), 2) for each in np.split(found, np.cumsum(sizes)[:-1])
    ]


BODY, APART = ball(2000, (0, 0, 0), 1.0), ball(200, (3, 0, 0), 0.5)
HEAVY = round(KEPT * len(BODY)) + 20
LEGS = [ball(60, (x, 0.0, -1.0 - 0.05 * step), 0.03, step) for x in (-0.3, 0.3) for step in range(30)]
NEVER_SEEN = np.array([[np.nan, 0, 0], [np.inf, 0, 0]], np.float32)
HUGE = np.array([[3e38, 0, 0], [-3e38, 3e38, 0]], np.float32)


@pytest.mark.parametrize("scale", [1e-4, 1.0, 1e5])
def test_what_lies_apart_from_a_body_is_cut(scale: float) -> None:
    near, far = ball(150, (2.0, 0, 0), 0.2), ball(100, (0, 40, 0), 5.0)
    assert strays([scale * BODY, scale * near, scale * far]) == [0, 1, 1]


@pytest.mark.parametrize(
    ("parts", "how", "expected"),
    [
        pytest.param([BODY, ball(HEAVY, (3, 0, 0), 0.5)], {}, [0, 0], id="seen in pieces"),
        pytest.param([BODY, ball(HEAVY - 40, (3, 0, 0), 0.5)], {}, [0, 1], id="a lighter piece"),
        pytest.param([BODY, APART], {}, [0, 1], id="few"),
        pytest.param([BODY, APART], {"weights": [1.0, 5.0]}, [0, 0], id="as few of large weight"),
        pytest.param([ball(3000, (0, 0, 0), 1.0), *LEGS], {}, [0] * 61, id="thin legs"),
        pytest.param([ball(40, (0, 0, 0), 1.0)], {}, [0], id="sparse"),
        # The stray of one thing lies inside another, and things are of any number.
        pytest.param(
            [BODY, ball(500, (6, 0, 0), 1.0), ball(50, (6, 0, 0), 0.1), BODY + 6],
            {"owners": [70, 3, 70, -1]},
            [0, 0, 1, 0],
            id="several things",
        ),
        pytest.param([np.zeros((5, 3), np.float32)], {}, [0], id="all at one place"),
        pytest.param([BODY[:1]], {}, [0], id="one"),
        pytest.param([BODY], {"weights": [0.0]}, [0], id="without weight"),
        pytest.param([BODY, NEVER_SEEN], {}, [0, 0], id="not finite"),
        pytest.param([BODY, HUGE], {}, [0, 1], id="huge"),
        pytest.param([BODY[:0]], {}, [0], id="none"),
    ],
)
def test_parts_of_things(parts: list[NDArray[np.float32]], how: dict, expected: list[float]) -> None:
    assert strays(parts, **how) == expected


@pytest.mark.parametrize("with_means", [True, False], ids=["", "sums without means"])
def test_no_thing_owns_strays(with_means: bool) -> None:
    """On a wall of which some Gaussians, inside the thing at the left as seen by all cameras, are far behind it."""
    wall = planted_wall()
    away = (wall.gaussians.means[:, :2] - torch.tensor([-1.8, -0.6])).norm(dim=1)
    behind = (wall.thing == 0) & (away < 0.16)
    means, scales = (
        torch.where(behind[:, None], 8.0 * part, part)
        for part in (wall.gaussians.means, wall.gaussians.scales)
    )
    gaussians = replace(wall.gaussians, means=means, scales=scales)
    sums = RegionSums.empty(gaussians, LEVELS)
    if not with_means:
        sums.means = None
    field = build(gaussians, wall.cameras, wall.regions, SETTINGS, sums=sums)
    assert field.thing_table is not None
    owners = field.thing_table.owners
    assert int(behind.sum()) >= 4
    assert bool((owners[behind] == NO_THING).all())
    assert len(field.thing_table) == 3 * COUNT
    cut = (owners == NO_THING).sum(0).tolist()
    assert field.info.provenance["strays"] == dict(zip(LEVELS, cut, strict=True))


@pytest.mark.data
def test_the_teddy_bear_of_a_table_lies_at_one_place(data_folder: Path) -> None:
    """Before strays were cut, a seventh of what it contributed lay on the wall, at 14 times its size from it."""
    scene = data_folder / "real" / "table-20"
    if not scene.is_dir():
        pytest.skip(f"no table-20 in {data_folder}")
    gaussians, cameras = load_gaussians(scene / "point_cloud.splat"), load_cameras(scene)
    regions = load_regions(scene / "language_features", cameras)
    field = build(gaussians, cameras, regions, SETTINGS)
    field = field.with_encoder(data_folder / "desk" / "desk_words.npz")
    bear = field.things(field.question("teddy bear", always=True))[0]
    away = (gaussians.means[bear.gaussians].double() - bear.position).norm(dim=1)
    assert float(away.max()) < 2 * bear.size
    share = sum(field.info.provenance["strays"].values()) / field.thing_table.owners.numel()  # pyright: ignore
    assert 0.01 < share < 0.06
