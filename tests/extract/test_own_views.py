"""Cameras that are chosen for a splat without any."""

from __future__ import annotations

import errno
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from messages import refuses, warns
from scoup.base import ScoupWarning
from scoup.extract.own_views import choose_cameras, save_views
from scoup.extract.splat_up import estimate_up_of_splat
from scoup.extract.view_choice import Scores, not_from_behind
from scoup.pictures import Picture, contact_sheet
from scoup.scene import Cameras, Gaussians, checked_direction
from support import gaussians_at, make_camera, random_gaussians


@pytest.mark.usefixtures("few_candidates")
def test_cameras_are_as_many_as_asked_for_and_the_same_each_time() -> None:
    gaussians = random_gaussians(300, seed=1)
    first, second = (choose_cameras(gaussians, width=64, height=48, count=5, up=(0, 0, 1)) for _ in range(2))
    assert len(first) == 5
    assert [a.fingerprint() for a in first] == [b.fingerprint() for b in second]
    assert all((camera.width, camera.height) == (64, 48) for camera in first)
    assert all(float(camera.viewmat[1, 2]) < 0 for camera in first)  # up is up


@pytest.mark.usefixtures("few_candidates")
def test_what_cannot_be_seen_and_what_is_no_direction_are_refused() -> None:
    few, fog = random_gaussians(20, seed=2), random_gaussians(3000, seed=1)  # fog: of large Gaussians
    unseen = [
        replace(few, opacities=torch.zeros(20)), replace(few, means=torch.tensor([1.0, 2.0, 3.0]).repeat(20, 1)),
        replace(few, means=torch.full((20, 3), torch.nan)), few.select([]), fog,
    ]  # fmt: skip
    for gaussians in unseen:
        with refuses():
            choose_cameras(gaussians, width=64, height=48, up=(0, -1, 0) if gaussians is fog else None)
    for up in ((0, 0, 0), (0, 1), (0, float("nan"), 1)):
        with refuses():
            choose_cameras(few, width=64, height=48, up=up)
    for length in (1e-300, 1e300):  # only the direction counts
        assert checked_direction((0, 0, length)).tolist() == [0, 0, 1]


def surface(normal: int, side: float = -1.0, seed: int = 3, count: int = 600) -> Gaussians:
    """Flat Gaussians in a plane across an axis, at one side of round ones."""
    gaussians = random_gaussians(count, seed=seed)
    means, scales = gaussians.means.clone(), torch.full((count, 3), 0.05)
    lying = torch.arange(count) < count // 2
    means[lying, normal] = side * float(means.abs().max())
    scales[lying, normal] = 0.001
    return replace(gaussians_at(means), scales=scales)


@pytest.mark.parametrize(
    ("normal", "side", "expected", "guesses"),
    [(2, -1, (0, 0, 1), 0), (2, 1, (0, -1, 0), 1), (1, 1, (0, -1, 0), 0), (0, -1, (0, -1, 0), 1)],
    ids=["floor across z", "wall across z", "floor across y", "neither"],
)
def test_up_is_what_floors_face(
    normal: int, side: float, expected: tuple[float, ...], guesses: int, recwarn: pytest.WarningsRecorder
) -> None:
    gaussians = surface(normal, side)
    assert estimate_up_of_splat(gaussians, torch.arange(len(gaussians))).tolist() == list(expected)
    assert ["up is a guess" in str(warning.message) for warning in recwarn] == [True] * guesses


def test_a_tilted_floor_tilts_what_is_up() -> None:
    angle = torch.tensor(0.35)
    turn = torch.tensor([[1, 0, 0], [0, angle.cos(), -angle.sin()], [0, angle.sin(), angle.cos()]])
    flat = surface(1, side=1)
    quat = torch.tensor([(angle / 2).cos(), (angle / 2).sin(), 0, 0]).expand(len(flat), 4).clone()
    tilted = Gaussians(flat.means @ turn.T, quat, flat.scales, flat.opacities, flat.sh)
    up = estimate_up_of_splat(tilted, torch.arange(len(tilted))).float()
    assert torch.allclose(up, turn @ torch.tensor([0.0, -1, 0]), atol=1e-3)


