"""The whole build of a scene as large as those of LERF: 1M Gaussians, 200 views of 988 x 731, three levels.

    python -m benchmarks.lerf_sized [--n-gaussians 1000000] [--views 200] [--solver NAME] [--threads 2]
        [--backend NAME] [--out FILE.json]

The random scene with simulated regions and embeddings: times mean something, answers do not. From Gaussians,
cameras and regions in memory to the field in memory: coding, uplift and vote. The paper names 42 s on an RTX A6000,
coding included.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

import scoup
from benchmarks.raster import report
from scoup.io import check_output
from scoup.uplift.build_settings import build_settings
from scoup_lab.bench import (
    StageClock,
    describe_environment,
    markdown,
    random_scene_cameras,
    random_scene_gaussians,
    random_scene_regions,
    usable_backends,
    write_json,
)
from scoup_lab.bench.environment import in_one_line
from scoup_lab.bench.measure import torch_threads
from scoup_lab.synthetic.random_scene import HEIGHT, REGIONS, WIDTH, Order

PAPER_SECONDS = 42.0


@dataclass(frozen=True)
class Arguments:
    n_gaussians: int = 1_000_000
    """Of the room."""
    views: int = 200
    """Views, each with regions."""
    width: int = WIDTH
    """Of the views, in pixels."""
    height: int = HEIGHT
    """Of the views, in pixels."""
    regions: tuple[int, ...] = REGIONS
    """Regions in a view at levels s, m, l."""
    order: Order = "random"
    """Of the rows; trained scenes have none."""
    preset: str = "default"
    """Settings of the build: "default" or "paper"; those below, where given, override it."""
    solver: str | None = None
    """How codes are learned, see `scoup build`."""
    epochs: int | None = None
    """Epochs of the "adam" solver."""
    n_atoms: int | None = None
    """L."""
    rounds: int | None = None
    """Rounds of the vote."""
    k: int | None = None
    """K."""
    effort: str | None = None
    """How long the exact solver learns, see `scoup build`."""
    backend: str | None = None
    """Rasteriser; the fastest by default."""
    threads: int = 2
    """Threads."""
    seed: int = 0
    """Of everything."""
    out: Path | None = None
    """Where to write the figures as JSON."""
    overwrite: bool = False
    """Replace OUT."""


def main(arguments: Arguments) -> dict[str, Any]:
    """Make the scene, build, print the table, give the record."""
    if arguments.out is not None:
        check_output(arguments.out, arguments.overwrite)
    if arguments.backend is not None:
        usable_backends([arguments.backend])
    environment = describe_environment()
    started = time.perf_counter()
    gaussians = random_scene_gaussians(arguments.n_gaussians, arguments.seed, arguments.order)
    cameras = random_scene_cameras(arguments.views, arguments.width, arguments.height)
    regions = random_scene_regions(cameras, arguments.regions, seed=arguments.seed)
    preparing = time.perf_counter() - started
    backend = scoup.raster.project(random_scene_gaussians(8), cameras[0], backend=arguments.backend).backend
    before = peak_memory()

    settings = build_settings(
        arguments.preset,
        n_atoms=arguments.n_atoms,
        k=arguments.k,
        effort=arguments.effort,
        rounds=arguments.rounds,
        solver=arguments.solver,
        epochs=arguments.epochs,
        seed=arguments.seed,
    )
    clock = StageClock(report)
    with torch_threads(arguments.threads):
        started = time.perf_counter()
        field = scoup.build(
            gaussians,
            cameras,
            regions,
            settings=settings,
            embedding_model="simulated",
            backend=arguments.backend,
            progress=clock,
        )
        total = time.perf_counter() - started
    seconds = clock.stop()
    memory = peak_memory()

    print(in_one_line(environment))
    print(
        f"{arguments.n_gaussians:,} Gaussians, {arguments.views} views of {arguments.width} x {arguments.height}, "
        f"{arguments.regions} regions a view,\n"
        f"preset {arguments.preset}, solver {settings.solver}, {settings.n_atoms} atoms, {settings.rounds} rounds, "
        f"backend {backend}, {arguments.threads} threads\n"
    )
    names = {"start": "stack embeddings, fingerprint", "after vote": "field"}
    body = [[names.get(stage, stage), f"{value:.2f}"] for stage, value in seconds.items() if value >= 0.005]
    per_view = seconds["region sums"] / arguments.views
    body += [["total", f"{total:.2f}"], ["paper, RTX A6000", f"{PAPER_SECONDS:.0f}"]]
    print(markdown(["stage", "seconds"], body))
    print(
        f"\nregion sums of one view: {1e3 * per_view:.0f} ms; "
        f"making the scene took {preparing:.1f} s and is not counted"
    )
    if memory is not None and before is not None:
        print(
            f"peak memory {memory / 1e9:.2f} GB, {before / 1e9:.2f} GB of it before the build (torch, scene)"
        )
    record = {
        "what": "benchmarks.lerf_sized: the whole build",
        "machine": environment,
        "settings": {
            "gaussians": arguments.n_gaussians,
            "views": arguments.views,
            "width": arguments.width,
            "height": arguments.height,
            "regions": list(arguments.regions),
            "order": arguments.order,
            "preset": arguments.preset,
            "solver": settings.solver,
            "epochs": settings.epochs if settings.solver == "adam" else None,
            "atoms": settings.n_atoms,
            "k": settings.k,
            "rounds": settings.rounds,
            "backend": backend,
            "threads": arguments.threads,
            "seed": arguments.seed,
        },
        "seconds": seconds,
        "total_s": total,
        "region_sums_of_a_view_s": per_view,
        "paper_s": PAPER_SECONDS,
        "coded_gaussians": int(field.coded().sum()),
        "coding": field.info.provenance["coding"],
        "peak_memory_bytes": memory,
        "peak_memory_before_build_bytes": before,
    }
    if arguments.out is not None:
        write_json(arguments.out, record, arguments.overwrite)
    return record


def peak_memory() -> int | None:
    """Most resident memory of this process so far, in bytes; None where the system does not tell."""
    try:
        import resource
    except ImportError:
        return None
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most if sys.platform == "darwin" else most * 1024


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
