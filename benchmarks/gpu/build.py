"""The whole build of a LERF-sized scene, kept region sums and queries, beside the paper's procedure on the same device.

The paper's procedure: Adam over logits and codebook for 4000 epochs, level by level, then the per-pixel scatter, level
by level and view by view, then the K largest.
"""

from __future__ import annotations

import dataclasses
from functools import cache, partial

import torch

import scoup
from benchmarks.gpu.stage import PRESET, Row, Stage, Unavailable, add_ratios, project
from scoup.coding.adam import LEARNING_RATE
from scoup.scene.cameras import Cameras
from scoup.scene.codes import SparseCodes
from scoup.uplift.build_settings import build_settings
from scoup_lab.bench import StageClock, random_scene_cameras, random_scene_gaussians, random_scene_regions
from scoup_lab.synthetic.random_scene import clip_like

NAMES = {
    "paper": "ours: build, the paper's settings with exact codes (L = 64, one round)",
    "default": "ours: build, default settings (L = 128, exact, two rounds)",
}
KEPT_SUMS, FROM_SUMS = "ours: region sums of all views, kept", "ours: build from kept sums, default settings"
PLAIN = "the paper's solver (autograd over D numbers a region)"
SCATTER = "per-pixel scatter of all views, level after level, and vote"
QUERY = "ours: a query to the field"
PAPER = "the paper's procedure"


def build(stage: Stage) -> None:
    """Time one run of each after a small one that compiles; inputs in memory, regions and label maps on the host."""
    sizes = stage.sizes
    stage.result["about"] = (
        f"{sizes.n_gaussians:,} Gaussians, {sizes.build_views} views of {sizes.width} x {sizes.height}, "
        f"{'/'.join(map(str, sizes.build_regions))} regions a view, D = {sizes.dim}; one run each"
    )
    scene = Scene(stage)
    for preset, name in NAMES.items():
        stage.once(f"{name}: warm-up", partial(scene.build, preset, most_views=4))
        stages: dict[str, float] = {}
        stage.once(name, partial(scene.build, preset, stages))["stages_s"] = stages
    given = scene.gaussians, scene.cameras, scene.regions, PRESET
    sums = cache(lambda: scoup.region_sums(*given, backend="triton", progress=stage.progress))
    stage.once(KEPT_SUMS, sums)
    stage.row(f"{KEPT_SUMS}: bytes", lambda: {"value": sums().bytes})
    stage.once(FROM_SUMS, lambda: scene.build("default", sums=sums()))
    field = cache(lambda: scene.build("default", sums=sums()))
    projection = cache(lambda: field().project(scene.cameras[0]))
    text, canonical = clip_like(5, sizes.dim, 1).to(stage.device).split([1, 4])
    query = partial(lambda view: field().relevancy(scene.cameras[0], text, canonical, view()))
    stage.rows({QUERY: partial(query, lambda: None), f"{QUERY}, same view again": partial(query, projection)})
    for kept in (sums, field, projection):
        kept.cache_clear()
    stage.recover()
    paper(stage, scene)


def paper(stage: Stage, scene: Scene) -> None:
    """Add rows for the parts of the paper's procedure, and their sum."""
    sizes = stage.sizes
    stage.once(f"{PLAIN}: warm-up", partial(scene.solve, 2))
    solver = stage.once(PLAIN, partial(scene.solve, sizes.epochs_run))
    if sizes.epochs_run < sizes.epochs and "median_s" in solver:
        solver["note"] = f"extrapolated: {sizes.epochs_run} of {sizes.epochs} epochs were run"
        for key in ("median_s", "min_s", "max_s"):
            solver[key] *= sizes.epochs / sizes.epochs_run
    stage.once(f"{SCATTER}: warm-up", partial(scene.scatter, Cameras(list(scene.cameras)[:1])))
    scattered = stage.once(SCATTER, partial(scene.scatter, scene.cameras))

    def both() -> Row:
        missing = [row["name"] for row in (solver, scattered) if "median_s" not in row]
        if missing:
            raise Unavailable(f"not measured: {', '.join(missing)}")
        return {"median_s": solver["median_s"] + scattered["median_s"]}

    stage.row(PAPER, both)
    rows = [row for row in stage.result["rows"] if row["name"] in (PAPER, *NAMES.values())]
    add_ratios(rows, {PAPER: [PAPER]})
    stage.save()


class Scene:
    """The room, its views and their regions, and what is done with them."""

    def __init__(self, stage: Stage) -> None:
        sizes = stage.sizes
        self.stage, self.gaussians = stage, random_scene_gaussians(sizes.n_gaussians).to(stage.device)
        self.cameras = random_scene_cameras(sizes.build_views, sizes.width, sizes.height)
        self.regions = random_scene_regions(self.cameras, sizes.build_regions, sizes.dim)
        self.codes: list[SparseCodes] = []  # of the paper's solver

    def build(
        self,
        preset: str,
        stages: dict[str, float] | None = None,
        most_views: int | None = None,
        sums: scoup.RegionSums | None = None,
    ) -> scoup.LanguageField:
        """Run ``scoup.build``; ``stages`` gets seconds by stage as the host sees them: the device may lag behind."""
        sizes, clock = self.stage.sizes, StageClock(self.stage.progress)
        n_atoms = sizes.n_atoms[0 if preset == "paper" else -1]
        k = sizes.k if preset == "paper" else min(build_settings(preset).k, n_atoms)
        settings = build_settings(preset, n_atoms=n_atoms, k=k, solver="exact")
        field = scoup.build(
            self.gaussians, Cameras(list(self.cameras)[:most_views]), self.regions, backend="triton", sums=sums,
            settings=dataclasses.replace(settings, raster_preset=PRESET), progress=clock,
        )  # fmt: skip
        self.stage.clock.settle()
        if stages is not None:
            stages.update({name: value for name, value in clock.stop().items() if value >= 1e-3})
        return field

    def solve(self, epochs: int) -> None:
        """Run the paper's solver, level by level."""
        from coding.plain_adam import plain_loss  # of the tests: method.md as it is written

        sizes, self.codes = self.stage.sizes, []
        for level in self.regions.levels:
            self.stage.progress(PLAIN)
            rows = self.regions.embeddings(level)[0].to(self.stage.device)
            atoms = rows[: sizes.n_atoms[0]].clone().requires_grad_()
            logits = (rows @ atoms.detach().T * 4.0).requires_grad_()
            optimizer = torch.optim.Adam([logits, atoms], lr=LEARNING_RATE)
            for _ in range(epochs):
                optimizer.zero_grad()
                plain_loss(rows, atoms, logits, sizes.k).backward()
                optimizer.step()
            self.codes.append(SparseCodes.from_dense(torch.softmax(logits.detach(), 1), sizes.k))

    def scatter(self, cameras: Cameras) -> None:
        """Run the paper's uplift, level by level and view by view."""
        from benchmarks.scatter_kernel import scatter_view

        if not self.codes:  # the solver failed: other codes take the same time
            self.solve(1)
        for level, codes in zip(self.regions.levels, self.codes, strict=True):
            places = self.regions.embeddings(level)[1]
            out = torch.zeros(len(self.gaussians), 1, codes.n_atoms, device=self.stage.device)
            for done, camera in enumerate(cameras):
                self.stage.progress(f"{SCATTER}, level {level}", done, len(cameras))
                labels = self.regions.load(camera.name, level).labels.to(self.stage.device)
                own = codes.rows(places[camera.name])
                scatter_view(project(self.gaussians, camera), labels[None], [own], out)
            for part in out[:, 0].split(1 << 16):
                SparseCodes.from_dense(part, self.stage.sizes.k)
