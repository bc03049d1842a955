"""The whole build of a scene as large as those of LERF."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import scoup
from benchmarks.processes import memory_of
from benchmarks.study import Record, Study, report
from scoup.uplift import build_settings
from scoup_lab.bench import (
    StageClock,
    markdown,
    random_scene_cameras,
    random_scene_gaussians,
    random_scene_regions,
    torch_threads,
)
from scoup_lab.synthetic.random_scene import HEIGHT, REGIONS, WIDTH

STAGES = ("coding", "region sums", "things", "vote")


@dataclass(frozen=True, kw_only=True)
class LerfSized(Study):
    """Time the whole build of a scene as large as those of LERF: 1M Gaussians, 200 views of 988 x 731, three levels.

    The random scene with simulated regions and embeddings: times mean something, answers do not. From Gaussians,
    cameras and regions in memory to the field in memory. The paper names 42 s on an RTX A6000, coding included.
    """

    n_gaussians: int = 1_000_000
    """Of the room."""
    views: int = 200
    """Views, each with regions."""
    width: int = WIDTH
    """Of the views, in pixels."""
    height: int = HEIGHT
    """Of the views, in pixels."""
    regions: tuple[int, ...] = REGIONS
    """Regions in a view at levels s, m, l."""
    preset: str = "default"
    """Settings of the build: "default" or "paper"."""
    epochs: int | None = None
    """Epochs of the solver of "paper"."""
    n_atoms: int | None = None
    """L, in place of the preset's."""
    backend: str | None = None
    """Rasteriser; the fastest by default."""
    threads: int = 2
    """Threads."""
    seed: int = 0
    """Of everything."""

    def measure(self, known: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        if "build" in known:
            return
        gaussians = random_scene_gaussians(self.n_gaussians, self.seed)
        cameras = random_scene_cameras(self.views, self.width, self.height)
        regions = random_scene_regions(cameras, self.regions, seed=self.seed)
        own = [_own_memory()]  # before the build, then at every report

        def watch(stage: str, done: int, total: int) -> None:
            own.append(_own_memory())
            report(stage, done, total)

        clock = StageClock(watch)
        changes = {"n_atoms": self.n_atoms, "epochs": self.epochs, "seed": self.seed}
        settings = build_settings(self.preset, **changes, backend=self.backend)
        with torch_threads(self.threads):
            started = time.perf_counter()
            field = scoup.build(
                gaussians,
                cameras,
                regions,
                settings=settings,
                sources=scoup.FieldSources("simulated"),
                progress=clock,
            )
            total = time.perf_counter() - started
        yield (
            "build",
            {
                "seconds": clock.stop(),
                "total_s": total,
                "coded_gaussians": int(field.coded().sum()),
                "coding": field.info.provenance["coding"],
                "scene_memory_bytes": own[0],
                "own_memory_bytes": max(own),
            },
        )

    def record(self, rows: dict[str, Any]) -> Record:
        return rows["build"]

    @staticmethod
    def table(record: Record) -> str:
        """Return the stages as shares of the whole build."""
        stages: dict[str, float] = dict.fromkeys((*STAGES, "all else"), 0.0)
        for name, seconds in record["seconds"].items():
            stages[next((stage for stage in STAGES if stage in name), "all else")] += seconds
        total, threads = record["total_s"], record["settings"]["threads"]
        rows = [[name, f"{100 * seconds / total:.0f} %"] for name, seconds in stages.items()]
        rows.append([f"all, {threads} threads, of a minute", f"{total / 60:.2f}"])
        for said, key in (("the scene", "scene_memory_bytes"), ("at the most", "own_memory_bytes")):
            rows.append([f"own memory, {said}, GB", f"{record[key] / 1e9:.2f}"])
        return markdown(["stage", "share of the time"], rows)


def _own_memory() -> int:
    """This process's own memory in bytes, without what is mapped of files; 0 where the system does not say."""
    return memory_of(os.getpid()).get("RssAnon", 0)
