"""How the time of each stage grows with Gaussians, pixels, views, regions and levels, each with its fitted slope.

    python -m benchmarks.scaling [--backends native] [--sweeps gaussians pixels views regions levels] [--threads 1]
        [--repeats 5] [--out FILE.json]

The random scene, one view; one thing grows while the others keep their default. All sizes of a sweep are timed
interleaved and the slope is fitted by least squares to the logarithms of the medians: time ~ size ** slope. Its
spread is the standard error of that fit. `lift` (views only) is region sums and codes into the accumulators over
all views, without coding and vote.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
import tyro

from benchmarks.raster import report
from scoup.io import check_output
from scoup.scene.cameras import Cameras
from scoup.scene.codes import SparseCodes
from scoup.uplift.rasterise import region_sums
from scoup.uplift.vote import vote
from scoup_lab.bench import (
    Task,
    Workload,
    describe_environment,
    fit_slope,
    markdown,
    random_scene_cameras,
    random_scene_gaussians,
    random_scene_regions,
    random_workload,
    stage_runs,
    time_tasks,
    usable_backends,
    write_json,
)
from scoup_lab.bench.environment import in_one_line
from scoup_lab.bench.report import SPECIFICATION, milliseconds
from scoup_lab.synthetic.random_scene import REGIONS

Key = tuple[float, str]  # size, stage
Runs = dict[Key, Callable[[], object]]
VIEW = ("project", "alpha", "sums", "colors", "codes", "cosines")
LABELS = ("sums",)
LEVELS = ("sums", "codes", "cosines", "vote")


@dataclass(frozen=True)
class Arguments:
    backends: tuple[str, ...] = ()
    """Rasterisers; the fastest that works here if empty."""
    sweeps: tuple[str, ...] = ("gaussians", "pixels", "views", "regions", "levels")
    """What grows."""
    n_gaussians: int = 300_000
    """While something else grows."""
    width: int = 988
    """While something else grows, in pixels."""
    height: int = 731
    """While something else grows, in pixels."""
    sizes: tuple[int, ...] = (100_000, 200_000, 400_000, 800_000, 1_600_000, 3_000_000)
    """Numbers of Gaussians."""
    zooms: tuple[float, ...] = (0.25, 0.5, 1.0, 1.5, 2.0)
    """Factors of width and height, the view staying the same."""
    views: tuple[int, ...] = (1, 2, 4, 8, 16)
    """Numbers of views."""
    regions: tuple[int, ...] = (10, 40, 160, 640, 2560)
    """Numbers of regions of each level in a view."""
    levels: tuple[int, ...] = (1, 2, 3, 4, 6)
    """Numbers of levels, of 100 regions each."""
    threads: int = 1
    """Threads."""
    repeats: int = 5
    """Interleaved repetitions; medians are fitted."""
    out: Path | None = None
    """Where to write the figures as JSON."""
    overwrite: bool = False
    """Replace OUT."""


def main(arguments: Arguments) -> dict[str, Any]:
    """Run every sweep, print one table, give the record."""
    if arguments.out is not None:
        check_output(arguments.out, arguments.overwrite)
    for name in arguments.sweeps:
        if name not in SWEEPS:
            raise SystemExit(f"there is no sweep {name!r}; sweeps: {', '.join(SWEEPS)}")
    backends, _ = usable_backends(arguments.backends)
    if not arguments.backends:
        backends = [name for name in backends if name != SPECIFICATION][:1] or backends
    results: list[dict[str, Any]] = []
    for backend in backends:
        for sweep in arguments.sweeps:
            print(f"measuring {sweep}, {backend}", file=sys.stderr)
            results += run_sweep(sweep, backend, arguments)

    environment = describe_environment()
    print(in_one_line(environment))
    print(
        f"room of {arguments.n_gaussians:,} Gaussians, {arguments.width} x {arguments.height}, {REGIONS} regions, "
        f"{arguments.threads} threads, interleaved, medians of {arguments.repeats}, where nothing else grows\n"
    )
    headers = ["backend", "grows", "stage", "from", "to", "ms at first", "ms at last", "slope", "±"]
    body = [
        [
            item["backend"],
            item["grows"],
            item["stage"],
            f"{item['sizes'][0]:,.0f}",
            f"{item['sizes'][-1]:,.0f}",
            milliseconds(item["median_s"][0]),
            milliseconds(item["median_s"][-1]),
            f"{item['slope']:.2f}",
            "-" if item["standard_error"] is None else f"{item['standard_error']:.2f}",
        ]
        for item in results
    ]
    print(markdown(headers, body, left=3))
    record = {
        "what": "benchmarks.scaling: time ~ size ** slope",
        "machine": environment,
        "settings": {
            "gaussians": arguments.n_gaussians,
            "width": arguments.width,
            "height": arguments.height,
            "regions": list(REGIONS),
            "threads": arguments.threads,
            "repeats": arguments.repeats,
        },
        "slopes": results,
    }
    if arguments.out is not None:
        write_json(arguments.out, record, arguments.overwrite)
    return record


def run_sweep(sweep: str, backend: str, arguments: Arguments) -> list[dict[str, Any]]:
    """Time all sizes of one sweep and fit a slope for each stage."""
    tasks = {
        key: Task(run, arguments.threads, arguments.repeats)
        for key, run in SWEEPS[sweep](arguments, backend).items()
    }
    timings = time_tasks(tasks, progress=report)
    found = []
    for stage in dict.fromkeys(stage for _, stage in timings):
        of_stage = sorted((size, timing) for (size, name), timing in timings.items() if name == stage)
        sizes = [size for size, _ in of_stage]
        medians = [timing.median for _, timing in of_stage]
        found.append(
            {
                "backend": backend,
                "grows": sweep,
                "stage": stage,
                "sizes": sizes,
                "median_s": medians,
                "min_s": [min(timing.seconds) for _, timing in of_stage],
                "max_s": [max(timing.seconds) for _, timing in of_stage],
                **fit_slope(sizes, medians).record(),
            }
        )
    return found


def grow_gaussians(arguments: Arguments, backend: str) -> Runs:

    works = ((count, random_workload(count, arguments.width, arguments.height)) for count in arguments.sizes)
    return _runs(works, backend, (*VIEW, "vote"))


def grow_pixels(arguments: Arguments, backend: str) -> Runs:
    room = random_scene_gaussians(arguments.n_gaussians)

    works = []
    for zoom in arguments.zooms:
        width, height = round(arguments.width * zoom), round(arguments.height * zoom)
        work = random_workload(len(room), width, height, gaussians=room)
        works.append((width * height, work))
    return _runs(works, backend, VIEW)


def grow_regions(arguments: Arguments, backend: str) -> Runs:
    room = random_scene_gaussians(arguments.n_gaussians)

    size = (arguments.width, arguments.height)
    works = (
        (count, random_workload(len(room), *size, [count] * len(REGIONS), gaussians=room))
        for count in arguments.regions
    )
    return _runs(works, backend, LABELS)


def grow_levels(arguments: Arguments, backend: str) -> Runs:
    room = random_scene_gaussians(arguments.n_gaussians)
    size = (arguments.width, arguments.height)
    works = (
        (count, random_workload(len(room), *size, [100] * count, gaussians=room))
        for count in arguments.levels
    )
    return _runs(works, backend, LEVELS)


def grow_views(arguments: Arguments, backend: str) -> Runs:
    most = max(arguments.views)
    room = random_scene_gaussians(arguments.n_gaussians)
    cameras = random_scene_cameras(most, arguments.width, arguments.height)
    regions = random_scene_regions(cameras, dim=8)  # embeddings play no part here
    generator = torch.Generator().manual_seed(0)
    codebook = torch.randn(len(REGIONS), 64, 8, generator=generator)

    def lift(count: int) -> None:
        chosen = Cameras(list(cameras)[:count])
        sums = region_sums(room, chosen, regions.select(chosen.names), backend=backend)
        codes = [
            SparseCodes.from_dense(torch.rand(each * count, 64, generator=generator), 4) for each in REGIONS
        ]
        vote(sums, codes, codebook, backend=backend)

    return {(count, "lift"): lambda count=count: lift(count) for count in arguments.views}


SWEEPS: dict[str, Callable[[Arguments, str], Runs]] = {
    "gaussians": grow_gaussians,
    "pixels": grow_pixels,
    "views": grow_views,
    "regions": grow_regions,
    "levels": grow_levels,
}


def _runs(works: Iterable[tuple[float, Workload]], backend: str, stages: tuple[str, ...]) -> Runs:
    """Stage by stage, all sizes next to each other."""
    by_size = {size: stage_runs(work, backend, stages) for size, work in works}
    return {(size, stage): by_size[size][stage] for stage in stages for size in by_size}


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
