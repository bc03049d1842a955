"""What kept region sums give: other embeddings, atoms, rounds without rasterising, and what smaller sums cost.

    python -m benchmarks.kept_sums [--n-gaussians 1000000] [--views 200] [--threads 1] [--data DATA] [--no-kitchen]
        [--out FILE.json]

On the random scene, and on `kitchen` where DATA has it. Seconds are the processor's, coding included. Agreement: the
share of codes with the same atoms as from float32 sums of which nothing was left out, counted alike and by how much
each Gaussian paints, and the mean difference of weights where the atoms are the same.
"""

from __future__ import annotations

import dataclasses
import shutil
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
import tyro

import scoup
from benchmarks.data import data_folder, make_features
from benchmarks.raster import report
from scoup.io import check_output
from scoup.scene.cameras import Cameras
from scoup.scene.gaussians import Gaussians
from scoup.scene.regions import Regions
from scoup.uplift.build import build
from scoup.uplift.build_settings import BuildSettings
from scoup.uplift.region_sums import RegionSums
from scoup_lab.bench import (
    describe_environment,
    markdown,
    random_scene_cameras,
    random_scene_gaussians,
    random_scene_regions,
    write_json,
)
from scoup_lab.bench.environment import in_one_line
from scoup_lab.bench.measure import Stopwatch, torch_threads
from scoup_lab.synthetic.random_scene import HEIGHT, REGIONS, WIDTH

CHANGES: dict[str, dict[str, Any]] = {
    "same settings": {},
    "64 atoms": {"n_atoms": 64},
    "K = 2": {"k": 2, "keep": 2},
    "another seed": {"seed": 1},
    "one round": {"rounds": 1},
    "three rounds": {"rounds": 3},
}
SMALLER: dict[str, dict[str, Any]] = {
    "float32": {},
    "float16": {"weights": "float16"},
    "least weight 0.001": {"least_weight": 0.001},
    "least weight 0.01": {"least_weight": 0.01},
    "float16, least weight 0.01": {"weights": "float16", "least_weight": 0.01},
}


@dataclass(frozen=True)
class Arguments:
    n_gaussians: int = 1_000_000
    """Of the room."""
    views: int = 200
    """Of the room."""
    width: int = WIDTH
    """Of the room's views, in pixels."""
    height: int = HEIGHT
    """Of the room's views, in pixels."""
    regions: tuple[int, ...] = REGIONS
    """Regions in a view, at levels s, m, l."""
    threads: int = 1
    """Threads."""
    data: Path = field(default_factory=data_folder)
    """Folder that holds kitchen/."""
    kitchen: bool = True
    """Measure the kitchen, too, where it is there."""
    out: Path | None = None
    """Where to write the figures as JSON."""
    overwrite: bool = False
    """Replace OUT."""


@dataclass(frozen=True, eq=False)
class Scene:
    """What is built."""

    name: str
    gaussians: Gaussians
    cameras: Cameras
    regions: Regions
    others: Regions | None  # with other embeddings


def main(arguments: Arguments) -> dict[str, Any]:
    """Measure, print the tables, give the record."""
    if arguments.out is not None:
        check_output(arguments.out, arguments.overwrite)
    environment = describe_environment()
    print(in_one_line(environment))
    record: dict[str, Any] = {
        "what": "benchmarks.kept_sums",
        "machine": environment,
        "settings": {
            name: getattr(arguments, name) for name in ("n_gaussians", "views", "width", "height", "threads")
        },
        "scenes": {},
    }
    with torch_threads(arguments.threads), tempfile.TemporaryDirectory() as folder:
        for scene in scenes(arguments, Path(folder)):
            record["scenes"][scene.name] = measure(scene, Path(folder))
    if arguments.out is not None:
        write_json(arguments.out, record, arguments.overwrite)
    return record


