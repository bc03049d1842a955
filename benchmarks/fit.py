"""How often the check of splat and cameras is right: scenes that fit, and scenes made wrong in many ways.

    python -m benchmarks.fit [--data DATA] [--layouts table shelves hall yard] [--seeds 1 2 3] [--cost 1000000]
        [--out FILE.json]

Scenes are synthetic ones of each layout and seed, and the real kitchen and guitar where DATA has them (default:
SCOUP_TEST_DATA, else ../shared/data). The guitar has no cameras: they are put around it, over a black and a white
background. All photographs are renders by another size and background than the check uses, but by the same rasteriser.
The thresholds of ``scoup.uplift.fit`` were chosen on seed 0, kitchen and guitar.
"""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import tyro

import scoup
from benchmarks.data import data_folder
from benchmarks.fit_cases import RIGHT, WRONG, FitScene, photographed
from benchmarks.scenes import LAYOUTS, find_layout
from scoup.io import check_output
from scoup.scene.cameras import Camera, Cameras
from scoup.scene.gaussians import Gaussians
from scoup.uplift.fit import Fit, Verdict, measure_fit, views_tried
from scoup_lab.bench import (
    describe_environment,
    markdown,
    random_scene_cameras,
    random_scene_gaussians,
    random_scene_regions,
    write_json,
)
from scoup_lab.bench.environment import in_one_line
from scoup_lab.synthetic import make_demo_scene


@dataclass(frozen=True)
class Arguments:
    data: Path = field(default_factory=data_folder)
    """Folder that may hold kitchen/ and guitar/."""
    layouts: tuple[str, ...] = tuple(LAYOUTS)
    """Layouts of the synthetic scenes."""
    seeds: tuple[int, ...] = (1, 2, 3)
    """Of the synthetic scenes; one scene for each layout and seed."""
    n_gaussians: int = 60_000
    """Gaussians of a synthetic scene."""
    width: int = 320
    """Of its photographs, in pixels; heights are three quarters of it."""
    views: int = 24
    """Cameras of a synthetic scene."""
    cost: int = 1_000_000
    """Gaussians of the random scene whose check and build are timed; 0 times nothing."""
    cost_views: int = 200
    """Views of that scene, 988 x 731 pixels."""
    out: Path | None = None
    """Where to write the figures as JSON."""
    overwrite: bool = False
    """Replace OUT."""


def main(arguments: Arguments) -> dict[str, Any]:
    """Measure, print the table, give the record."""
    if arguments.out is not None:
        check_output(arguments.out, arguments.overwrite)
    environment = describe_environment()
    print(in_one_line(environment))
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        for scene in scenes(arguments, Path(folder)):
            for case, change in (*RIGHT.items(), *WRONG.items()):
                changed = change(scene)
                rows.append(
                    {
                        "scene": scene.name,
                        "case": case,
                        **row(measure_fit(changed.gaussians, changed.cameras)),
                    }
                )
            print(f"{scene.name}: done", flush=True)
    print_table(rows)
    record: dict[str, Any] = {
        "what": "benchmarks.fit: verdicts on splats and cameras that fit, and that do not",
        "machine": environment,
        "settings": {
            "layouts": list(arguments.layouts),
            "seeds": list(arguments.seeds),
            **{name: getattr(arguments, name) for name in ("n_gaussians", "width", "views")},
        },
        "rows": rows,
    }
    if arguments.cost:
        record["cost"] = cost(arguments.cost, arguments.cost_views)
        print(
            "\n"
            + "; ".join(f"{name.replace('_', ' ')} {value:.3g}" for name, value in record["cost"].items())
        )
    if arguments.out is not None:
        write_json(arguments.out, record, arguments.overwrite)
    return record


