"""Cities of 1 to 30 million Gaussians, and of 100 to 2,000 views, built within a limit of memory: time and memory.

    python -m benchmarks.city [--sizes 1000000 3000000 10000000 30000000] [--views 100 300 1000 2000] [--limit 16]
        [--threads 2] [--folder FOLDER] [--out FILE.json]

A city of blocks with a building each (``benchmarks/scenes/city.py``), cameras in its streets: more Gaussians are more
city, not more detail. Each is written to FOLDER as a PLY of SH degree 3 with the features of its views, and built by
the steps of `scoup build --keep-sums`, in a process of its own that is held to so many GB where the system allows it.
Time grows as size ** slope, fitted to the logarithms by least squares. Seconds are of one run each: on an idle machine.
"""

from __future__ import annotations

import json
import shutil
import sys
import tempfile
import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
import tyro

import scoup
from benchmarks.limits import run_limited
from benchmarks.scenes.city import A_BLOCK, City, street_cameras, write_city
from scoup.io import check_output, write_inria_cameras
from scoup.scene.cameras import Cameras
from scoup.uplift.region_sums import RegionSums
from scoup_lab.bench import describe_environment, fit_slope, markdown, write_json
from scoup_lab.bench.environment import in_one_line
from scoup_lab.bench.measuring import timed

STAGES = ("load", "coding", "region sums", "vote", "save", "total")
"""``total`` is the whole process, from its start to its end but for the start of Python."""


@dataclass(frozen=True)
class Arguments:
    sizes: tuple[int, ...] = (1_000_000, 3_000_000, 10_000_000, 30_000_000)
    """Gaussians, in whole blocks of 100,000; each with ``views_of_sizes`` views."""
    views: tuple[int, ...] = (100, 300, 1000, 2000)
    """Views, each of a city of ``size_of_views`` Gaussians."""
    views_of_sizes: int = 100
    """Views while Gaussians grow."""
    size_of_views: int = 3_000_000
    """Gaussians while views grow."""
    views_per_million: int = 20
    """Views for a million Gaussians while both grow, at the same sizes but the smallest."""
    limit: float = 16
    """GB that a build may take, with what the system caches for it."""
    threads: int = 2
    """Threads of a build."""
    folder: Path | None = None
    """Where cities and temporary files lie, each as long as it is needed; 20 GB for 30 million Gaussians."""
    out: Path | None = None
    """Where to write the figures as JSON."""
    overwrite: bool = False
    """Replace OUT."""


