"""What must hold for the kernels of a GPU, on any device: on "cpu" they are interpreted, with few programs of many
lanes. The reference answers for the same scene on the CPU.

Every check makes its scene from a kind or a seed, so that it can be run in another process.
"""

from __future__ import annotations

import math
import os
from dataclasses import replace
from typing import TYPE_CHECKING, Any
from unittest.mock import patch

import torch

from raster.hard_scenes import HARD_KINDS, hard_scene
from raster.parity import (
    assert_channels_agree,
    assert_close,
    assert_codes_agree,
    assert_same_sums,
    labels_at,
    random_codes,
    same_bytes,
    sure_pixels,
)
from scoup import raster
from scoup.scene import Camera, Gaussians
from support import KINDS, make_camera, random_gaussians, random_labels, small_scene

if TYPE_CHECKING:
    from scoup.raster.triton.projection import TritonProjection

KINDS_OF_SCENES = (*KINDS, *HARD_KINDS, "empty", "one pixel", "mixed")


def scene_of(kind: str, seed: int, few: bool) -> tuple[Gaussians, Camera]:
    """A hard scene, one of ugly Gaussians, or one of both; with ``few`` small enough to be interpreted."""
    if kind == "empty":
        return random_gaussians(6, seed, ("behind",)), make_camera(7, 5, seed=seed)
    if kind == "one pixel":
        return random_gaussians(40, seed), make_camera(1, 1, 36.0, seed)
    if kind in ("mixed", *KINDS):
        kinds = KINDS if kind == "mixed" else (kind, "plain")
        return random_gaussians(60, seed, kinds), make_camera(37, 21, 36.0, seed)
    gaussians, camera = hard_scene(kind, seed)
    if few and len(gaussians) > 150:
        gaussians = gaussians.select(torch.arange(150))
    if few and camera.width > 48:
        camera = make_camera(48, 35, 38.4, seed)
    return gaussians, camera


def projections_of(
    gaussians: Gaussians, camera: Camera, preset: str, device: str
) -> tuple[TritonProjection, raster.Projection]:
    """(on the device, reference) projections."""
    from scoup.raster.triton import rendering as gpu

    if device == "cpu":
        assert os.environ.get("TRITON_INTERPRET") == "1"
    constants = raster.raster_preset(preset)
    projection = gpu.project(gaussians.to(device), camera, constants)
    return projection, raster.project(gaussians, camera, preset, "reference")


def check_channels(kind: str, seed: int, preset: str, channels: int, device: str) -> None:
    scene = scene_of(kind, seed, device == "cpu")
    projections = projections_of(*scene, preset, device)
    values = torch.randn(len(scene[0]), channels, generator=torch.Generator().manual_seed(seed))
    actual = assert_channels_agree(projections, scene, preset, values, device)
    if kind not in ("empty", "behind", "opacity 0", "nan", "zero quat", "near"):
        assert bool((actual[..., -1] > 0).any()), "nothing is drawn: proves little"


def check_regions(kind: str, seed: int, levels: int, n_regions: int, device: str) -> None:
    check_regions_of(*scene_of(kind, seed, device == "cpu"), seed, levels, n_regions, device)


def check_regions_of(
    gaussians: Gaussians, camera: Camera, seed: int, levels: int, n_regions: int, device: str
) -> None:
    projection, reference = projections_of(gaussians, camera, "inria", device)
    labels = labels_at((gaussians, camera), "inria", levels, n_regions, seed)
    found = raster.region_sums(projection, labels.to(device))
    assert same_bytes(found, raster.region_sums(projection, labels.to(device)))
    assert_same_sums(found, raster.region_sums(reference, labels))


def check_kinds_of_labels(device: str) -> None:
    """Regions may be integers of any kind; those without a sign know no pixel without a region."""
    gaussians, _ = scene_of("mixed", 3, device == "cpu")
    camera = make_camera(19, 13, 18.0, 3)
    projection, _ = projections_of(gaussians, camera, "inria", device)
    labels = random_labels(2, camera.height, camera.width, 5, 3)
    expected = raster.region_sums(projection, labels.to(device))
    for dtype in (torch.int8, torch.int16, torch.int64):
        assert same_bytes(raster.region_sums(projection, labels.to(device, dtype)), expected), dtype
    labels = labels.clamp(min=0, max=1)
    expected = raster.region_sums(projection, labels.to(device))
    for dtype in (torch.uint8, torch.bool):
        assert same_bytes(raster.region_sums(projection, labels.to(device, dtype)), expected), dtype


def check_few_sums_at_a_time(device: str) -> None:
    """Tiles whose sums do not fit at once come one lot after the other, each tile once, however large; the result stays
    the same to the last bit.
    """
    from scoup.raster.triton import region_sums as gpu_regions

    gaussians, _ = scene_of("mixed", 3, device == "cpu")
    gaussians, camera = gaussians.select(torch.arange(12)), make_camera(45, 37, 36.0, 3)
    projection, _ = projections_of(gaussians, camera, "inria", device)
    labels = random_labels(2, camera.height, camera.width, 9, 3).to(device)
    labels[:, 16:24] = -1  # a row of tiles without a region

    columns = gpu_regions.columns_of(projection, raster.combine(labels).map)
    sizes = projection.starts.diff() * columns.counts
    total, largest = int(sizes.sum()), int(sizes.max())
    assert bool((sizes == 0).any())
    assert largest < total

    def found(most: int) -> tuple[list[int], raster.ViewSums]:
        with patch.object(gpu_regions, "MOST_SUMS", most):
            lots = list(gpu_regions.lots(torch.cumsum(sizes, 0), total))
            sums = raster.region_sums(projection, labels)
        tiles = [tile for lot in lots for tile in lot.tiles]
        assert len(set(tiles)) == len(tiles), "a tile came twice"
        assert [lot.room for lot in lots] == [int(sizes[list(lot.tiles)].sum()) for lot in lots]
        return [lot.room for lot in lots], sums

    _, expected = found(total)
    for most in (total - 1, largest - 1):
        lots, again = found(most)
        assert len(lots) > 1
        assert sum(lots) == total
        assert min(lots) > 0
        assert max(lots) <= max(most, largest)
        assert same_bytes(again, expected), most


