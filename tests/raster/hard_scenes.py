"""Scenes that are hard on a rasteriser, each with a camera."""

from __future__ import annotations

import torch
from hypothesis import strategies as st

from scoup.scene import Camera, Gaussians
from support import make_camera, random_gaussians, scenes

HARD_KINDS = ("crowd", "wall", "needles", "giants", "equal depths", "copies", "off centre", "near")


def hard_scene(kind: str, seed: int) -> tuple[Gaussians, Camera]:
    """A scene of one of ``HARD_KINDS``."""
    generator = torch.Generator().manual_seed(seed)
    camera = make_camera(37, 29, 36.0, seed)
    if kind == "crowd":  # thousands of faint ones behind each other: no pixel finishes early
        gaussians = random_gaussians(3000, seed)
        gaussians.opacities.mul_(0.02)
        gaussians.scales.add_(0.2)
    elif kind == "wall":  # hundreds of opaque ones behind each other: every pixel finishes
        gaussians = random_gaussians(600, seed, ("plain", "opacity 1"))
        gaussians.scales.add_(0.3)
    elif kind == "needles":  # thin lines through many tiles, in every direction
        gaussians = random_gaussians(80, seed, ("needle",))
        gaussians.scales[:, 0] = torch.logspace(-2, 3, 80)
        camera = make_camera(150, 110, 120.0, seed)
    elif kind == "giants":
        gaussians = random_gaussians(60, seed, ("huge", "plain"))
        gaussians.opacities.mul_(0.2)
    elif kind == "equal depths":
        gaussians = random_gaussians(300, seed)
        gaussians.means[:, 2] = 4.0 + torch.randint(3, (300,), generator=generator) * 0.5
        camera = make_camera(37, 29, 36.0)  # unturned, so that the depths stay equal
    elif kind == "copies":
        once = random_gaussians(40, seed)
        gaussians = once.select(torch.randint(40, (400,), generator=generator))
        gaussians.opacities[:] = torch.rand(400, generator=generator)
    elif kind == "off centre":
        gaussians = random_gaussians(300, seed)
        x, y = (torch.rand(2, generator=generator) * 2 - 0.5).tolist()
        camera.K[0, 2], camera.K[1, 2] = x * camera.width, y * camera.height
    elif kind == "near":  # on both sides of the near planes, where projections are vast
        gaussians = random_gaussians(200, seed)
        gaussians.means[:, 2] = torch.rand(200, generator=generator) * 0.5 - 0.1
        gaussians.means[:, :2] *= 0.1
        gaussians.scales.mul_(0.1)
        camera = make_camera(37, 29, 36.0)
    else:
        raise ValueError(kind)
    return gaussians, camera


@st.composite
def any_scenes(draw: st.DrawFn) -> tuple[Gaussians, Camera]:
    """A hard scene, or a random one with every sort of ugly Gaussian."""
    if draw(st.booleans()):
        return draw(scenes(60))
    return hard_scene(draw(st.sampled_from(HARD_KINDS)), draw(st.integers(0, 2**31)))
