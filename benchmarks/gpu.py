"""A GPU: one view beside gsplat, the whole build, queries, and the same answers as on a CPU."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any, ClassVar

import torch
from torch import Tensor

from benchmarks.gpu_rows import QUERIES, BuiltScene, Row, answers_row, build_scene, parity_row, query_row
from benchmarks.study import Record, Study, report
from scoup import raster
from scoup.base import InputError
from scoup.field import relevancy
from scoup_lab.bench import Task, Workload, markdown, random_workload, time_tasks
from scoup_lab.bench.report import milliseconds
from scoup_lab.bench.stages import region_sums_of_a_view, vote_of_a_view
from scoup_lab.synthetic.random_scene import HEIGHT, WIDTH, clip_like

PRESET = "gsplat"  # of both rasterisers, so that they draw the same picture
LEAST_SECONDS = 0.02  # of a repetition: shorter runs follow each other
CHANNELS = 192  # that gsplat renders besides RGB: three levels of 64 atoms
CHUNK = 32  # channels that gsplat renders at a time
THEIRS = "gsplat: RGB"
DIFFERENCE = "RGB of both: mean difference"

Runs = dict[str, Callable[[], object]]


@dataclass(frozen=True, kw_only=True)
class Gpu(Study):
    """Measure this machine's GPU on a random scene: times of one view beside gsplat, a whole build, queries, parity.

    Times of a view are medians of device events, interleaved; ours include projection and sort, as gsplat's do. A row
    that fails has the reason in place of a time. A kernel that breaks the device ends the command: with --rows FILE,
    the same command goes on with the next row. gsplat (pip install gsplat) compiles itself with nvcc at first use,
    for minutes. tools/measure_gpu.sh runs this.
    """

    n_gaussians: int = 1_000_000
    """Of the scene."""
    width: int = WIDTH
    """Of the view, in pixels."""
    height: int = HEIGHT
    """Of the view, in pixels."""
    large: tuple[int, int] = (1920, 1080)
    """Size of a second view that is compared with a CPU's."""
    n_atoms: tuple[int, ...] = (64, 128)
    """Sizes of the codebooks."""
    views: int = 200
    """Of the build."""
    repeats: int = 15
    """Timed repetitions of each row."""

    device: ClassVar[str] = "cuda"
    backend: ClassVar[str] = "triton"

    def check(self) -> None:
        if self.device == "cuda" and not torch.cuda.is_available():
            raise InputError(
                "torch finds no GPU here; run this study on a machine with a CUDA or ROCm device"
            )

    def measure(self, known: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        yield from self._view(known)
        for name, run in self._parts(known).items():
            if name not in known:
                try:
                    yield name, run()
                except Exception as error:
                    yield name, _reason(error)
                    self._require_device()

    def _parts(self, known: Mapping[str, Any]) -> dict[str, Callable[[], Row]]:
        """Return the rows that are not of one view."""

        @cache
        def built() -> BuiltScene:
            if "reason" in known.get("build", {}):
                raise RuntimeError("the build failed")
            return build_scene(self.n_gaussians, self.views, self.width, self.height, self.device)

        return {
            "build": lambda: built().row,
            **{
                name: lambda name=name: query_row(built().field, name, self.device, self.repeats)
                for name in QUERIES
            },
            **{
                f"parity, {width} x {height}": partial(
                    parity_row, self.n_gaussians, width, height, self.device, self.backend
                )
                for width, height in ((self.width, self.height), self.large)
            },
            "answers of a scene, by the command line": lambda: answers_row(self.device),
        }

    def _view(self, known: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        work = random_workload(self.n_gaussians, self.width, self.height).to(self.device)
        runs = {**renders(work, self.backend), **gsplat_runs(work)}
        for n_atoms in self.n_atoms:
            same = random_workload(
                self.n_gaussians, self.width, self.height, n_atoms=n_atoms, n_queries=5
            ).to(self.device)
            runs |= code_runs(replace(same, weights=same.weights.half()), self.backend)
        tasks: dict[str, Task] = {}
        for name, run in runs.items():
            if name not in known:
                try:
                    run()  # compiles kernels
                    tasks[name] = Task(run, None, self.repeats)
                except Exception as error:
                    yield name, _reason(error)
                    self._require_device()
        if DIFFERENCE not in known and tasks.keys() >= {THEIRS, "RGB"}:
            yield DIFFERENCE, {"value": float((runs["RGB"]() - runs[THEIRS]()).abs().mean())}  # pyright: ignore[reportOperatorIssue]
        timings = time_tasks(tasks, self.device, report, LEAST_SECONDS)
        yield from ((name, timing.to_dict()) for name, timing in timings.items())

    def _require_device(self) -> None:
        try:
            torch.zeros(1, device=self.device).sum().item()
        except RuntimeError as error:
            raise InputError(
                "the GPU no longer answers; run the command again with the same --rows FILE to measure the rest"
            ) from error

    @staticmethod
    def table(record: Record) -> str:
        """Return milliseconds of each row of a view, and their ratio to gsplat's RGB; the other rows as they are."""
        rows: dict[str, dict[str, Any]] = record["rows"]
        base = rows.get(THEIRS, {}).get("median_s")
        timed = [(name, of["median_s"]) for name, of in rows.items() if "median_s" in of]
        body = [
            [name, milliseconds(seconds), f"{seconds / base:.3g}" if base else "-"] for name, seconds in timed
        ]
        notes = [f"* {name}: {_in_short(of)}" for name, of in rows.items() if "median_s" not in of]
        return "\n".join([markdown(["one view", "ms", "over gsplat's RGB"], body), "", *notes])


def _in_short(row: Row) -> str:
    """Return a row that is not a timing: a failure by its reason, tests (of older records) by their number, else its
    numbers."""
    if "reason" in row:
        return row["reason"][:60]
    if "failed" in row:
        return f"{row['passed']} passed, {len(row['failed'])} failed"
    if "value" in row:
        return f"{row['value']:.2g}"
    if "stages" in row:
        return f"{row['seconds']:.1f} s, {row.get('peak_bytes', 0) / 1e9:.1f} GB"
    if "mean" in row.get("RGB", {}):
        shares = (value["beyond 1e-3"] for value in row.values() if "beyond 1e-3" in value)
        return f"at most {max(shares):.2g} of the pixels differ by more than 0.001 of the largest value"
    numbers = {name: f"{value:.3g}" if isinstance(value, float) else value for name, value in row.items()}
    return ", ".join(f"{name} {value}" for name, value in numbers.items())


def _reason(error: Exception) -> Row:
    return {"reason": " ".join(f"{type(error).__name__}: {error}".split())[:200]}


def renders(work: Workload, backend: str) -> Runs:
    """Return what does not depend on the codebook."""
    project = partial(raster.project, work.gaussians, work.camera, PRESET, backend)
    projected, combined = cache(project), raster.combine(work.labels)
    return {
        "project, bin and sort": project,
        "label tuples": lambda: raster.combine(work.labels),
        "RGB": lambda: raster.render_channels(project(), work.values)[0],
        "region sums": lambda: raster.region_sums(project(), combined),
        "region sums, projected before": lambda: raster.region_sums(projected(), combined),
    }


def code_runs(work: Workload, backend: str) -> Runs:
    """Return what depends on the size of the codebook."""
    project = partial(raster.project, work.gaussians, work.camera, PRESET, backend)
    n_atoms, codes = work.codebook.shape[1], (work.indices, work.weights)
    projected = cache(project)
    kept = cache(lambda: region_sums_of_a_view(work, project()))

    def query() -> Tensor:
        cosines = raster.render_cosines(project(), *codes, work.codebook, work.queries)
        return relevancy(cosines[:, :1], cosines[:, 1:])

    runs: Runs = {
        "relevancy of a query": query,
        "cosines, projected before": lambda: raster.render_cosines(
            projected(), *codes, work.codebook, work.queries
        ),
        "coefficient maps": lambda: raster.render_codes(project(), *codes, n_atoms),
        "features": lambda: raster.render_features(project(), *codes, work.codebook),
        "vote on the sums of the view": lambda: vote_of_a_view(work, kept(), backend),
    }
    return {f"{name}, L = {n_atoms}": run for name, run in runs.items()}


def gsplat_runs(work: Workload) -> Runs:
    """Return renders of gsplat (github.com/nerfstudio-project/gsplat), and dense uplift by its backward."""
    device, dim = work.values.device, work.codebook.shape[2]

    @torch.no_grad()
    def rendered(channels: int) -> Tensor:
        values = work.values if channels == 3 else torch.rand(len(work.gaussians), channels, device=device)
        return render(importlib.import_module("gsplat"), work, values)

    def dense() -> None:
        embeddings = [clip_like(len(codes), dim).to(device) for codes in work.codes]
        out = torch.zeros(len(work.labels), len(work.gaussians), dim, device=device)
        dense_uplift(importlib.import_module("gsplat"), work, embeddings, out)

    return {
        THEIRS: partial(rendered, 3),
        f"gsplat: {CHANNELS} channels": partial(rendered, CHANNELS),
        f"dense uplift, {dim} channels, by gsplat's backward": dense,
    }


def render(module: Any, work: Workload, values: Tensor) -> Tensor:
    """Return [H, W, C] of any values [N, C], with gradients where they require them. No spherical harmonics."""
    gaussians, camera = work.gaussians, work.camera
    images, *_ = module.rasterization(
        means=gaussians.means, quats=gaussians.quats, scales=gaussians.scales, opacities=gaussians.opacities,
        colors=values, viewmats=camera.viewmat.float()[None].to(values.device),
        Ks=camera.K.float()[None].to(values.device), width=camera.width, height=camera.height,
        near_plane=raster.RASTER_PRESETS[PRESET].near, packed=False, channel_chunk=CHUNK,
    )  # fmt: skip
    return images[0]


def dense_uplift(module: Any, work: Workload, embeddings: Sequence[Tensor], out: Tensor) -> None:
    """Add to ``out`` [S, N, D] the dense sums of a view, w_i = sum over p of e_i(p) F(p), by gsplat's backward.

    They are the gradient of sum over p of F(p) . I(p) with respect to the values rendered. F is given per level as
    embeddings [R, D] of regions; each pixel must have one. ``CHUNK`` channels go into a call.
    """
    for level, rows in enumerate(embeddings):
        labels = work.labels[level].long()
        for first in range(0, rows.shape[1], CHUNK):
            own = rows[:, first : first + CHUNK]
            values = torch.zeros(out.shape[1], own.shape[1], device=out.device, requires_grad=True)
            (gradient,) = torch.autograd.grad(render(module, work, values), values, own[labels])
            out[level, :, first : first + CHUNK] += gradient
