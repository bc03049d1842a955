"""Cities of 1 to 30 million Gaussians, and of 100 to 2,000 views, built within a limit of memory."""

from __future__ import annotations

import json
import shutil
import sys
import tempfile
import time
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

import scoup
from benchmarks.limits import run_limited
from benchmarks.scenes.city import A_BLOCK, City, street_cameras, write_city
from benchmarks.study import Record, Study
from scoup.io import write_inria_cameras
from scoup.scene.cameras import Cameras
from scoup.uplift.region_sums import RegionSums
from scoup_lab.bench import markdown
from scoup_lab.bench.measuring import timed

STAGES = ("load", "coding", "region sums", "vote", "save", "total")
"""``total`` is the whole process, from its start to its end but for the start of Python."""
VIEWS_PER_MILLION = 20  # while Gaussians and views grow, at the same sizes but the smallest
SIZES = ("anonymous", "resident", "bytes_of_sums")


@dataclass(frozen=True, kw_only=True)
class Cities(Study):
    """Build cities of more and more Gaussians and views within a limit of memory: time, memory and files.

    A city of blocks with a building each, cameras in its streets: more Gaussians are more city, not more detail. Each
    is written as a PLY of SH degree 3 with the features of its views, and built by the steps of `scoup build
    --keep-sums`, in a process of its own that is held to so many GB where the system allows it. One run each.
    """

    sizes: tuple[int, ...] = (1_000_000, 3_000_000, 10_000_000, 30_000_000)
    """Gaussians, in whole blocks of 100,000; each with ``views_of_sizes`` views."""
    views: tuple[int, ...] = (100, 300, 1000, 2000)
    """Views, each of a city of ``size_of_views`` Gaussians."""
    views_of_sizes: int = 100
    """Views while Gaussians grow."""
    size_of_views: int = 3_000_000
    """Gaussians while views grow."""
    limit: float = 16
    """GB that a build may take, with what the system caches for it."""
    threads: int = 2
    """Threads of a build."""
    folder: Path | None = None
    """Where cities and temporary files lie, each as long as it is needed; 20 GB for 30 million Gaussians."""

    def measure(self, known: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        for size in dict.fromkeys(size for _, size, _ in self._cases()):
            views = sorted({views for _, each, views in self._cases() if each == size})
            views = [count for count in views if f"{size}/{count}" not in known]
            if views:
                yield from self._build_city(size, views)

    def record(self, rows: dict[str, Any]) -> Record:
        cases = [{"grows": grows, **rows[f"{size}/{views}"]} for grows, size, views in self._cases()]
        return {"cases": cases}

    @staticmethod
    def table(record: Record) -> str:
        """Return one line per build."""
        heads = [
            *(f"{stage}, s" for stage in STAGES),
            "own memory, GB",
            "with files, GB",
            "sums, GB",
            "coded",
        ]
        rows = []
        for case in record["cases"]:
            cells = [case["grows"], f"{case['gaussians']:,}", f"{case['views']:,}"]
            cells += [f"{case['seconds'][stage]:.1f}" for stage in STAGES]
            cells += [f"{case[name] / 1e9:.2f}" for name in SIZES]
            rows.append([*cells, f"{case['coded'] / case['gaussians']:.0%}"])
        return markdown(["grows", "Gaussians", "views", *heads], rows)

    def _cases(self) -> list[tuple[str, int, int]]:
        """Return what grows, Gaussians and views."""
        both = [("both", size, VIEWS_PER_MILLION * size // 1_000_000) for size in self.sizes[1:]]
        sizes = [("gaussians", size, self.views_of_sizes) for size in self.sizes]
        return [*sizes, *(("views", self.size_of_views, views) for views in self.views), *both]

    def _build_city(self, size: int, views: list[int]) -> Iterator[tuple[str, Any]]:
        """Write a city, and build it with each number of views."""
        with tempfile.TemporaryDirectory(dir=self.folder, prefix="city-") as name:
            folder = Path(name)
            city = City(size // A_BLOCK)
            cameras = street_cameras(city, max(views))
            write_city(city, cameras, folder / "scene")
            for count in views:
                chosen = Cameras(list(cameras)[:count])
                write_inria_cameras(chosen, folder / "scene" / "cameras.json", overwrite=True)
                (folder / "temporary").mkdir()
                command = [sys.executable, "-m", "benchmarks.city", str(folder), str(self.threads)]
                environment = {"TMPDIR": str(folder / "temporary"), "OMP_NUM_THREADS": str(self.threads)}
                watched = run_limited(command, round(self.limit * 1e9), environment)
                shutil.rmtree(folder / "temporary")
                found = json.loads(watched.output)
                yield f"{size}/{count}", {"gaussians": size, "views": count, **found, **watched.memory()}


def build_here(folder: Path, threads: int) -> Record:
    """Build the city in a folder, as scoup build does; what it took."""
    torch.set_num_threads(threads)
    warnings.simplefilter("ignore", scoup.ScoupWarning)  # there are no photographs
    marks: dict[str, list[float]] = {}

    def progress(stage: str, done: int, total: int) -> None:
        marks.setdefault(stage.split()[0], []).append(time.perf_counter())

    seconds: dict[str, float] = {}
    scene, kept = folder / "scene", folder / "city.sums"
    splat = scene / "point_cloud.ply"
    shutil.rmtree(kept, ignore_errors=True)
    with timed(seconds, "total"):
        with timed(seconds, "load"):
            gaussians = scoup.load_gaussians(splat)
            cameras = scoup.load_cameras(scene)
            regions = scoup.load_regions(scene / "language_features", cameras)
        sums = RegionSums.empty(gaussians, regions.levels, path=kept)
        field = scoup.build(gaussians, cameras, regions, sums=sums, geometry_path=splat, progress=progress)
        size = sums.bytes
        with timed(seconds, "save"):
            field.save(folder / "city.scoup", overwrite=True)
    named = {"coding": "coding", "region": "region sums", "vote": "vote"}
    seconds |= {name: marks[stage][-1] - marks[stage][0] for stage, name in named.items()}
    return {
        "seconds": {stage: round(seconds[stage], 2) for stage in STAGES},
        "bytes_of_splat": splat.stat().st_size,
        "bytes_of_sums": size,
        "bytes_of_field": (folder / "city.scoup").stat().st_size,
        "coded": int(field.coded().sum()),
    }


if __name__ == "__main__":
    print(json.dumps(build_here(Path(sys.argv[1]), int(sys.argv[2]))))
