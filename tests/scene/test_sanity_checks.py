"""Absurd Gaussians."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from scoup.io import load_gaussians
from scoup.scene.gaussians import Gaussians
from scoup.scene.sanity_checks import sanity_problems
from support import random_gaussians


def test_sound_scenes_have_none() -> None:
    kinds = ("plain", "behind", "needle", "tiny", "opacity inf")
    for count in (0, 1, 500):
        assert sanity_problems(random_gaussians(count, 0, kinds[:1] if count < 500 else kinds)) == []


def test_one_splat_is_not_hidden_by_another() -> None:
    gaussians = random_gaussians(400, 0)
    gaussians.means[:15] *= 1e30  # were they counted, the scene would be as large as they are
    gaussians.scales[20] = 1e30
    far, large = sorted(sanity_problems(gaussians), reverse=True)
    assert large.startswith("1 of 400 Gaussians is over 100 times larger")
    assert far.startswith("15 of 400 Gaussians are over 10,000 times")


def test_values_that_are_not_finite_do_not_hide_the_rest() -> None:
    for count, said in ((400, "all 400 Gaussians are transparent"), (1, "the only Gaussian is transparent")):
        gaussians = random_gaussians(count, 0, ("plain", "nan") if count > 1 else ("plain",))
        gaussians.opacities[:] = 0
        gaussians.opacities[3:4] = torch.nan
        (found,) = sanity_problems(gaussians)
        assert found.startswith(said)


@pytest.mark.data
@pytest.mark.parametrize(
    "name", ["guitar/guitar.ply", "guitar/guitar.compressed.ply", "inria_ply/point_cloud.ply", "kitchen"]
)
def test_real_scenes_have_none(data_folder: Path, name: str) -> None:
    path = data_folder / name
    gaussians: Gaussians = load_gaussians(path / "scene" / "model.splat" if path.is_dir() else path)
    assert sanity_problems(gaussians) == []
