"""Random scenes and cameras shared by the tests."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import torch
from hypothesis import strategies as st

from scoup.field import NO_THING, Field, ThingTable
from scoup.query import LanguageField
from scoup.scene import LEVELS, Camera, Cameras, Gaussians, RegionMap, Regions


def examples(full: int) -> int:
    """How many examples a test tries: a quarter of ``full``; all of them in ``make test-all``."""
    return full if os.environ.get("SCOUP_TEST_EXAMPLES") == "all" else max(5, full // 4)


@contextmanager
def threads_of_torch(count: int) -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


OPACITIES = ("opacity 0", "opacity 1", "opacity inf")
KINDS = ("plain", "behind", "huge", "needle", *OPACITIES, "nan", "tiny", "zero quat")
SCALES = {"huge": [50.0, 80.0, 20.0], "needle": [2.0, 1e-5, 1e-5], "tiny": [1e-9] * 3}


def random_gaussians(
    count: int, seed: int, kinds: tuple[str, ...] = ("plain",), degree: int = 0
) -> Gaussians:
    """``count`` Gaussians in front of the default camera, each of a kind drawn from ``kinds``."""
    generator = torch.Generator().manual_seed(seed)
    means = torch.randn(count, 3, generator=generator) * torch.tensor([1.0, 0.8, 0.7])
    means[:, 2] += 4.0
    quats = torch.nn.functional.normalize(torch.randn(count, 4, generator=generator), dim=1)
    scales = torch.exp(torch.randn(count, 3, generator=generator) * 0.7 - 2.0)
    opacities = torch.rand(count, generator=generator)
    sh = torch.randn(count, (degree + 1) ** 2, 3, generator=generator) * 0.4
    picks = torch.randint(len(kinds), (count,), generator=generator).tolist()
    for row, kind in enumerate(kinds[pick] for pick in picks):
        if kind == "behind":
            means[row, 2] *= -1
        elif kind == "nan":
            [means, quats, scales][row % 3][row, row % 3] = math.nan
        elif kind == "zero quat":
            quats[row] = 0
        elif kind in SCALES:
            scales[row] = torch.tensor(SCALES[kind])
        elif kind.startswith("opacity "):
            opacities[row] = float(kind.removeprefix("opacity "))
    return Gaussians(means, quats, scales, opacities, sh)


def make_camera(
    width: int = 40, height: int = 30, focal: float = 36.0, seed: int | None = None, **changes
) -> Camera:
    """A camera at the origin looking along +z; with ``seed`` its principal point and pose are shaken."""
    viewmat = torch.eye(4, dtype=torch.float64)
    cx, cy = width / 2, height / 2
    if seed is not None:
        generator = torch.Generator().manual_seed(seed)
        angles = (torch.rand(3, generator=generator, dtype=torch.float64) - 0.5) * 0.3
        for axis, angle in enumerate(angles.tolist()):
            turn = torch.eye(4, dtype=torch.float64)
            a, b = [(1, 2), (0, 2), (0, 1)][axis]
            turn[a, a] = turn[b, b] = math.cos(angle)
            turn[a, b], turn[b, a] = -math.sin(angle), math.sin(angle)
            viewmat = turn @ viewmat
        shift = (torch.rand(5, generator=generator, dtype=torch.float64) - 0.5).tolist()
        viewmat[:3, 3] = torch.tensor(shift[:3], dtype=torch.float64)
        cx, cy = cx + shift[3] * width * 0.3, cy + shift[4] * height * 0.3
    K = torch.tensor([[focal, 0, cx], [0, focal * 1.1, cy], [0, 0, 1]], dtype=torch.float64)
    return Camera(changes.pop("name", "view.png"), viewmat, K, width, height, **changes)


@st.composite
def scenes(draw: st.DrawFn, max_count: int = 40) -> tuple[Gaussians, Camera]:
    """Random scenes, ugly Gaussians included, with a random small camera (down to one pixel)."""
    kinds = tuple(draw(st.lists(st.sampled_from(KINDS), min_size=1, max_size=len(KINDS), unique=True)))
    count = draw(st.integers(0, max_count))
    gaussians = random_gaussians(count, draw(st.integers(0, 2**31)), (*kinds, "plain"))
    width, height = draw(st.integers(1, 45)), draw(st.integers(1, 37))
    focal = draw(st.sampled_from([12.0, 36.0, 150.0]))
    return gaussians, make_camera(width, height, focal, draw(st.integers(0, 2**31)))


def random_labels(levels: int, height: int, width: int, regions: int, seed: int) -> torch.Tensor:
    """[S, H, W] int32 labels in blocks, -1 included."""
    generator = torch.Generator().manual_seed(seed)
    coarse = torch.randint(-1, regions, (levels, height // 5 + 1, width // 5 + 1), generator=generator)
    fine = coarse.repeat_interleave(5, 1).repeat_interleave(5, 2)[:, :height, :width]
    return fine.int().contiguous()


def small_scene(
    count: int = 150,
    views: int = 4,
    width: int = 40,
    height: int = 30,
    regions: int = 6,
    dim: int = 16,
    seed: int = 0,
) -> tuple[Gaussians, Cameras, Regions]:
    """Random Gaussians seen by a few cameras, with random blocks of regions at three levels."""
    gaussians = random_gaussians(count, seed)
    cameras = Cameras(
        make_camera(width, height, seed=seed + i, name=f"view_{i:02d}.png") for i in range(views)
    )
    generator = torch.Generator().manual_seed(seed)
    maps = {}
    for number, camera in enumerate(cameras):
        labels = random_labels(len(LEVELS), height, width, regions, seed * 100 + number)
        maps[camera.name] = {
            level: RegionMap(labels[s], unit(torch.randn(regions, dim, generator=generator)))
            for s, level in enumerate(LEVELS)
        }
    return gaussians, cameras, Regions.from_maps(maps)


def changed_regions(regions: Regions, change: Callable[[str, str, RegionMap], RegionMap]) -> Regions:
    """Other maps in place of the map of each view and level."""

    def load(name: str, level: str) -> RegionMap:
        return change(name, level, regions.load(name, level))

    return Regions(regions.levels, regions.view_names, load)


def gaussians_at(means: torch.Tensor, scale: float = 0.01, opacity: float = 0.9) -> Gaussians:
    """Small round Gaussians without a colour at these places."""
    count = len(means)
    quats = torch.tensor([[1.0, 0, 0, 0]]).repeat(count, 1)
    opacities = torch.full((count,), opacity)
    return Gaussians(means.float(), quats, torch.full((count, 3), scale), opacities, torch.zeros(count, 1, 3))


def things_of(
    owners: torch.Tensor, levels: torch.Tensor, embeddings: torch.Tensor, **parts: Any
) -> ThingTable:
    """A table of things without parents, alike but for what is given."""
    count = len(levels)
    given = {
        "parents": torch.full((count,), NO_THING, dtype=torch.int32), "agreement": torch.full((count,), 0.99),
        "n_regions": torch.full((count,), 9, dtype=torch.int32), "mass": torch.ones(count),
        "stability": torch.ones(count), **parts,
    }  # fmt: skip
    return ThingTable(owners.int(), levels.to(torch.uint8), embeddings=embeddings.half(), **given)


def table_of(field: Field) -> ThingTable:
    """The things of a field that has some."""
    assert field.thing_table is not None
    return field.thing_table


def altered(field: Field, **parts: Any) -> LanguageField:
    """The field with other parts, without its encoder, to be asked."""
    given = {
        "code_indices": field.code_indices, "code_weights": field.code_weights, "codebook": field.codebook,
        "info": field.info, "gaussians": field.gaussians if field.has_geometry else None,
        "cameras": field.cameras, "thing_table": field.thing_table,
    }  # fmt: skip
    return LanguageField(**{**given, **parts})


def unit(rows: torch.Tensor) -> torch.Tensor:
    return torch.nn.functional.normalize(rows, dim=-1)
