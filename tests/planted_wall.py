"""A wall of things side by side, each of two parts, with regions of them in every view and words that name them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from scoup.query import Question
from scoup.scene import Camera, Cameras, Gaussians, RegionMap, Regions
from scoup.uplift import BuildSettings
from support import gaussians_at, make_camera, unit

DIM = 24
LEVELS = ("s", "m")
EDGES = (-2.4, -1.2, 0.0, 1.2, 2.4)
COUNT = len(EDGES) - 1
SETTINGS = BuildSettings(n_atoms=6, k=2, keep=2, solver="exact", check_fit=False)


@dataclass(frozen=True, eq=False)
class Wall:
    """Gaussians at z = 4, seen from the front by cameras side by side.

    Attributes:
        gaussians: N.
        cameras: each sees the wall's whole height, and most of its width.
        regions: of level "m" one a thing, of level "s" one for its upper and one for its lower half.
        thing: [N] int64, 0 to 3 from left to right.
        is_upper: [N] boolean.
        vectors: [4, D], one a thing.
        texts: a word for each thing, and what they are compared with.
    """

    gaussians: Gaussians
    cameras: Cameras
    regions: Regions
    thing: Tensor
    is_upper: Tensor
    vectors: Tensor
    texts: Question[list[str]]

    def shows(self, camera: Camera) -> Tensor:
        """[H, W] int64: the thing of each pixel, -1 beside the wall."""
        columns, rows = torch.arange(camera.width) + 0.5, torch.arange(camera.height) + 0.5
        x = (columns - camera.cx) / camera.fx * 4.0 - float(camera.viewmat[0, 3])
        y = (rows - camera.cy) / camera.fy * 4.0
        thing = torch.bucketize(x, torch.tensor(EDGES)) - 1
        thing[thing >= COUNT] = -1
        return torch.where((y.abs() < 1.2)[:, None], thing[None], -1)


def planted_wall(views: int = 5, noise: float = 0.05, seed: int = 0) -> Wall:
    generator = torch.Generator().manual_seed(seed)
    x, y = torch.meshgrid(torch.arange(-2.35, 2.4, 0.1), torch.arange(-1.15, 1.2, 0.1), indexing="ij")
    means = torch.stack([x.flatten(), y.flatten(), torch.full_like(x.flatten(), 4.0)], 1)
    gaussians = gaussians_at(means, 0.04)
    common = unit(torch.randn(DIM, generator=generator))
    vectors = unit(common + unit(torch.randn(COUNT, DIM, generator=generator)))
    words = unit(common + unit(torch.randn(40, DIM, generator=generator)))
    texts = Question(tuple("abcd"), vectors, words[:4], words[4:])
    cameras = Cameras(_camera(f"view_{i:02d}.png", 0.6 * (i / max(1, views - 1) - 0.5)) for i in range(views))
    thing = torch.bucketize(means[:, 0].contiguous(), torch.tensor(EDGES)) - 1
    wall = Wall(gaussians, cameras, Regions.from_maps({}), thing, means[:, 1] < 0, vectors, texts)
    maps = {camera.name: _maps(wall, camera, noise, generator) for camera in cameras}
    return replace(wall, regions=Regions.from_maps(maps))


def _camera(name: str, x: float) -> Camera:
    viewmat = torch.eye(4, dtype=torch.float64)
    viewmat[0, 3] = -x
    return replace(make_camera(48, 28, 36.0, name=name), viewmat=viewmat)


def _maps(wall: Wall, camera: Camera, noise: float, generator: torch.Generator) -> dict[str, RegionMap]:
    shows = wall.shows(camera)
    lower = (torch.arange(camera.height) >= camera.height // 2)[:, None]
    halves = torch.where(shows >= 0, 2 * shows + lower, -1)
    found = {}
    for level, labels, which in (
        ("s", halves, torch.arange(2 * COUNT) // 2),
        ("m", shows, torch.arange(COUNT)),
    ):
        embeddings = unit(wall.vectors[which] + noise * torch.randn(len(which), DIM, generator=generator))
        found[level] = RegionMap(labels.int().contiguous(), embeddings)
    return found
