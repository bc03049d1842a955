"""Every stage on one view: native against the torch reference, on the random scene and on kitchen.

    python -m benchmarks.raster [--n-gaussians 100000 300000 1000000 3000000] [--threads 1 2] [--repeats 5]
        [--reference-up-to 1000000] [--reference-repeats 5] [--data DATA] [--clock-ghz 2.6] [--out FILE.json]

Runs are interleaved: every round runs each stage under each backend and number of threads once. Where the reference
was run less often, the headings say so; where it was left out, its cells are empty. The last table compares `alpha`
with the bound of the arithmetic: bound = E / 16 * 11 / (clock * threads), E the pixel-Gaussian evaluations with
alpha >= 1/255 before their pixel stops, 16 at a time in 11 cycles of fused multiply-adds. DATA holds kitchen/
(default: SCOUP_TEST_DATA, else ../shared/data); without it kitchen is left out.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
import tyro
from PIL import Image

import scoup
from benchmarks.bound import FORMULA, bound_rows, count_evaluations, print_bounds
from benchmarks.data import data_folder
from scoup.io import check_output
from scoup_lab.bench import (
    STAGES,
    Row,
    Workload,
    comparison,
    describe_environment,
    make_workload,
    random_workload,
    stage_runs,
    stage_table,
    time_stages,
    usable_backends,
    write_json,
)
from scoup_lab.bench.environment import in_one_line
from scoup_lab.bench.report import SPECIFICATION
from scoup_lab.synthetic.random_scene import Order


@dataclass(frozen=True)
class Arguments:
    n_gaussians: tuple[int, ...] = (100_000, 300_000, 1_000_000, 3_000_000)
    """Sizes of the room."""
    width: int = 988
    """Of the room's view, in pixels."""
    height: int = 731
    """Of the room's view, in pixels."""
    order: Order = "random"
    """Of the room's rows; trained scenes have none."""
    prepared: bool = False
    """Project scenes that are prepared for many views, as a build does."""
    threads: tuple[int, ...] = (1, 2)
    """Numbers of threads."""
    repeats: int = 5
    """Interleaved repetitions; medians are printed."""
    backends: tuple[str, ...] = ()
    """Rasterisers; all that work here if empty."""
    stages: tuple[str, ...] = tuple(STAGES)
    """Stages, see `scoup bench`."""
    reference_up_to: int = 1_000_000
    """The reference is not run on scenes of more Gaussians."""
    reference_repeats: int = 5
    """Repetitions of the reference, where fewer than those of the others."""
    kitchen: bool = True
    """Measure kitchen too."""
    data: Path = field(default_factory=data_folder)
    """Folder that holds kitchen/."""
    clock_ghz: float | None = None
    """Clock of a core under this load; what the system reports by default, which may be the nominal one."""
    out: Path | None = None
    """Where to write the figures as JSON."""
    overwrite: bool = False
    """Replace OUT."""


def main(arguments: Arguments) -> dict[str, Any]:
    """Measure everything, print the tables, give the record."""
    if arguments.out is not None:
        check_output(arguments.out, arguments.overwrite)
    backends, reasons = usable_backends(arguments.backends)
    environment = describe_environment()
    rows: list[Row] = []
    evaluations: list[dict[str, Any]] = []
    views: list[str] = []
    left_out: list[str] = []  # scenes too large for the reference
    for work in scenes(arguments):
        print(f"measuring {work.name}, {len(work.gaussians):,} Gaussians", file=sys.stderr)
        rows += (own := measure_scene(work, backends, arguments))
        if SPECIFICATION in backends and not any(row.backend == SPECIFICATION for row in own):
            left_out.append(f"{work.name} of {len(work.gaussians):,}")
        views.append(f"{work.name} {work.camera.width} x {work.camera.height}")
        if any(row.stage == "alpha" for row in own):
            count = count_evaluations(work.gaussians, work.camera)
            evaluations.append({"scene": work.name, "gaussians": len(work.gaussians), "evaluations": count})
        del work

    print(in_one_line(environment))
    print(
        f"one view ({', '.join(dict.fromkeys(views))}), three levels, L = 64, K = 4, one query; interleaved, medians"
        f" of {arguments.repeats}\n"
    )
    print(stage_table(rows))
    print_notes(rows, reasons, left_out, arguments)
    bounds = bound_rows(rows, evaluations, arguments.clock_ghz)
    if evaluations:
        print_bounds(bounds)
    record = {
        "what": "benchmarks.raster: stages on one view",
        "machine": environment,
        "settings": {
            "width": arguments.width,
            "height": arguments.height,
            "order": arguments.order,
            "prepared": arguments.prepared,
            "repeats": arguments.repeats,
            "reference_repeats": min(arguments.reference_repeats, arguments.repeats),
            "reference_left_out": left_out,
        },
        "backends": backends,
        "backends_not_working": reasons,
        **comparison(rows),
        "evaluations": evaluations,
        "bound": {"formula": FORMULA, "rows": bounds},
    }
    if arguments.out is not None:
        write_json(arguments.out, record, arguments.overwrite)
    return record


def print_notes(rows: list[Row], reasons: dict[str, str], left_out: list[str], arguments: Arguments) -> None:
    """What the stages are, and what was not measured."""
    for name in arguments.stages:
        print(f"\n{name}: {STAGES[name]}", end="")
    print()
    for name, reason in reasons.items():
        print(f"backend {name} does not work here: {reason}")
    if any(len(row.timing.seconds) < arguments.repeats for row in rows):
        print(f"the reference was run {arguments.reference_repeats} times")
    if left_out:
        print(f"the reference was not run on {', '.join(left_out)}")


def scenes(arguments: Arguments) -> Iterator[Workload]:
    """What is measured, one after the other, so that only one scene is in memory."""
    kitchen = arguments.data / "kitchen"
    if arguments.kitchen and kitchen.is_dir():
        yield kitchen_workload(kitchen)
    elif arguments.kitchen:
        print(f"kitchen is left out: no folder {kitchen.name}/ in DATA", file=sys.stderr)
    for count in arguments.n_gaussians:
        yield random_workload(count, arguments.width, arguments.height, order=arguments.order)


def kitchen_workload(folder: Path, frame: int = 12) -> Workload:
    """One view of kitchen with its own region maps; codes are made up."""
    gaussians = scoup.load_gaussians(folder / "scene" / "model.splat")
    camera = scoup.load_cameras(folder)[frame]
    maps = [np.asarray(Image.open(folder / "regions" / f"{camera.stem}_{level}.png")) for level in "sml"]
    labels = torch.from_numpy(np.stack(maps).astype(np.int32))
    return make_workload("kitchen", gaussians, camera, torch.where(labels == 65535, -1, labels).int())


def measure_scene(work: Workload, backends: list[str], arguments: Arguments) -> list[Row]:
    """Time all stages of one scene."""
    runs = {
        backend: stage_runs(work, backend, arguments.stages, arguments.prepared)
        for backend in backends
        if backend != SPECIFICATION or len(work.gaussians) <= arguments.reference_up_to
    }

    def repeats(backend: str) -> int:
        most = arguments.reference_repeats if backend == SPECIFICATION else arguments.repeats
        return min(most, arguments.repeats)

    return time_stages(work, runs, arguments.threads, repeats, progress=report)


def report(stage: str, done: int, total: int) -> None:
    """Progress on a terminal only."""
    if sys.stderr.isatty():
        end = "\n" if done == total else ""
        print(f"\r{stage} {done}/{total} ", end=end, file=sys.stderr, flush=True)


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
