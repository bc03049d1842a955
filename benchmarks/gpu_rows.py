"""The rows of the study of a GPU that are not timings of one view: answers beside a CPU's, a whole build, queries."""

from __future__ import annotations

import itertools
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

import scoup
from benchmarks.processes import SCOUP, run_python
from benchmarks.random_field import everyday_vectors
from scoup import raster
from scoup.field import relevancy
from scoup.models import CANONICAL_PHRASES, EVERYDAY_WORDS
from scoup.query import LanguageField
from scoup.raster import ViewSums
from scoup_lab.bench import (
    StageClock,
    Task,
    Workload,
    random_scene_cameras,
    random_scene_gaussians,
    random_scene_regions,
    random_workload,
    time_tasks,
)
from scoup_lab.bench.stages import region_sums_of_a_view, vote_of_a_view
from scoup_lab.synthetic.random_scene import clip_like

Row = dict[str, Any]


def parity_row(
    n_gaussians: int, width: int, height: int, device: str, backend: str, n_atoms: int = 128
) -> Row:
    """Return how far a view on the GPU is from the same on the CPU, in shares of the largest or of the whole."""
    here = random_workload(n_gaussians, width, height, n_atoms=n_atoms, n_queries=5)
    # Fields keep weights as float16.
    here = replace(here, weights=here.weights.half())
    there = here.to(device)
    ours = raster.project(there.gaussians, there.camera, "inria", backend)
    theirs = raster.project(here.gaussians, here.camera, "inria")
    found: dict[str, Callable[[Workload, Any], Tensor]] = {
        "RGB": lambda work, view: raster.render_channels(view, work.values)[0],
        "coefficient maps": lambda work, view: raster.render_codes(view, work.indices, work.weights, n_atoms),
        "cosines": lambda work, view: raster.render_cosines(
            view, work.indices, work.weights, work.codebook, work.queries
        ),
    }
    row: Row = {}
    for name, render in found.items():
        one, other = render(there, ours).cpu(), render(here, theirs)
        row[name] = {"mean": mean_difference(one, other), "beyond 1e-3": beyond(one, other)}
        if name == "cosines":
            one, other = (relevancy(cosines[:, :1], cosines[:, 1:]) for cosines in (one, other))
            row["relevancy"] = {"mean": mean_difference(one, other), "beyond 1e-3": beyond(one, other)}
    sums = raster.region_sums(ours, there.labels), raster.region_sums(theirs, here.labels)
    row["region sums"] = {
        "share of the weight": sums_difference(*sums),
        "entries": [len(each.weight) for each in sums],
    }
    votes = [
        vote_of_a_view(work, region_sums_of_a_view(work, view), name)
        for work, view, name in ((there, ours, backend), (here, theirs, None))
    ]
    dense = [
        torch.zeros(*vote.indices.shape[:2], n_atoms).scatter_add_(
            2, vote.indices.cpu().long(), vote.weights.cpu()
        )
        for vote in votes
    ]
    # A tie between atoms may turn.
    row["vote"] = {"other codes": float(((dense[0] - dense[1]).abs().amax((1, 2)) > 2e-3).float().mean())}
    return row


def mean_difference(one: Tensor, other: Tensor) -> float:
    """Return the mean absolute difference, over the largest number."""
    return float((one - other).abs().double().mean() / other.abs().max().clamp(min=1e-30))


def beyond(one: Tensor, other: Tensor, share: float = 1e-3) -> float:
    """Return the share of numbers that differ by more than ``share`` of the largest number."""
    return float(((one - other).abs() > share * other.abs().max()).float().mean())


def sums_difference(one: ViewSums, other: ViewSums) -> float:
    """Return the sum of all absolute differences of two region sums of the same labels, over all weight."""
    count = max(len(one.table), 1)
    keys = torch.cat([each.gaussian.cpu().long() * count + each.combination.cpu() for each in (one, other)])
    weights = torch.cat([one.weight.cpu(), -other.weight.cpu()]).double()
    unique, place = torch.unique(keys, return_inverse=True)
    left = torch.zeros(len(unique), dtype=torch.float64).index_add_(0, place, weights)
    return float(left.abs().sum() / other.weight.double().sum())