def main(arguments: Arguments) -> dict[str, Any]:
    """Build all cities, print a table and the slopes, give the record."""
    if arguments.out is not None:
        check_output(arguments.out, arguments.overwrite)
    cases = [("gaussians", size, arguments.views_of_sizes) for size in arguments.sizes]
    cases += [("views", arguments.size_of_views, views) for views in arguments.views]
    cases += [("both", size, arguments.views_per_million * size // 1_000_000) for size in arguments.sizes[1:]]
    results: dict[tuple[int, int], dict[str, Any]] = {}
    for size in dict.fromkeys(size for _, size, _ in cases):
        views = sorted({views for _, each, views in cases if each == size})
        results |= {(size, count): found for count, found in build_city(size, views, arguments).items()}

    environment = describe_environment()
    print(in_one_line(environment))
    print(table([{"grows": case[0], **results[case[1:]]} for case in cases]))
    slopes = {}
    for grows, position in (("gaussians", 1), ("views", 2), ("both", 1)):
        chosen = [case for case in cases if case[0] == grows]
        if len(chosen) > 1:
            sizes = [float(case[position]) for case in chosen]
            slopes[grows] = _slopes(sizes, [results[case[1:]] for case in chosen])
    record = {
        "what": "benchmarks.city: time and memory ~ size ** slope",
        "machine": environment,
        "settings": {
            "limit_gb": arguments.limit,
            "threads": arguments.threads,
            "views_of_sizes": arguments.views_of_sizes,
            "size_of_views": arguments.size_of_views,
            "views_per_million": arguments.views_per_million,
            "a_block": A_BLOCK,
        },
        "cases": [{"grows": case[0], **results[case[1:]]} for case in cases],
        "slopes": slopes,
    }
    print(slope_table(slopes))
    if arguments.out is not None:
        write_json(arguments.out, record, arguments.overwrite)
    return record


def table(cases: Sequence[Mapping[str, Any]]) -> str:
    """One line a build."""
    headers = ["grows", "Gaussians", "views", *(f"{stage}, s" for stage in STAGES), "own memory, GB", "with files, GB",
               "sums, GB", "coded"]  # fmt: skip
    return markdown(headers, [[case["grows"], *_row(case)] for case in cases], left=1)


def slope_table(slopes: Mapping[str, Mapping[str, Mapping[str, float]]]) -> str:
    """Slopes, one line a curve."""
    if not slopes:
        return ""
    names = list(next(iter(slopes.values())))
    titles = {"anonymous": "own memory", "resident": "with files", "bytes_of_sums": "region sums"}
    heads = ["grows", *(titles.get(name, name) for name in names)]
    rows = [[grows, *(f"{of[name]['slope']:.2f}" for name in names)] for grows, of in slopes.items()]
    return markdown(heads, rows, left=1)


def _row(found: Mapping[str, Any]) -> list[str]:
    seconds = [f"{found['seconds'][stage]:.1f}" for stage in STAGES]
    sizes = [f"{found[name] / 1e9:.2f}" for name in ("anonymous", "resident", "bytes_of_sums")]
    share = found["coded"] / found["gaussians"]
    return [f"{found['gaussians']:,}", f"{found['views']:,}", *seconds, *sizes, f"{share:.0%}"]


def _slopes(sizes: list[float], found: list[dict[str, Any]]) -> dict[str, Any]:
    measured = {f"{stage} seconds": [each["seconds"][stage] for each in found] for stage in STAGES}
    measured |= {name: [each[name] for each in found] for name in ("anonymous", "resident", "bytes_of_sums")}
    return {name: fit_slope(sizes, values).record() for name, values in measured.items()}


def build_city(size: int, views: list[int], arguments: Arguments) -> dict[int, dict[str, Any]]:
    """Write a city, and build it with each number of views; number -> what was measured."""
    results = {}
    with tempfile.TemporaryDirectory(dir=arguments.folder, prefix="city-") as name:
        folder = Path(name)
        city = City(size // A_BLOCK)
        cameras = street_cameras(city, max(views))
        started = time.perf_counter()
        write_city(city, cameras, folder / "scene")
        print(f"{size:,} Gaussians: written in {time.perf_counter() - started:.0f} s", file=sys.stderr)
        for count in views:
            chosen = Cameras(list(cameras)[:count])
            write_inria_cameras(chosen, folder / "scene" / "cameras.json", overwrite=True)
            (folder / "temporary").mkdir()
            command = [
                sys.executable,
                "-m",
                "benchmarks.city",
                "--build",
                str(folder),
                str(arguments.threads),
            ]
            environment = {"TMPDIR": str(folder / "temporary"), "OMP_NUM_THREADS": str(arguments.threads)}
            watched = run_limited(command, round(arguments.limit * 1e9), environment)
            shutil.rmtree(folder / "temporary")
            found = json.loads(watched.output)
            results[count] = {"gaussians": size, "views": count, **found, **watched.memory()}
            print(f"{count:,} views: {found['seconds']}", file=sys.stderr)
    return results


def build_here(folder: Path, threads: int) -> dict[str, Any]:
    """Build the city in a folder, as scoup build does; what it took."""
    torch.set_num_threads(threads)
    warnings.simplefilter("ignore", scoup.ScoupWarning)  # there are no photographs
    marks: dict[str, list[float]] = {}

    def progress(stage: str, done: int, total: int) -> None:
        marks.setdefault(stage.split()[0], []).append(time.perf_counter())

    seconds: dict[str, float] = {}
    kept = folder / "city.sums"
    shutil.rmtree(kept, ignore_errors=True)
    with timed(seconds, "total"):
        with timed(seconds, "load"):
            gaussians = scoup.load_gaussians(folder / "scene" / "point_cloud.ply")
            cameras = scoup.load_cameras(folder / "scene")
            regions = scoup.load_regions(folder / "scene" / "language_features", cameras)
        sums = RegionSums.of(gaussians, regions.levels, path=kept)
        field = scoup.build(
            gaussians, cameras, regions, sums=sums, geometry_path=folder / "scene" / "point_cloud.ply",
            progress=progress,
        )  # fmt: skip
        size = sums.bytes
        with timed(seconds, "save"):
            field.save(folder / "city.scoup", overwrite=True)
    named = {"coding": "coding", "region": "region sums", "vote": "vote"}
    seconds |= {name: marks[stage][-1] - marks[stage][0] for stage, name in named.items()}
    coded = int(field.coded().sum())
    stems = {Path(camera.name).stem for camera in cameras}
    features = (folder / "scene" / "language_features").iterdir()
    of_views = [path.stat().st_size for path in features if path.name.rpartition("_")[0] in stems]
    return {
        "seconds": {stage: round(seconds[stage], 2) for stage in STAGES},
        "bytes_of_splat": (folder / "scene" / "point_cloud.ply").stat().st_size,
        "bytes_of_features": sum(of_views),
        "bytes_of_sums": size,
        "bytes_of_field": (folder / "city.scoup").stat().st_size,
        "coded": coded,
        "regions": [report["regions"] for report in field.info.provenance["coding"].values()],
    }


if __name__ == "__main__":
    if sys.argv[1:2] == ["--build"]:
        print(json.dumps(build_here(Path(sys.argv[2]), int(sys.argv[3]))))
    else:
        main(tyro.cli(Arguments, description=__doc__))