@pytest.mark.usefixtures("few_candidates")
@pytest.mark.parametrize("size", [(8192, 16), (16, 4096)])
def test_images_may_be_long_and_narrow(size: tuple[int, int]) -> None:
    (camera,) = choose_cameras(random_gaussians(300, seed=1), width=size[0], height=size[1], count=1)
    assert (camera.width, camera.height) == size


# Some of the parts of the matter have nothing, or lie at one place.
@pytest.mark.usefixtures("few_candidates")
@pytest.mark.parametrize("places", [8, 20])
def test_many_gaussians_may_be_at_one_place(places: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("scoup.extract.constants.PARTS", 16)
    monkeypatch.setattr("scoup.extract.constants.AROUND_PART", 2)
    gaussians = random_gaussians(300, seed=1)
    means = gaussians.means[torch.arange(300) % places]
    assert len(choose_cameras(replace(gaussians, means=means), width=32, height=24, count=2)) == 2


@pytest.mark.usefixtures("few_candidates")
def test_where_nothing_is_opaque_all_that_is_seen_is_covered(tmp_path: Path) -> None:
    gaussians = replace(random_gaussians(300, seed=1), opacities=torch.full((300,), 0.3))
    with warns(ScoupWarning):
        cameras = choose_cameras(gaussians, width=64, height=48, count=3)
    shown = save_views(gaussians, cameras, tmp_path)
    assert 0 < shown.often <= shown.once <= 1


def test_views_that_are_not_whole_have_no_cameras(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse_sheets(source: Path, target: Path) -> None:
        if target == tmp_path / "views.png":
            raise OSError(errno.EIO, "broken", str(target))
        source.rename(target)

    monkeypatch.setattr("scoup.base.outputs.os.replace", refuse_sheets)
    cameras = Cameras([make_camera(64, 48)])
    with pytest.raises(OSError, match="broken"):
        save_views(random_gaussians(50, seed=1), cameras, tmp_path)
    assert [path.name for path in tmp_path.rglob("*.*")] == ["view.png"]


def test_only_small_pictures_are_kept_for_the_sheet(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    widths: list[int] = []

    def sheet(tiles: list[Picture], titles: list[str]) -> Picture:
        widths.extend(tile.shape[1] for tile in tiles)
        return contact_sheet(tiles, titles)

    monkeypatch.setattr("scoup.extract.own_views.contact_sheet", sheet)
    gaussians = random_gaussians(50, seed=1)
    cameras = Cameras(replace(make_camera(600, 40, seed=seed), name=f"{seed}.png") for seed in range(5))
    save_views(gaussians, cameras, tmp_path)
    assert widths == [290] * 5
    pictures = [np.asarray(Image.open(tmp_path / "images" / camera.name)) for camera in cameras]
    whole = contact_sheet(pictures, [camera.stem for camera in cameras])
    assert np.array_equal(np.asarray(Image.open(tmp_path / "views.png")), whole)


def test_beside_thin_things_pictures_may_be_empty() -> None:
    cameras = [replace(make_camera(64, 48), name=f"{number}.png") for number in range(3)]
    # A wide thing, the same from afar, and a thin one.
    shown = torch.tensor([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    pictures = torch.tensor([[0.9, 0.9, 0.0], [0.9, 0.4, 0.0], [0.9, 0.4, 0.0]])
    worth = Scores(cameras, shown.half(), torch.zeros(3, 2, dtype=torch.uint8), pictures).worth()
    assert worth[0, 0] > 0.9
    assert worth[1, 0] < 0.01
    assert worth[2, 1] > 0.9


def test_views_of_backs_are_poor() -> None:
    shown = torch.ones(3, 4)
    fronts = torch.tensor([[True] * 4, [True, False, False, False], [False] * 4])
    assert not_from_behind(shown, fronts).tolist() == pytest.approx([1, 0, 0], abs=1e-3)