@dataclass(frozen=True, eq=False)
class BuiltScene:
    """A field that was built on a GPU, and what it took."""

    field: LanguageField
    row: Row


def build_scene(n_gaussians: int, views: int, width: int, height: int, device: str) -> BuiltScene:
    """Build the random scene from memory: seconds by stage, and the peak memory of the GPU."""
    gaussians = random_scene_gaussians(n_gaussians)
    cameras = random_scene_cameras(views, width, height)
    regions = random_scene_regions(cameras)
    there = gaussians.to(device)
    on_gpu = device.startswith("cuda")
    few = scoup.Cameras(list(cameras)[:2])
    scoup.build(
        there, few, regions.select(few.names), sources=scoup.FieldSources("simulated")
    )  # compiles kernels
    if on_gpu:
        torch.cuda.reset_peak_memory_stats()
    clock, started = StageClock(), time.perf_counter()
    field = scoup.build(there, cameras, regions, sources=scoup.FieldSources("simulated"), progress=clock)
    if on_gpu:
        torch.cuda.synchronize()
    seconds = time.perf_counter() - started
    row: Row = {"seconds": seconds, "stages": clock.stop(), "coded": float(field.coded().float().mean())}
    if on_gpu:
        row["peak_bytes"] = torch.cuda.max_memory_allocated()
    return BuiltScene(field, row)


QUERIES = (
    "relevancy maps, new camera",
    "relevancy maps, known camera",
    "a text over things, after its vector",
)


def query_row(field: LanguageField, name: str, device: str, repeats: int) -> Row:
    """Time one of ``QUERIES`` to a field."""
    vectors, phrases = clip_like(16, seed=1).to(device), clip_like(len(CANONICAL_PHRASES), seed=2).to(device)
    view = field.at(1)
    view.relevancy(vectors[:1], phrases)
    field = field.with_encoder(everyday_vectors())
    asked = [field.question(word) for word in EVERYDAY_WORDS[:16]]
    turn = itertools.count()
    runs: dict[str, Callable[[], object]] = {
        QUERIES[0]: lambda: field.at(2).relevancy(vectors[:1], phrases),
        QUERIES[1]: lambda: view.relevancy(vectors[next(turn) % 16][None], phrases),
        QUERIES[2]: lambda: field.answer(asked[next(turn) % 16]),
    }
    return time_tasks({name: Task(runs[name], None, repeats)}, device)[name].to_dict()


def answers_row(
    device: str, n_gaussians: int = 20_000, width: int = 240, height: int = 180, views: int = 8
) -> Row:
    """Build the demo's scene by the command line on both devices, and ask both fields for everything in it."""
    from scoup_lab.synthetic.folder import write_demo_scene
    from scoup_lab.synthetic.scene import make_demo_scene

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        scene = make_demo_scene(0, n_gaussians, width, height, views, 1)
        source = write_demo_scene(scene, folder / "scene")
        fields = []
        for number, where in enumerate((device, "cpu")):
            out = folder / f"{number}.scoup"
            model = str(source / "text.npz")
            run_python(SCOUP, "build", str(source), "--model", model, "--out", str(out), "--device", where)
            fields.append(LanguageField.load(out))
        asked = str(folder / "0.scoup"), scene.layout.favourites[0], "--camera", "all", "--device", device
        run_python(SCOUP, "query", *asked, "--out", str(folder / "out"))
        words = sorted(scene.layout.favourites)
        overlaps, levels = [], 0
        for ours, theirs in zip(*(field.answer(field.question(words)) for field in fields), strict=True):
            union = int((ours.mask | theirs.mask).sum())
            overlaps.append(int((ours.mask & theirs.mask).sum()) / union if union else 1.0)
            levels += ours.level == theirs.level
    return {
        "words": len(words),
        "same level": levels,
        "least IoU": min(overlaps),
        "mean IoU": sum(overlaps) / len(words),
    }
