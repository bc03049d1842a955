"""Photographs that are chosen before extraction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from mask_samples import smooth_image
from scoup.base import InputError
from scoup.extract.photograph_choice import (
    points_as_gaussians,
    rank_views,
    relative_sharpness,
    sharpness,
    total_wanted,
)
from scoup.scene import Camera, Gaussians

SHARP = torch.ones(14)


def ball(count: int = 2000) -> Gaussians:
    """Small opaque Gaussians on a sphere of radius 1."""
    points = torch.nn.functional.normalize(
        torch.randn(count, 3, generator=torch.Generator().manual_seed(1)), dim=1
    )
    return points_as_gaussians(points.double().numpy())


def around(*degrees: float) -> list[Camera]:
    """Cameras on a circle around the ball."""
    eyes = [(3 * np.cos(np.radians(each)), 3 * np.sin(np.radians(each)), 0.5) for each in degrees]
    return [
        Camera.look_at(eye, (0, 0, 0), f"{each}.png", 64, 48, 60.0)
        for each, eye in zip(degrees, eyes, strict=True)
    ]


DWELL = around(0, 0.5, 1, 1.5, 2, 2.5, 3, 3.5, 4, 4.5, 90, 180, 270, 2.2)


def test_nearly_equal_views_are_not_both_taken() -> None:
    found = rank_views(DWELL, ball(), SHARP, 4)
    assert {10, 11, 12} < set(found)
    assert found == rank_views(DWELL, ball(), SHARP, 4)


@pytest.mark.parametrize("few", [0, 6])
def test_the_number_follows_from_the_scene(monkeypatch: pytest.MonkeyPatch, few: int) -> None:
    monkeypatch.setattr("scoup.extract.constants.FEW", few)
    found = rank_views(DWELL, ball(), SHARP)
    assert {10, 11, 12} < set(found)
    assert max(4, few) <= len(found) < 10
    twice = rank_views(DWELL, ball(), SHARP, there=found)
    assert twice == found


def test_more_are_beside_those_there() -> None:
    whole = rank_views(DWELL, ball(), SHARP, 9)
    assert rank_views(DWELL, ball(), SHARP, 9, there=whole[:4]) == whole
    assert sorted(rank_views(DWELL, ball(), SHARP, 99)) == list(range(14))
    assert rank_views(DWELL, ball(), SHARP, 2, there=[5, 6, 7]) == [5, 6, 7]


def test_blurred_photographs_lose_to_sharp_neighbours() -> None:
    sharp = SHARP.clone()
    sharp[:10:2] = 0.1
    found = rank_views(DWELL, ball(), sharp, 4)
    assert {10, 11, 12} < set(found)
    assert not {0, 2, 4, 6, 8} & set(found)
    # Less detail than elsewhere, as much as beside it.
    shown = torch.eye(2).repeat_interleave(10, 0)
    content = torch.tensor([1.0, 0.01]).repeat_interleave(10)
    assert relative_sharpness(content, shown).tolist() == [1.0] * 20
    image = smooth_image(40, 60)
    noisy = (image + np.random.default_rng(1).integers(0, 20, image.shape)).clip(0, 255).astype(np.uint8)
    assert sharpness(noisy) > 2 * sharpness(image)


def test_cameras_that_see_nothing_are_refused() -> None:
    away = [
        replace(camera, viewmat=torch.diag(torch.tensor([1.0, -1, -1, 1])).double() @ camera.viewmat)
        for camera in DWELL
    ]
    with pytest.raises(InputError, match="none of them shows anything"):
        rank_views(away, ball(), SHARP, 4)
    with pytest.raises(InputError, match="3 points, too few"):
        points_as_gaussians(np.eye(3))


@pytest.mark.parametrize(("text", "total"), [(None, None), ("60", 60), ("+40", 45)])
def test_numbers_of_photographs(text: str | None, total: int | None) -> None:
    assert total_wanted(text, 5) == total


@pytest.mark.parametrize("text", ["0", "-3", "+", "some", "1.5", "+0", "10000000000"])
def test_what_is_not_a_number_of_photographs(text: str) -> None:
    with pytest.raises(InputError, match="expected a number such as 60, more as \\+40, or all"):
        total_wanted(text, 5)
