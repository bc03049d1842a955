"""Photographs that are chosen before extraction."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from extract.test_pipeline import scene
from mask_samples import smooth_image
from messages import refuses
from scoup.base import no_progress
from scoup.extract import find_photographs
from scoup.extract.photograph_choice import (
    PhotographChoice,
    points_as_gaussians,
    rank_views,
    relative_sharpness,
    sharpness,
    total_wanted,
)
from scoup.scene import Camera, Gaussians
from scoup_lab.data.colmap_model import write_colmap
from support import unit

SHARP = torch.ones(14)


def ball(count: int = 2000) -> Gaussians:
    """Small opaque Gaussians on a sphere of radius 1."""
    points = torch.randn(count, 3, generator=torch.Generator().manual_seed(1))
    return points_as_gaussians(unit(points).double().numpy())


def around(*degrees: float) -> list[Camera]:
    """Cameras on a circle around the ball."""
    return [
        Camera.look_at((3 * np.cos(a), 3 * np.sin(a), 0.5), (0, 0, 0), f"{each}.png", 64, 48, 60.0)
        for each, a in zip(degrees, np.radians(degrees), strict=True)
    ]


DWELL = around(0, 0.5, 1, 1.5, 2, 2.5, 3, 3.5, 4, 4.5, 90, 180, 270, 2.2)


@pytest.mark.parametrize("few", [0, 6])
def test_the_number_follows_from_the_scene(monkeypatch: pytest.MonkeyPatch, few: int) -> None:
    monkeypatch.setattr("scoup.extract.constants.FEW", few)
    found = rank_views(DWELL, ball(), SHARP)
    assert {10, 11, 12} < set(found)
    assert max(4, few) <= len(found) < 10
    assert rank_views(DWELL, ball(), SHARP, there=found) == found


def test_more_are_beside_those_there() -> None:
    whole = rank_views(DWELL, ball(), SHARP, 9)
    assert {10, 11, 12} < set(whole[:4]), "nearly equal views are not both taken"
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
    turned = torch.diag(torch.tensor([1.0, -1, -1, 1])).double()
    away = [replace(camera, viewmat=turned @ camera.viewmat) for camera in DWELL]
    with refuses():
        rank_views(away, ball(), SHARP, 4)
    with refuses():
        points_as_gaussians(np.eye(3))


def test_photographs_come_by_what_they_add(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, cameras = scene(tmp_path)
    write_colmap(cameras, folder / "sparse" / "0", (np.zeros((1, 3)), np.zeros((1, 3), np.uint8)))
    monkeypatch.setattr("scoup.extract.photograph_choice._surface", lambda *_: ball())
    monkeypatch.setattr("scoup.extract.photograph_choice.rank_views", lambda *_: [2, 0])
    choice = PhotographChoice(folder, find_photographs(folder), 2, ())
    chosen = choice.choose(None, None, no_progress)
    assert [item.name for item in chosen] == ["2.png", "0.png"]


def test_numbers_of_photographs() -> None:
    assert [total_wanted(text, 5) for text in (None, "60", "+40")] == [None, 60, 45]
    for text in ("0", "-3", "+", "some", "1.5", "+0", "10000000000"):
        with refuses():
            total_wanted(text, 5)