def check_nothing_painted(device: str) -> None:
    """Regions of pixels that nobody paints, in tiles that Gaussians do reach; and no region at all."""
    gaussians, camera = scene_of("mixed", 3, device == "cpu")
    projection, reference = projections_of(gaussians.select(torch.arange(4, 10)), camera, "inria", device)
    _, alpha = raster.render_channels(reference, torch.zeros(6, 1))
    assert bool((alpha > 0).any())
    labels = torch.where(alpha == 0, 0, -1)[None]
    assert bool((labels == 0).any())
    for nothing in (labels, torch.full_like(labels, -1)):
        found = raster.region_sums(projection, nothing.to(device))
        entries = found.gaussian, found.combination, found.weight
        assert [(len(part), part.dtype) for part in entries] == [
            (0, torch.int32), (0, torch.int32), (0, torch.float32),
        ]  # fmt: skip


def check_split(device: str) -> None:
    """The weight of a Gaussian that is all but hidden keeps its digits, too."""
    from raster.split_kernel import split_kernel

    count = 4096
    values = torch.linspace(math.log(1e-4 / 255), 0, count, dtype=torch.float64).exp().float()
    values[0] = 0
    parts = [torch.empty(count, device=device) for _ in range(2)]
    with torch.cuda.device_of(parts[0]):
        kernel: Any = split_kernel  # a launch takes plain numbers as constants
        kernel[(1,)](values.to(device), *parts, COUNT=count)
    high, low = (part.double().cpu() for part in parts)
    error = (high + low - values.double()).abs()
    assert bool((error <= (2.0**-22 * values.double()).clamp(min=2.0**-40)).all())


def check_codes(kind: str, seed: int, levels: int, n_atoms: int, k: int, halves: bool, device: str) -> None:
    """Coefficients, cosines, norms and features of the same codes."""
    gaussians, camera = scene_of(kind, seed, device == "cpu")
    if device == "cpu" and n_atoms > 128:  # many programs a tile
        gaussians, camera = gaussians.select(torch.arange(min(len(gaussians), 60))), camera.resized(12, 9)
    projections = projections_of(gaussians, camera, "gsplat", device)
    indices, weights, *vectors = random_codes(len(gaussians), levels, k, n_atoms, seed)
    codes = indices, weights.half() if halves else weights, *vectors
    painted = assert_codes_agree(projections, sure_pixels(gaussians, camera, "gsplat"), codes, device)
    if kind not in ("empty", "behind", "opacity 0", "nan", "zero quat"):
        assert bool(painted.any()), "nothing is drawn: proves little"


def check_repeated_atoms(device: str) -> None:
    """An atom that a code has twice counts with both weights, whatever stands between."""
    gaussians, camera = scene_of("mixed", 5, device == "cpu")
    projection, reference = projections_of(gaussians, camera, "inria", device)
    atoms = torch.tensor([[3, 0, 3, 2, 3], [0, 0, 0, 0, 0]], dtype=torch.uint8)
    kinds = torch.tensor([[0.5, 0.0, 0.25, 1.0, 0.125], [0.0, 0.0, 0.25, 1.0, 0.125]])
    numbers = torch.arange(len(gaussians))
    indices, weights = atoms[numbers % 2][:, None], kinds[numbers // 2 % 2][:, None]
    sure = sure_pixels(gaussians, camera)
    for dtype in (torch.float16, torch.float32):
        expected = raster.render_codes(reference, indices, weights.to(dtype), 4)
        found = raster.render_codes(projection, indices.to(device), weights.to(device, dtype), 4).cpu()
        assert bool((expected[..., 3] > 0).any())
        assert_close(found.movedim(0, 2), expected.movedim(0, 2), 2.0, sure)


def check_build(rounds: int, device: str) -> None:
    """A whole build gives the field that the reference gives."""
    from scoup.uplift import build, build_settings

    gaussians, cameras, regions = small_scene(count=60, views=2, width=16, height=9, regions=4, dim=8)
    settings = build_settings("default", n_atoms=6, k=2, rounds=rounds)
    fields = [
        build(there, cameras, regions, settings=replace(settings, backend=backend))
        for there, backend in ((gaussians.to(device), "triton"), (gaussians, "reference"))
    ]
    found, expected = fields
    assert found.code_weights.device.type == device
    assert found.info.provenance["settings"] == expected.info.provenance["settings"]
    dense = [torch.zeros(60, 3, 6) for _ in fields]
    for out, field in zip(dense, fields, strict=True):
        out.scatter_add_(2, field.code_indices.cpu().long(), field.code_weights.cpu().float())
    # A tie between atoms may turn; what is close to one is as good.
    close = (dense[0] - dense[1]).abs().amax((1, 2)) < 2e-3
    assert float(close.float().mean()) > 0.95


SMALL_CHECKS = (
    check_kinds_of_labels, check_few_sums_at_a_time, check_nothing_painted, check_split, check_repeated_atoms,
)  # fmt: skip
