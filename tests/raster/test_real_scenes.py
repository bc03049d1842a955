"""The compiled core against the reference on real scenes, where flips are counted, explained and bounded."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from raster.parity import (
    FLIP_SIZE,
    assert_same_sums,
    beyond,
    both,
    explained_flips,
    few,
    needs_native,
    painted,
    span_of,
)
from raster.real_scenes import load_camera, load_scene
from scoup import raster
from scoup.scene import Camera, Gaussians
from support import unit

pytestmark = [pytest.mark.data, needs_native]

Seen = tuple[Gaussians, Camera, tuple[raster.Projection, raster.Projection]]
VIEWS = [("kitchen 5", "gsplat", 2), ("guitar 0", "inria", 1), ("garden 0", "gsplat", 2)]
MORE_VIEWS = [
    ("kitchen 0", "inria", 1), ("kitchen 11", "gsplat", 1), ("kitchen 17", "inria", 2), ("guitar 1", "gsplat", 1),
    ("guitar 2", "inria", 1), ("garden 2", "inria", 2),
]  # fmt: skip


@functools.cache
def seen(data_folder: Path, view: str, preset: str, downscale: int) -> Seen:
    """A view of a scene by both backends."""
    scene, number = view.split()[0], int(view.split()[1])
    gaussians = load_scene(data_folder, scene)
    camera = load_camera(data_folder, scene, number, downscale, gaussians)
    return gaussians, camera, both(gaussians, camera, preset)


def load_labels(data_folder: Path, scene: str, number: int, camera: Camera) -> torch.Tensor:
    """The view's region maps at three levels, nearest neighbour; blocks of regions where a scene has none."""
    if scene != "kitchen":
        rows, columns = torch.arange(camera.height)[:, None], torch.arange(camera.width)
        return torch.stack([(rows // edge) * 1000 + columns // edge for edge in (7, 33, 120)])
    maps = []
    for level in "sml":
        with Image.open(data_folder / scene / "regions" / f"frame_{number + 1:05d}_{level}.png") as image:
            labels = np.array(image.resize((camera.width, camera.height), Image.Resampling.NEAREST)).astype(
                np.int64
            )
        maps.append(torch.from_numpy(np.where(labels == 65535, -1, labels)))
    return torch.stack(maps)


def codes_and_queries(count: int) -> tuple[torch.Tensor, ...]:
    """(indices, weights, codebook, queries); atoms have cosines of about 0.9, as embeddings of images do."""
    generator = torch.Generator().manual_seed(0)
    indices = torch.randint(32, (count, 2, 4), generator=generator, dtype=torch.uint8)
    weights = torch.rand(count, 2, 4, generator=generator)
    weights /= weights.sum(2, keepdim=True)
    codebook = unit(torch.randn(2, 32, 16, generator=generator) * 0.08 + unit(torch.ones(16)))
    return indices, weights, codebook, unit(torch.randn(5, 16, generator=generator))


@pytest.mark.parametrize(
    ("view", "preset", "downscale"),
    [*VIEWS, *(pytest.param(*view, marks=pytest.mark.slow) for view in MORE_VIEWS)],
)
def test_flips_are_few_small_and_explained(data_folder, view, preset, downscale):
    scene, number = view.split()[0], int(view.split()[1])
    gaussians, camera, views = seen(data_folder, view, preset, downscale)

    values = torch.rand(len(gaussians), 3, generator=torch.Generator().manual_seed(number))
    found, expected = (painted(looked, values) for looked in views)
    assert (expected[..., 3] > 0).float().mean() > 0.05
    flipped = explained_flips(gaussians, camera, preset, found, expected, span_of(values))
    assert few(flipped)

    labels = load_labels(data_folder, scene, number, camera)
    labels[:, flipped] = -1
    # Flips behind nearly opaque ones are too faint for the image to show, up to 10 times the tolerance here.
    assert_same_sums(*(raster.region_sums(looked, labels) for looked in views), span=10.0)


@pytest.mark.parametrize(("view", "preset", "downscale"), VIEWS)
def test_cosines(data_folder, view, preset, downscale):
    gaussians, _, views = seen(data_folder, view, preset, downscale)
    given = codes_and_queries(len(gaussians))
    actual, expected = (raster.render_cosines(looked, *given).permute(2, 3, 0, 1) for looked in views)
    _, alpha = raster.render_channels(views[0], torch.zeros(len(gaussians), 0))
    flipped = beyond(actual, expected, 5.0).flatten(2).any(2)
    assert few(flipped)
    # A cosine has no scale: what flips counts for more where little is painted.
    sizes = (actual - expected).abs().flatten(2).amax(2)[flipped]
    assert (sizes <= 2 * FLIP_SIZE / alpha[flipped].clamp(min=FLIP_SIZE)).all()
    assert (actual[alpha == 0] == 0).all()
