"""Claims of the paper that can be measured on any machine, side by side in one run.

    python -m benchmarks.claims [--parts uplift views entropy glass] [--out docs/benchmarks/claims.json]

* uplift: seconds to lift features of D = 16 to 512 numbers, against sparse codes. Interleaved medians.
* views: views a second of colours, of codes at three levels, and of 512 numbers at three levels.
* entropy: mIoU without half of the Gaussians by the entropy of their votes, kept in blending or dropped from it.
* glass: mIoU of a thing whose Gaussians get a tenth of their opacity, before and after.

Dense features are lifted from the same region sums as codes (``scoup_lab.baselines.dense``), which is exact and far
cheaper than the scatter of D numbers at every pixel that other systems do. What that scatter costs is estimated by a
render of D channels in one view, which does the same multiplications; one view and level is timed, and multiplied.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import torch
import tyro

from benchmarks.claims_scenes import entropy_rows, glass_rows
from benchmarks.scenes import find_layout
from scoup import raster
from scoup.io import check_output
from scoup.uplift.build_settings import BuildSettings
from scoup.uplift.rasterise import region_sums
from scoup.uplift.vote import vote
from scoup_lab.baselines.sparse import learn_codes
from scoup_lab.bench import (
    Task,
    Timing,
    describe_environment,
    markdown,
    random_scene_cameras,
    random_scene_gaussians,
    random_scene_regions,
    time_tasks,
    write_json,
)
from scoup_lab.bench.environment import in_one_line
from scoup_lab.synthetic.random_scene import clip_like, random_scene_codes
from scoup_lab.synthetic.scene import make_demo_scene

Part = Literal["uplift", "views", "entropy", "glass"]


@dataclass(frozen=True)
class Arguments:
    parts: tuple[Part, ...] = ("uplift", "views", "entropy", "glass")
    """What is measured."""
    n_gaussians: int = 40_000
    """Of the random scene that is timed, and of the scene with glass."""
    width: int = 320
    """Of all views, in pixels."""
    height: int = 240
    """Of all views, in pixels."""
    views: int = 12
    """With regions, of every scene; a quarter as many are held out."""
    dims: tuple[int, ...] = (16, 32, 64, 128, 256, 512)
    """D of the dense features that are lifted; the largest is rendered."""
    entropy_gaussians: int = 200_000
    """Of the scene of the entropy study."""
    layout: str = "table"
    """Of the scenes of the entropy study and of glass (`benchmarks.scenes`)."""
    glass_things: int = 6
    """How many things become glass, one at a time."""
    glass_opacity: float = 0.1
    """Share of their opacity that is left."""
    seed: int = 0
    """Of everything."""
    repeats: int = 5
    """Timed runs of each task."""
    threads: int = 1
    """Threads of what is timed."""
    out: Path | None = None
    """Where to write the figures as JSON."""
    overwrite: bool = False
    """Replace OUT."""


def main(arguments: Arguments) -> dict[str, Any]:
    """Measure the parts that are wanted, print their tables, give the record."""
    if arguments.out is not None:
        check_output(arguments.out, arguments.overwrite)
    environment = describe_environment()
    print(in_one_line(environment))
    settings = {name: value for name, value in vars(arguments).items() if name not in ("out", "overwrite")}
    measured = {name: MEASURES[name](arguments) for name in arguments.parts}
    record = {"what": "benchmarks.claims", "machine": environment, "settings": settings, **measured}
    if arguments.out is not None:
        write_json(arguments.out, record, arguments.overwrite)
    return record


def uplift(arguments: Arguments) -> dict[str, Any]:
    """Seconds of sparse and of dense uplift of all views and levels, codes being learned before."""
    gaussians = random_scene_gaussians(arguments.n_gaussians, arguments.seed)
    cameras = random_scene_cameras(arguments.views, arguments.width, arguments.height)
    regions = random_scene_regions(cameras, seed=arguments.seed)
    sums = region_sums(gaussians, cameras, regions)
    embeddings = [regions.embeddings(level) for level in regions.levels]
    sums.rows = [rows for _, rows in embeddings]
    settings = BuildSettings(n_atoms=64, k=4, rounds=1, effort="fast", seed=arguments.seed)
    codes, codebook = learn_codes([rows for rows, _ in embeddings], settings)
    counts = [len(rows) for rows, _ in embeddings]
    projection = raster.project(gaussians, cameras[0])

    def task(run: Callable[[], object]) -> Task:
        return Task(run, arguments.threads, arguments.repeats)

    tasks = {
        ("rasterise", 0): task(lambda: region_sums(gaussians, cameras, regions)),
        ("sparse", 0): task(lambda: vote(sums, codes, codebook, 1, 4)),
        ("matrices", 0): task(lambda: [sums.matrix(level) for level in range(len(counts))]),
    }
    matrices = [sums.matrix(level) for level in range(len(counts))]
    for dim in arguments.dims:
        features = [clip_like(count, dim, level).numpy() for level, count in enumerate(counts)]
        values = torch.randn(len(gaussians), dim, generator=torch.Generator().manual_seed(dim))

        def lift(features: list[Any] = features) -> list[torch.Tensor]:
            found = [matrix @ rows for matrix, rows in zip(matrices, features, strict=True)]
            return [torch.nn.functional.normalize(torch.from_numpy(part), dim=1) for part in found]

        tasks["dense", dim] = task(lift)
        tasks["pixels", dim] = task(lambda values=values: raster.render_channels(projection, values))
    timings = time_tasks(tasks)
    return _uplift_record(arguments, timings, len(counts))


def _uplift_record(
    arguments: Arguments, timings: dict[tuple[str, int], Timing], levels: int
) -> dict[str, Any]:
    rasterising, matrices = timings["rasterise", 0].median, timings["matrices", 0].median
    sparse = rasterising + timings["sparse", 0].median
    rows, body = [], []
    for dim in arguments.dims:
        products = timings["dense", dim].median
        dense = rasterising + matrices + products
        pixels = timings["pixels", dim].median * arguments.views * levels
        ratios = {"ratio": dense / sparse, "by_pixel_ratio": pixels / sparse}
        rows.append({"dim": dim, "dense_s": dense, "products_s": products, "by_pixel_s": pixels, **ratios})
        cells = (
            f"{products:.3f}",
            f"{dense:.3f}",
            f"{dense / sparse:.2f}",
            f"{pixels:.2f}",
            f"{pixels / sparse:.1f}",
        )
        body.append([str(dim), *cells])
    print(
        f"\nuplift of all views and levels: sparse codes {sparse:.3f} s ({rasterising:.3f} s of it rasterising);"
    )
    print(f"turning sums into sparse matrices, for dense features, {matrices:.3f} s\n")
    headers = ["D", "products, s", "dense in all, s", "of sparse", "by pixel, s, estimated", "of sparse"]
    print(markdown(headers, body))
    raw = {f"{name} {dim}".removesuffix(" 0"): timing.record() for (name, dim), timing in timings.items()}
    return {
        "sparse_s": sparse,
        "rasterise_s": rasterising,
        "matrices_s": matrices,
        "dense": rows,
        "timings": raw,
    }


def views(arguments: Arguments) -> dict[str, Any]:
    """Views a second, projection included."""
    gaussians = random_scene_gaussians(arguments.n_gaussians, arguments.seed)
    (camera,) = random_scene_cameras(1, arguments.width, arguments.height)
    indices, weights = random_scene_codes(gaussians.means, seed=arguments.seed)
    values = torch.randn(len(gaussians), max(arguments.dims), generator=torch.Generator().manual_seed(0))
    prepared = raster.prepare_gaussians(gaussians)

    def dense() -> None:
        projection = raster.project(prepared, camera)
        for _ in range(indices.shape[1]):
            raster.render_channels(projection, values)

    runs: dict[str, Callable[[], object]] = {
        "colours": lambda: raster.render_colors(gaussians, camera, raster.project(prepared, camera)),
        "codes, three levels": lambda: raster.render_codes(
            raster.project(prepared, camera), indices, weights, 64
        ),
        f"{max(arguments.dims)} numbers, three levels": dense,
    }
    tasks = {name: Task(run, arguments.threads, arguments.repeats) for name, run in runs.items()}
    timings = time_tasks(tasks)
    rates = {name: 1 / timing.median for name, timing in timings.items()}
    most = rates["colours"]
    body = [[name, f"{rate:.2f}", f"{rate / most:.3f}"] for name, rate in rates.items()]
    print("\n" + markdown(["rendered", "views a second", "of colours"], body))
    return {name: {"views_a_second": rates[name], **timing.record()} for name, timing in timings.items()}


def entropy(arguments: Arguments) -> dict[str, Any]:
    """mIoU of the rows of the entropy ablation, and what each loses of the base."""
    found = entropy_rows(_demo(arguments, arguments.entropy_gaussians))
    base = next(iter(found.values()))["miou"]
    body = [
        [name, f"{100 * row['miou']:.1f}", f"{100 * (row['miou'] - base):+.1f}"]
        for name, row in found.items()
    ]
    print(
        f"\nentropy, {arguments.entropy_gaussians:,} Gaussians\n\n"
        + markdown(["", "mIoU", "minus base"], body)
    )
    return found


def glass(arguments: Arguments) -> list[dict[str, Any]]:
    """mIoU of things before and after they are made glass."""
    found = glass_rows(
        _demo(arguments, arguments.n_gaussians), arguments.glass_things, arguments.glass_opacity
    )
    body = []
    for row in found:
        pairs = [(row["before"][key], row["after"][key]) for key in ("miou", "accuracy", "others_miou")]
        cells = ["-" if None in pair else f"{100 * pair[0]:.1f} to {100 * pair[1]:.1f}" for pair in pairs]
        body.append([row["thing"], str(row["views"]), *cells])
    print("\n" + markdown(["glass", "views", "mIoU", "localisation", "mIoU of the others"], body))
    return found


def _demo(arguments: Arguments, n_gaussians: int) -> Any:
    held_out = max(1, arguments.views // 4)
    size = (arguments.width, arguments.height, arguments.views, held_out)
    return make_demo_scene(arguments.seed, n_gaussians, *size, find_layout(arguments.layout))


MEASURES: dict[Part, Callable[[Arguments], Any]] = {
    "uplift": uplift, "views": views, "entropy": entropy, "glass": glass,
}  # fmt: skip


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
