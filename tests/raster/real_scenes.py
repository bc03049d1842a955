"""Real scenes for rasterisers."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import torch

from scoup.io import load_cameras, load_gaussians
from scoup.scene import Camera, Gaussians
from support import unit


def load_scene(data_folder: Path, name: str) -> Gaussians:
    """kitchen, guitar as they are; garden has centres only, and gets the rest made up."""
    files = {"kitchen": "scene/model.splat", "guitar": "guitar.ply", "garden": "test_garden.npz"}
    path = data_folder / name / files[name]
    if not path.exists():
        pytest.skip(f"no {name} in {data_folder}")
    if name != "garden":
        return load_gaussians(path)
    means = torch.from_numpy(np.load(path)["means3d"]).float()
    generator, count = torch.Generator().manual_seed(0), len(means)
    quats = unit(torch.randn(count, 4, generator=generator))
    scales = torch.exp(torch.randn(count, 3, generator=generator) * 0.7 - 4)
    return Gaussians(means, quats, scales, torch.rand(count, generator=generator), torch.zeros(count, 1, 3))


def load_camera(data_folder: Path, name: str, number: int, downscale: int, gaussians: Gaussians) -> Camera:
    """A camera of the scene; guitar has none and is looked at from around."""
    if name == "kitchen":
        camera = load_cameras(data_folder / name)[number]
    elif name == "garden":
        file = np.load(data_folder / name / "test_garden.npz")
        viewmat, K = (torch.from_numpy(file[key][number]) for key in ("viewmats", "Ks"))
        camera = Camera("garden", viewmat, K, int(file["width"]), int(file["height"]))
    else:
        centre, turn = gaussians.means.double().median(0).values, 0.4 + number * 2.1
        viewmat = torch.eye(4, dtype=torch.float64)
        viewmat[0, 0] = viewmat[2, 2] = math.cos(turn)
        viewmat[0, 2], viewmat[2, 0] = math.sin(turn), -math.sin(turn)
        viewmat[:3, 3] = torch.tensor([0.1, 0.2, 3.0 - number]) - viewmat[:3, :3] @ centre
        K = torch.tensor([[500.0, 0, 300], [0, 500, 220], [0, 0, 1]])  # off centre
        camera = Camera("guitar", viewmat, K, 640, 480)
    return camera.resized(camera.width // downscale, camera.height // downscale)
