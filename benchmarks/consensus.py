"""Consensus before coding: seconds, memory, and what it adds to the exact coding of the same regions.

    python -m benchmarks.consensus [--regions 60000 --gaussians 1000000 --views 200 --nonzeros 50] [--threads 1]
        [--repeats 1] [--out FILE.json]

One level of a synthetic scene without pictures: Gaussians lie on a surface, objects are its Voronoi cells, each view
sees a part of it, and its regions are the cells drawn anew with moved centres. Gaussians at a border are painted by
both cells, and one in a thousand is a floater that many regions of a view see. Embeddings are those of the object with
noise, some of another object; the last line says what the consensus made of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any, TypeVar

import numpy as np
import torch
import tyro
from scipy.spatial import KDTree
from torch import Tensor

import scoup
from benchmarks.lerf_sized import peak_memory
from benchmarks.raster import report
from scoup.bench import describe_environment, markdown, write_json
from scoup.bench.environment import in_one_line
from scoup.bench.measure import Stopwatch, torch_threads
from scoup.io import check_output
from scoup.raster import ViewSums
from scoup.uplift.consensus import ConsensusSettings, consensus_of, covisible
from scoup.uplift.region_sums import RegionSums

FLOATERS = 0.001  # share of the Gaussians
FLOATER_REGIONS = 12  # of a view
BORDER = 0.15  # Gaussians so near to two centres, in cells, are painted by both
JITTER = 0.1  # of the centres in a view, in cells
STACK, MATRIX, WHOLE, CODING = "stack the sums", "M alone", "consensus: M and rounds", "exact coding"

Result = TypeVar("Result")


@dataclass(frozen=True)
class Arguments:
    regions: int = 6000
    """About how many regions, R."""
    gaussians: int = 100_000
    """N."""
    views: int = 60
    """Views."""
    nonzeros: int = 30
    """About how many regions a Gaussian paints."""
    dim: int = 512
    """D."""
    wrong: float = 0.1
    """Share of the regions that have the embedding of another object."""
    most: int = ConsensusSettings.most
    """Entries kept of a row of M."""
    rounds: int = ConsensusSettings.rounds
    """Rounds."""
    repeats: int = 1
    """Interleaved repetitions; medians are printed."""
    coding: bool = True
    """Code the regions too (solver "exact"), for the ratio."""
    threads: int = 1
    """Threads of the coding; the consensus uses one."""
    seed: int = 0
    """Of everything."""
    out: Path | None = None
    """Where to write the figures as JSON."""
    overwrite: bool = False
    """Replace OUT."""


def main(arguments: Arguments) -> dict[str, Any]:
    """Make the sums, measure, print the table, give the record."""
    if arguments.out is not None:
        check_output(arguments.out, arguments.overwrite)
    environment = describe_environment()
    settings = ConsensusSettings(rounds=arguments.rounds, most=arguments.most)
    sums, objects = surface_sums(
        arguments.gaussians, arguments.regions, arguments.views, arguments.nonzeros, arguments.seed
    )
    rows, truth = embeddings_of(objects, arguments.dim, arguments.wrong, arguments.seed)
    before = peak_memory()
    timed = Stopwatch()
    with torch_threads(arguments.threads):
        matrix = timed(STACK, sums.matrix, 0)
        shares = timed(MATRIX, covisible, matrix, settings, report)
        agreed = timed(WHOLE, consensus_of, matrix, rows, settings, report)
        memory = peak_memory()
        if arguments.coding:
            timed(CODING, scoup.fit_codes, rows, solver="exact", progress=report)
        for _ in range(arguments.repeats - 1):
            timed(STACK, sums.matrix, 0)
            timed(MATRIX, covisible, matrix, settings, report)
            timed(WHOLE, consensus_of, matrix, rows, settings, report)
            if arguments.coding:
                timed(CODING, scoup.fit_codes, rows, solver="exact", progress=report)
    seconds = {name: median(values) for name, values in timed.seconds.items()}
    whole = seconds[STACK] + seconds[WHOLE]
    painted = np.diff(matrix.indptr).astype(np.float64)
    record: dict[str, Any] = {
        "what": "benchmarks.consensus: consensus before coding, one level",
        "machine": environment,
        "settings": {
            name: getattr(arguments, name)
            for name in ("views", "dim", "wrong", "most", "rounds", "repeats", "threads", "seed")
        },
        "gaussians": arguments.gaussians,
        "regions": len(rows),
        "nonzeros_of_sums": int(matrix.nnz),
        "multiplications": float((painted**2).sum()),
        "entries_of_m": int(shares.nnz),
        "mass_kept": float(shares.sum()) / max(1, int((np.diff(shares.indptr) > 0).sum())),
        "seconds": seconds,
        "all_seconds": timed.seconds,
        "over_exact_coding": whole / seconds[CODING] if arguments.coding else None,
        "peak_memory_bytes": memory,
        "peak_memory_before_bytes": before,
        "cosine_to_truth_before": float((rows * truth).sum(1).mean()),
        "cosine_to_truth_after": float((agreed * truth).sum(1).mean()),
    }
    print_table(record)
    if arguments.out is not None:
        write_json(arguments.out, record, arguments.overwrite)
    return record


def print_table(record: dict[str, Any]) -> None:
    """For people."""
    print(in_one_line(record["machine"]))
    count, nonzeros, entries = record["regions"], record["nonzeros_of_sums"], record["entries_of_m"]
    print(
        f"{record['gaussians']:,} Gaussians, {count:,} regions in {record['settings']['views']} views, "
        f"{nonzeros:,} non-zeros ({nonzeros / record['gaussians']:.1f} a Gaussian), "
        f"{record['multiplications'] / 1e6:,.0f} M multiplications, {entries:,} entries of M kept "
        f"({entries / count:.0f} a region, {100 * record['mass_kept']:.1f} % of the mass)\n"
    )
    print(
        markdown(["part", "seconds"], [[name, f"{value:.2f}"] for name, value in record["seconds"].items()])
    )
    if record["over_exact_coding"] is not None:
        print(f"\nstacking and consensus over exact coding: {record['over_exact_coding']:.2f}")
    if record["peak_memory_bytes"] is not None:
        print(
            f"peak memory {record['peak_memory_bytes'] / 1e9:.2f} GB, "
            f"{record['peak_memory_before_bytes'] / 1e9:.2f} GB of it before (torch, triplets of the views, embeddings)"
        )
    print(
        f"mean cosine to the object's own embedding: {record['cosine_to_truth_before']:.3f} -> "
        f"{record['cosine_to_truth_after']:.3f}"
    )


def surface_sums(
    n_gaussians: int, n_regions: int, n_views: int, nonzeros: int, seed: int
) -> tuple[RegionSums, Tensor]:
    """Region sums of one level, and the object [R] int64 of each region; view by view."""
    rng = np.random.default_rng(seed)
    points = rng.random((n_gaussians, 2), dtype=np.float32)  # the surface is a torus of area 1
    share = min(1.0, nonzeros / (1.25 * n_views))  # of the surface that a view sees
    centres = rng.random((max(1, round(n_regions / n_views / share)), 2))
    cell = len(centres) ** -0.5
    floating = rng.random(n_gaussians) < FLOATERS
    sums = RegionSums("", torch.arange(n_gaussians), ["s"])
    places: dict[str, slice] = {}
    objects: list[np.ndarray] = []
    start = 0
    for number in range(n_views):
        middle = rng.random(2)
        near = [_around(middle, places_) for places_ in (points, centres)]
        seen, cells = (np.flatnonzero((np.abs(rel) < share**0.5 / 2).all(1)) for rel in near)
        if not len(cells):
            cells = np.array([np.abs(near[1]).sum(1).argmin()])
        moved = near[1][cells] + rng.normal(size=(len(cells), 2)) * (JITTER * cell)
        distance, nearest = KDTree(moved).query(near[0][seen], k=min(2, len(cells)))
        distance, nearest = distance.reshape(len(seen), -1), nearest.reshape(len(seen), -1)
        weight = np.exp(rng.normal(size=len(seen)))
        parts = [(seen, nearest[:, 0], weight)]
        if len(cells) > 1:
            inside = (distance[:, 1] - distance[:, 0]) / (BORDER * cell)
            border = np.flatnonzero(inside < 1)
            parts.append((seen[border], nearest[border, 1], (weight * 0.5 * (1 - inside))[border]))
        many = min(FLOATER_REGIONS, len(cells))
        floaters = seen[floating[seen]]
        random = rng.integers(len(cells), size=(len(floaters), many)) if many else np.zeros((0, 0), np.int64)
        parts.append((np.repeat(floaters, many), random.ravel(), rng.random(random.size)))
        gaussian, key, values = (torch.from_numpy(np.concatenate(part)) for part in zip(*parts, strict=True))
        name = f"view {number}"
        level = torch.zeros_like(key)
        sums.append(name, ViewSums.of_triplets(gaussian, level, key, values.float() + 1e-6, 1))
        places[name] = slice(start, start + len(cells))
        start += len(cells)
        objects.append(cells)
    sums.rows = [places]
    return sums, torch.from_numpy(np.concatenate(objects))


def _around(middle: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Positions on the torus relative to one, in -0.5 .. 0.5."""
    return (positions - middle.astype(positions.dtype) + 0.5) % 1 - 0.5


def embeddings_of(objects: Tensor, dim: int, wrong: float, seed: int) -> tuple[Tensor, Tensor]:
    """CLIP-like unit rows [R, D] of regions of these objects [R], and the truth [R, D], without noise or errors."""
    generator = torch.Generator().manual_seed(seed)
    common = torch.randn(dim, generator=generator)
    own = torch.nn.functional.normalize(
        torch.randn(int(objects.max()) + 1, dim, generator=generator) * 0.85 + common, dim=1
    )
    other = objects[torch.randperm(len(objects), generator=generator)]
    told = torch.where(torch.rand(len(objects), generator=generator) < wrong, other, objects)
    noise = torch.randn(len(objects), dim, generator=generator).mul_(0.38 * dim**-0.5)
    return torch.nn.functional.normalize(noise.add_(own[told]), dim=1), own[objects]


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
