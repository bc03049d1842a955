"""Claims of the paper that can be measured on any machine, side by side in one run."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import torch

from benchmarks.claims_scenes import desk_rows, desk_scene, entropy_rows, glass_rows, members, study_scene
from benchmarks.data import data_folder
from benchmarks.scenes import find_layout
from benchmarks.study import Record, Study, report
from scoup import raster
from scoup.uplift.build_settings import BuildSettings
from scoup.uplift.rasterise import region_sums
from scoup.uplift.vote import vote
from scoup_lab.baselines.rasterised_scene import learn_codes
from scoup_lab.bench import (
    Task,
    markdown,
    random_scene_cameras,
    random_scene_gaussians,
    random_scene_regions,
    time_tasks,
)
from scoup_lab.synthetic.random_scene import clip_like, random_scene_codes
from scoup_lab.synthetic.scene import DemoScene, make_demo_scene

Part = Literal["uplift", "views", "entropy", "glass", "desk"]


@dataclass(frozen=True, kw_only=True)
class Claims(Study):
    """Measure claims of the paper side by side in one run.

    uplift: seconds to lift features of D numbers, against sparse codes. views: views a second of colours, of codes at
    three levels, and of D numbers at three levels. entropy: mIoU without half of the Gaussians by the entropy of their
    votes, kept in blending or dropped from it. glass: mIoU of a thing whose Gaussians get a tenth of their opacity,
    before and after. desk: the settings, the features across views, entropy and glass, on the real scene desk; things
    become glass by the Gaussians that contribute to their marks.

    Dense features are lifted from the same region sums as codes, which is exact and far cheaper than the scatter of D
    numbers at every pixel that other systems do. What that scatter costs is estimated by a render of D channels in one
    view, which does the same multiplications; one view and level is timed, and multiplied.
    """

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
    seed: int = 0
    """Of everything."""
    repeats: int = 5
    """Timed runs of each task."""
    threads: int = 1
    """Threads of what is timed."""

    def measure(self, known: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        for part in self.parts:
            if part not in known:
                yield part, MEASURES[part](self)

    def record(self, rows: dict[str, Any]) -> Record:
        return rows

    @staticmethod
    def table(record: Record) -> str:
        """Return a line per figure."""
        rows = []
        for of in record.get("uplift", {}).get("dense", []):
            ratios = f"{of['ratio']:.2f} times sparse, {of['by_pixel_ratio']:.1f} by pixel (estimated)"
            rows.append([f"uplift of {of['dim']} numbers", f"{of['dense_s']:.3f} s", ratios])
        for name, of in record.get("views", {}).items():
            rows.append([f"views a second: {name}", f"{of['views_a_second']:.2f}", ""])
        for name, of in record.get("entropy", {}).items():
            rows.append([f"mIoU: {name}", f"{100 * of['miou']:.1f}", ""])
        desk = record.get("desk", {})
        for name, of in desk.get("settings", {}).items():
            rows.append([f"mIoU on desk: {name}", f"{100 * of['miou']:.1f}", ""])
        for of in desk.get("features", {}).get("results", []):
            shown = f"{of['cosine']:.3f}", f"unmatched {of['unmatched']:.3f}"
            rows.append([f"cosine on desk: {of['features']}, level {of['level']}", *shown])
        for of in [*record.get("glass", []), *desk.get("glass", [])]:
            before, after = of["before"], of["after"]
            others = f"others {_percent(before['others_miou'])} to {_percent(after['others_miou'])}"
            shown = f"{_percent(before['miou'])} to {_percent(after['miou'])}"
            rows.append([f"mIoU of {of['thing']} as glass", shown, others])
        return markdown(["what", "measured", "compared"], rows)


def uplift(study: Claims) -> Record:
    """Return seconds of sparse and of dense uplift of all views and levels, codes being learned before."""
    gaussians = random_scene_gaussians(study.n_gaussians, study.seed)
    cameras = random_scene_cameras(study.views, study.width, study.height)
    regions = random_scene_regions(cameras, seed=study.seed)
    sums = region_sums(gaussians, cameras, regions)
    embeddings = [regions.embeddings(level) for level in regions.levels]
    sums.rows = [rows for _, rows in embeddings]
    settings = BuildSettings(n_atoms=64, k=4, rounds=1, effort="fast", seed=study.seed)
    codes, codebook = learn_codes([rows for rows, _ in embeddings], settings)
    counts = [len(rows) for rows, _ in embeddings]
    projection = raster.project(gaussians, cameras[0])
    matrices = [sums.matrix(level) for level in range(len(counts))]
    runs: dict[str, Callable[[], object]] = {
        "rasterise": lambda: region_sums(gaussians, cameras, regions),
        "sparse": lambda: vote(sums, codes, codebook, 1, 4),
        "matrices": lambda: [sums.matrix(level) for level in range(len(counts))],
    }
    for dim in study.dims:
        features = [clip_like(count, dim, level).numpy() for level, count in enumerate(counts)]
        values = torch.randn(len(gaussians), dim, generator=torch.Generator().manual_seed(dim))

        def lift(features: list[Any] = features) -> list[torch.Tensor]:
            found = [matrix @ rows for matrix, rows in zip(matrices, features, strict=True)]
            return [torch.nn.functional.normalize(torch.from_numpy(part), dim=1) for part in found]

        runs[f"dense {dim}"] = lift
        runs[f"pixels {dim}"] = lambda values=values: raster.render_channels(projection, values)
    timings = timed(study, runs)
    median = {name: timing["median_s"] for name, timing in timings.items()}
    sparse = median["rasterise"] + median["sparse"]
    rows = []
    for dim in study.dims:
        dense = median["rasterise"] + median["matrices"] + median[f"dense {dim}"]
        pixels = median[f"pixels {dim}"] * study.views * len(counts)
        ratios = {"ratio": dense / sparse, "by_pixel_ratio": pixels / sparse}
        rows.append({"dim": dim, "dense_s": dense, "by_pixel_s": pixels, **ratios})
    return {"sparse_s": sparse, "dense": rows, "timings": timings}


def views(study: Claims) -> Record:
    """Return views a second, projection included."""
    gaussians = random_scene_gaussians(study.n_gaussians, study.seed)
    (camera,) = random_scene_cameras(1, study.width, study.height)
    indices, weights = random_scene_codes(gaussians.means, seed=study.seed)
    values = torch.randn(len(gaussians), max(study.dims), generator=torch.Generator().manual_seed(0))
    prepared = raster.prepare_gaussians(gaussians)

    def dense() -> None:
        projection = raster.project(prepared, camera)
        for _ in range(indices.shape[1]):
            raster.render_channels(projection, values)

    timings = timed(
        study,
        {
            "colours": lambda: raster.render_colors(gaussians, camera, raster.project(prepared, camera)),
            "codes, three levels": lambda: raster.render_codes(
                raster.project(prepared, camera), indices, weights, 64
            ),
            f"{max(study.dims)} numbers, three levels": dense,
        },
    )
    return {name: {"views_a_second": 1 / timing["median_s"], **timing} for name, timing in timings.items()}


def timed(study: Claims, runs: Mapping[str, Callable[[], object]]) -> dict[str, Record]:
    """Return interleaved timings by name."""
    tasks = {name: Task(run, study.threads, study.repeats) for name, run in runs.items()}
    return {name: timing.to_dict() for name, timing in time_tasks(tasks, progress=report).items()}


def demo_scene(study: Claims, n_gaussians: int) -> DemoScene:
    """Return the scene of the entropy study and of glass."""
    size = (study.width, study.height, study.views, max(1, study.views // 4))
    return make_demo_scene(study.seed, n_gaussians, *size, find_layout(study.layout))


def glass(study: Claims) -> list[Record]:
    """Return scores of things before and after they become glass."""
    demo = demo_scene(study, study.n_gaussians)
    return glass_rows(study_scene(demo, demo.gaussians), lambda name: members(demo, name), study.glass_things)


MEASURES: dict[Part, Callable[[Claims], Any]] = {
    "uplift": uplift,
    "views": views,
    "entropy": lambda study: entropy_rows(demo_scene(study, study.entropy_gaussians)),
    "glass": glass,
    "desk": lambda study: desk_rows(desk_scene(data_folder()), study.glass_things, study.seed),
}


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.1f}"