def scenes(arguments: Arguments, folder: Path) -> Iterator[Scene]:
    """One after the other: they are large."""
    cameras = random_scene_cameras(arguments.views, arguments.width, arguments.height)
    regions, others = (random_scene_regions(cameras, arguments.regions, seed=seed) for seed in (0, 1))
    # The label maps of one seed with the embeddings of another: as a second model would give them.
    swapped = Regions(regions.levels, regions.view_names, regions.load, others.load_embeddings)
    yield Scene("room", random_scene_gaussians(arguments.n_gaussians), cameras, regions, swapped)
    kitchen = arguments.data / "kitchen"
    if arguments.kitchen and kitchen.is_dir():
        cameras = scoup.load_cameras(kitchen)
        regions = scoup.load_regions(make_features(kitchen, folder), cameras)
        yield Scene(
            "kitchen", scoup.load_gaussians(kitchen / "scene" / "model.splat"), cameras, regions, None
        )


def measure(scene: Scene, folder: Path) -> dict[str, Any]:
    """All figures of a scene."""
    found: dict[str, Any] = {"gaussians": len(scene.gaussians), "views": len(scene.regions)}
    whole, smaller = folder / f"{scene.name}.sums", folder / f"{scene.name}.smaller"
    settings = BuildSettings()
    full, painted = None, torch.ones(len(scene.gaussians))
    rows, processor = [], Stopwatch(time.process_time)
    found["sums"] = {}
    for name, more in SMALLER.items():
        path = smaller if more else whole
        sums = processor(
            name,
            scoup.region_sums,
            scene.gaussians,
            scene.cameras,
            scene.regions,
            path=path,
            progress=report,
            **more,
        )
        entries = sum(len(part.places) for view in sums.views.values() for part in view.parts)
        made = build(scene.gaussians, scene.cameras, scene.regions, settings=settings, sums=sums)
        full = made if full is None else full
        same = (made.code_indices == full.code_indices).all(-1)
        if name == "float32":
            painted = weight_painted(sums)
        difference = (made.code_weights.float() - full.code_weights.float()).abs().amax(-1)[same]
        figures = {
            "processor_s": processor.seconds[name][0],
            "bytes": sums.bytes,
            "entries": entries,
            "same_atoms": float(same.float().mean()),
            "same_atoms_by_paint": float((same.float().mean(1) * painted).sum() / painted.sum()),
            "weight_difference": float(difference.mean()),
        }
        found["sums"][name] = figures
        rows.append([name, f"{sums.bytes / 1e6:.0f}", f"{entries / len(sums):,.0f}", f"{figures['same_atoms']:.4f}",
                     f"{figures['same_atoms_by_paint']:.5f}",
                     f"{figures['weight_difference']:.1e}"])  # fmt: skip
        shutil.rmtree(smaller, ignore_errors=True)
    print(f"\n{scene.name}: {found['gaussians']:,} Gaussians, {found['views']} views\n")
    print(
        markdown(
            ["sums kept as", "MB", "entries a view", "same atoms", "by paint", "weights differ by"], rows
        )
    )
    found["builds"] = {}
    rows = []
    for name, change in CHANGES.items():
        changed = dataclasses.replace(settings, **change)
        found["builds"][name] = again(scene, scene.regions, changed, whole)
    if scene.others is not None:
        found["builds"]["other embeddings"] = again(scene, scene.others, settings, whole)
    rows = [[name, f"{figures['processor_s']:.2f}"] for name, figures in found["builds"].items()]
    print("\n" + markdown(["built from kept sums", "processor s"], rows))
    whole.unlink()
    return found


def weight_painted(sums: RegionSums) -> torch.Tensor:
    """[N] float64: how much of all regions each Gaussian paints, in the order of the scene."""
    total = np.zeros(sums.n_gaussians)
    for view in sums.views.values():
        for part in view.parts:
            total += np.bincount(part.gaussians(), part.weights, sums.n_gaussians)
    painted = torch.empty(sums.n_gaussians, dtype=torch.float64)
    painted[sums.order] = torch.from_numpy(total)
    return painted


def again(scene: Scene, regions: Regions, settings: BuildSettings, path: Path) -> dict[str, float]:
    """A field from kept sums: opening the file, coding, and the vote."""
    processor, wall = Stopwatch(time.process_time), Stopwatch()
    wall("build", processor, "build", lambda: build(scene.gaussians, scene.cameras, regions, settings=settings,
                                          sums=RegionSums.open(path)))  # fmt: skip
    return {"processor_s": processor.seconds["build"][0], "wall_s": wall.seconds["build"][0]}


if __name__ == "__main__":
    torch.manual_seed(0)
    main(tyro.cli(Arguments, description=__doc__))
