"""What a machine can do, and what each stage of a build must at least move and calculate."""

from __future__ import annotations

import torch

from benchmarks.study import Record
from scoup import raster
from scoup.raster.native import NativeProjection, count_work
from scoup.scene.cameras import Cameras
from scoup.scene.gaussians import Gaussians
from scoup.scene.regions import Regions
from scoup.uplift.build_settings import BuildSettings
from scoup.uplift.rasterise import at_scale
from scoup_lab.bench import Stopwatch, torch_threads

REPEATS = 5  # of which the fastest counts
COPIED, SIDE = 1 << 27, 2048  # numbers that are copied, and the side of the matrices that are multiplied
SAMPLED = 4  # views that are counted; all others count alike
PREPARED, PROJECTED, PAIR, LABEL, ENTRY = 48, 64, 4, 4, 12
"""Bytes of a prepared and of a projected Gaussian, of its entry in a tile's list, of a pixel's label at one level, and
of one Gaussian's weight in one region."""
PER_PROJECTION, PER_EVALUATION = 200, 30
"""Floating-point operations of a projection (means, covariance, extent) and of a Gaussian at a pixel (offset, power,
exponential, transmittance, sum), counted in the source; a fused multiplication and addition are two."""


def machine_rates(threads: int) -> Record:
    """Return bytes a second of a copy that no cache holds, and float32 operations a second of a matrix product."""
    source, target = torch.ones(COPIED), torch.empty(COPIED)
    square = torch.ones(SIDE, SIDE)
    clock = Stopwatch()
    with torch_threads(threads):
        for _ in range(REPEATS):
            clock("copied", target.copy_, source)
            clock("multiplied", torch.matmul, square, square)
    copied, multiplied = (min(clock.seconds[name]) for name in ("copied", "multiplied"))
    return {"bytes_per_s": 2 * source.nbytes / copied, "flops_per_s": 2 * SIDE**3 / multiplied}


def least_work(
    gaussians: Gaussians, cameras: Cameras, regions: Regions, settings: BuildSettings
) -> dict[str, Record]:
    """Return the bytes and the floating-point operations that each stage cannot do without.

    Codes need at least one comparison of all embeddings with all atoms, things and votes one look at all region sums.
    Only ``SAMPLED`` views are looked at.
    """
    levels, n_atoms = len(regions.levels), settings.n_atoms
    step = max(1, len(cameras) // SAMPLED)
    views = [at_scale(cameras[number], settings.scale) for number in range(0, len(cameras), step)][:SAMPLED]
    prepared = raster.prepare_gaussians(gaussians, "native")
    moved = calculated = entries = rows = 0
    for camera in views:
        maps = [regions.load(camera.name, level) for level in regions.levels]
        projection = raster.project(prepared, camera, settings.raster_preset)
        assert isinstance(projection, NativeProjection)
        work = count_work(projection)
        sums = raster.region_sums(projection, regions.load_labels(camera.name, camera.width, camera.height))
        found = sum(len(sums.triplets(level)[0]) for level in range(levels))
        seen = int(sums.gaussian.unique().numel())
        moved += len(gaussians) * PREPARED + seen * PROJECTED + work["pairs"] * PAIR + found * ENTRY
        moved += camera.width * camera.height * levels * LABEL
        calculated += seen * PER_PROJECTION + work["evaluations"] * PER_EVALUATION
        entries += found
        rows += sum(len(each.embeddings) for each in maps)
    scale = len(cameras) / len(views)
    dim = regions.load(views[0].name, regions.levels[0]).embeddings.shape[1]
    n_rows, n_entries = scale * rows, scale * entries
    codes = len(gaussians) * levels * settings.k * 3
    return {
        "coding": {"bytes": n_rows * dim * 4, "flops": n_rows * dim * n_atoms * 2},
        "region sums": {"bytes": scale * moved, "flops": scale * calculated},
        "things": {"bytes": n_entries * ENTRY + n_rows * dim * 4, "flops": 2 * n_entries},
        "vote": {"bytes": n_entries * ENTRY + codes, "flops": 2 * n_entries * settings.k},
    }
