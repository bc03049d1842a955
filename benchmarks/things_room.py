"""What things cost in a large scene: the random room, whose views all see the same simulated things."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from statistics import median

import numpy as np
import torch
from scipy.spatial import KDTree
from torch import Tensor

import scoup
from benchmarks.study import Record, report
from scoup import raster
from scoup.field.part_sizes import part_sizes
from scoup.models.words import CANONICAL_PHRASES, EVERYDAY_WORDS
from scoup.query.things import thing_fits
from scoup.scene.cameras import Camera, Cameras
from scoup.scene.gaussians import Gaussians
from scoup.scene.regions import LEVELS, RegionMap, Regions
from scoup_lab.bench import StageClock, random_scene_cameras, random_scene_gaussians, torch_threads
from scoup_lab.bench.measuring import Meter
from scoup_lab.synthetic.random_scene import CELLS, clip_like

COARSE = 8  # pixels of a side of the squares that regions consist of
DIM = 512
NOISE = 0.6  # of the embedding of a region, in units of what tells its thing from others
ASKED = 20


def of_room(n_gaussians: int, n_views: int, size: tuple[int, int], threads: int) -> Record:
    """Return what the things of a random room cost: to build, to keep and to ask.

    Args:
        n_gaussians: N.
        n_views: views, all with regions at three levels.
        size: width and height of the views in pixels.
        threads: of the build; texts are asked with one.
    """
    gaussians, cameras = random_scene_gaussians(n_gaussians), random_scene_cameras(n_views, *size)
    cells = seen_cells(gaussians, cameras)
    regions = room_regions(cameras, cells)
    clock = StageClock(report)
    with torch_threads(threads), Meter() as meter:
        built = scoup.build(
            gaussians, cameras, regions, embedding_model="simulated", check_fit=False, progress=clock
        )
    seconds = clock.stop()
    words = list(dict.fromkeys([*CANONICAL_PHRASES, *EVERYDAY_WORDS]))
    vectors = dict(zip(words, clip_like(len(words), DIM, seed=3), strict=True))
    texts = {f"thing {number}": vector for number, vector in enumerate(_texts(cells))}
    built.text_encoder(vectors | texts)
    with torch_threads(1):
        asked = [_ask(built, text) for text in texts][1:]  # the first does not count
    fits, times, by_things = zip(*asked, strict=True)
    return {
        "things": 0 if built.thing_table is None else len(built.thing_table),
        "build_s": meter.cost.seconds,
        "things_s": seconds["things"],
        "peak_memory_bytes": meter.cost.peak_bytes,
        "bytes": bytes_per_gaussian(built),
        "answered_by_things": [sum(by_things), len(by_things)],
        "fits_ms": 1e3 * median(fits),
        "text_ms": 1e3 * median(times),
    }


def _ask(built: scoup.LanguageField, text: str) -> tuple[float, float, bool]:
    """Seconds to compare all things with a text, and to answer it; and whether things answered."""
    question = built.question(text)
    started = time.perf_counter()
    thing_fits(built, question)
    compared = time.perf_counter()
    found = built.things(question)
    return compared - started, time.perf_counter() - compared, bool(found) and found[0].number is not None


def bytes_per_gaussian(built: scoup.LanguageField) -> list[float]:
    """Return the size of a field's file without geometry, and of the numbers of things in it, over the Gaussians."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "field.scoup"
        built.save(path)
        return [path.stat().st_size / len(built), part_sizes(path).owners / len(built)]


def seen_cells(gaussians: Gaussians, cameras: Cameras, seed: int = 0) -> dict[str, Tensor]:
    """Return what each view shows of cells of space around ``CELLS`` Gaussians, [S, H, W] int32.

    H and W count squares of ``COARSE`` pixels.
    """
    rng = np.random.default_rng(seed)
    means = gaussians.means.double().numpy()
    trees = [KDTree(means[rng.choice(len(means), count, replace=False)]) for count in CELLS]
    return {camera.name: _cells_of_view(gaussians, camera, trees) for camera in cameras}


def room_regions(cameras: Cameras, cells: Mapping[str, Tensor]) -> Regions:
    """Return regions that all views agree on: the cells they show. The embedding of a region is that of its cell with
    noise of its own."""
    objects = [_objects(level) for level in range(len(LEVELS))]

    def load(name: str, level: str) -> RegionMap:
        camera, number = cameras[name], LEVELS.index(level)
        ids, labels = cells[name][number].unique(return_inverse=True)
        whole = labels.repeat_interleave(COARSE, 0).repeat_interleave(COARSE, 1)
        generator = torch.Generator().manual_seed(1000 * cameras.names.index(name) + number)
        noise = NOISE * torch.randn(len(ids), DIM, generator=generator)
        rows = torch.nn.functional.normalize(objects[number][ids] + noise, dim=1)
        return RegionMap(whole[: camera.height, : camera.width].int(), rows)

    return Regions(LEVELS, cameras.names, load)


def _cells_of_view(gaussians: Gaussians, camera: Camera, trees: list[KDTree]) -> Tensor:
    """The cell of the surface that each square shows."""
    small = camera.resized(-(-camera.width // COARSE), -(-camera.height // COARSE))
    row = small.viewmat[2]
    depth = (gaussians.means.double() @ row[:3] + row[3]).float()[:, None]
    image, alpha = raster.render_channels(raster.project(gaussians, small), depth)
    away = (image[..., 0] / alpha.clamp(min=1e-6)).double()
    v, u = torch.meshgrid(torch.arange(small.height), torch.arange(small.width), indexing="ij")
    (fx, _, cx), (_, fy, cy) = small.K[0].tolist(), small.K[1].tolist()
    seen = torch.stack([(u + 0.5 - cx) / fx, (v + 0.5 - cy) / fy, torch.ones_like(away)], 2) * away[..., None]
    points = ((seen - small.viewmat[:3, 3]) @ small.viewmat[:3, :3]).numpy()
    return torch.stack([torch.from_numpy(np.asarray(tree.query(points)[1])).int() for tree in trees])


def _objects(level: int) -> Tensor:
    """What the embeddings of a level's cells are before noise, [cells, D]."""
    generator = torch.Generator().manual_seed(0)
    common = torch.randn(DIM, generator=generator)
    return common + torch.randn(CELLS[level], DIM, generator=torch.Generator().manual_seed(1 + level))


def _texts(cells: Mapping[str, Tensor]) -> Tensor:
    """Texts that name the cells of level m which most views show, [ASKED + 1, D]."""
    views = sum(torch.bincount(seen[1].unique(), minlength=CELLS[1]) for seen in cells.values())
    assert isinstance(views, Tensor)
    named = views.argsort(descending=True, stable=True)[: ASKED + 1]
    noise = 1.5 * torch.randn(len(named), DIM, generator=torch.Generator().manual_seed(9))
    return torch.nn.functional.normalize(_objects(1)[named] + noise, dim=1)