def scenes(arguments: Arguments, folder: Path) -> Iterator[FitScene]:
    """All scenes, each with its photographs below ``folder``."""
    size = (arguments.width, arguments.width * 3 // 4)
    made: list[tuple[str, Gaussians, list[Camera]]] = []
    for seed in arguments.seeds:
        for name in arguments.layouts:
            demo = make_demo_scene(seed, arguments.n_gaussians, *size, arguments.views, 0, find_layout(name))
            place = folder / f"{name}-{seed}"
            made.append((place.name, demo.gaussians, photographed(demo.gaussians, demo.building, place)))
    made += real_scenes(arguments.data, folder)
    for position, (name, gaussians, cameras) in enumerate(made):
        # Of seeds of one layout the furniture is the same: another scene is another layout.
        other = next(
            (
                splat
                for other, splat, _ in made[position + 1 :] + made
                if other.split("-")[0] != name.split("-")[0]
            ),
            gaussians,
        )
        yield FitScene(name, gaussians, cameras, other, folder / name)


def real_scenes(data: Path, folder: Path) -> list[tuple[str, Gaussians, list[Camera]]]:
    """The kitchen with its own images, and the guitar over black and over white."""
    found = []
    if (data / "kitchen").is_dir():
        (folder / "kitchen").mkdir()
        kitchen = scoup.load_gaussians(data / "kitchen" / "scene" / "model.splat")
        found.append(("kitchen", kitchen, list(scoup.load_cameras(data / "kitchen"))))
    if (data / "guitar").is_dir():
        guitar = scoup.load_gaussians(data / "guitar" / "guitar.ply")
        for name, background in (("guitar-black", 0.0), ("guitar-white", 1.0)):
            cameras = photographed(guitar, cameras_around(guitar), folder / name, background)
            found.append((name, guitar, cameras))
    return found


def cameras_around(gaussians: Gaussians, count: int = 24) -> list[Camera]:
    """Cameras on a circle around a thing, at three times its size."""
    centre = gaussians.means.median(0).values
    reach = 3 * float((gaussians.means - centre).norm(dim=1).quantile(0.95))
    turns = [2 * math.pi * number / count for number in range(count)]
    steps = [np.array([math.cos(turn), math.sin(turn), 0.4 * math.sin(2 * turn)]) for turn in turns]
    middle = centre.double().numpy()
    return [
        Camera.look_at(middle + reach * step, middle, f"view_{number:02d}", 400, 300, 400.0)
        for number, step in enumerate(steps)
    ]


def row(fit: Fit) -> dict[str, Any]:
    """What is kept of a measurement."""
    compared = int(fit.compared.sum())
    return {
        "verdict": fit.verdict.value,
        "coverage": round(float(np.median(fit.coverage)), 3),
        "compared": compared,
        "own": round(float(np.median(fit.own[fit.compared])), 3) if compared else None,
        "lowest_own": round(float(fit.own[fit.compared].min()), 3) if compared else None,
        "others": None if np.isnan(fit.others).all() else round(float(np.nanmean(fit.others)), 3),
    }


def print_table(rows: list[dict[str, Any]]) -> None:
    """One line a case: how often each verdict, and the correlations."""
    table = []
    for case in (*RIGHT, *WRONG):
        of_case = [row for row in rows if row["case"] == case]
        verdicts = [sum(row["verdict"] == verdict.value for row in of_case) for verdict in Verdict]
        own = [row["own"] for row in of_case if row["own"] is not None]
        span = f"{min(own):.2f} to {max(own):.2f}" if own else "none"
        kind = "fits" if case in RIGHT else "wrong"
        table.append([case, kind, str(len(of_case)), *map(str, verdicts), span])
    heads = ["case", "truth", "scenes", "silent", "warned", "refused", "median correlation"]
    print("\n" + markdown(heads, table, left=2))


def cost(n_gaussians: int, n_views: int) -> dict[str, float]:
    """Seconds of the check and of the build of a random scene, one after the other in this process."""
    gaussians = random_scene_gaussians(n_gaussians)
    cameras = random_scene_cameras(n_views)
    with tempfile.TemporaryDirectory() as folder:
        tried = {
            camera.name: camera
            for camera in photographed(gaussians, views_tried(list(cameras)), Path(folder))
        }
        cameras = Cameras(replace(camera, image_path=tried[camera.name].image_path) if camera.name in tried else camera
                          for camera in cameras)  # fmt: skip
        regions = random_scene_regions(cameras)
        seconds = {}
        for name, work in (
            ("check_s", lambda: measure_fit(gaussians, list(cameras))),
            ("build_s", lambda: scoup.build(gaussians, cameras, regions, check_fit=False)),
        ):
            started = time.perf_counter()
            work()
            seconds[name] = time.perf_counter() - started
    return {**seconds, "share": seconds["check_s"] / seconds["build_s"]}


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
