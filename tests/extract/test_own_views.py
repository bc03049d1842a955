"""Cameras that are chosen for a splat without any."""

from __future__ import annotations

import pytest
import torch

from scoup.base.errors import InputError
from scoup.extract.own_views import choose_cameras
from scoup.scene.gaussians import Gaussians
from support import random_gaussians


def test_cameras_are_as_many_as_asked_for_and_the_same_each_time() -> None:
    gaussians = random_gaussians(300, seed=1)
    first, second = (choose_cameras(gaussians, width=64, height=48, count=5, up=(0, 0, 1)) for _ in range(2))
    assert len(first) == 5
    assert [a.fingerprint() for a in first] == [b.fingerprint() for b in second]
    assert all((camera.width, camera.height) == (64, 48) for camera in first)
    assert all(float(camera.viewmat[1, 2]) < 0 for camera in first)  # up is up


@pytest.mark.parametrize("case", ["empty", "transparent", "point", "nan"])
def test_what_cannot_be_seen_is_refused(case: str) -> None:
    gaussians = random_gaussians(20, seed=2)
    parts = {
        name: getattr(gaussians, name).clone() for name in ("means", "quats", "scales", "opacities", "sh")
    }
    if case == "empty":
        parts = {name: rows[:0] for name, rows in parts.items()}
    elif case == "transparent":
        parts["opacities"][:] = 0
    elif case == "point":
        parts["means"][:] = torch.tensor([1.0, 2.0, 3.0])
    else:
        parts["means"][:] = torch.nan
    with pytest.raises(InputError, match="gaussians: nothing"):
        choose_cameras(Gaussians(**parts), width=64, height=48)
