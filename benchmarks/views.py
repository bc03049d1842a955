"""What fields of chosen photographs answer, against fields of all and of evenly spaced ones."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from statistics import mean
from typing import Any, ClassVar

import numpy as np
import torch
from PIL import Image, ImageFilter

import scoup
from benchmarks.answer_scenes import AnswerScene, SceneSize, make_scene, procedural_scene
from benchmarks.data import data_folder
from benchmarks.drawn import answers_of, drawn_masks
from benchmarks.faults import as_region_sums
from benchmarks.real_scenes import FOLDERS
from benchmarks.scenes import find_layout
from benchmarks.study import Record, Study
from scoup.base.counts import spread
from scoup.extract.photograph_choice import FEW, LEAST_GAIN, rank_views, sharpness
from scoup.models.words import with_everyday
from scoup.raster import render_colors
from scoup.scene.cameras import Camera
from scoup_lab.baselines.method import MethodSettings
from scoup_lab.baselines.methods import METHODS
from scoup_lab.baselines.rasterised_scene import UpliftInputs
from scoup_lab.bench import markdown
from scoup_lab.evaluate.metrics import iou
from scoup_lab.synthetic.art.layout import Layout
from scoup_lab.synthetic.scene import DemoScene, make_demo_scene

FINE = 10_000  # steps of a path
DWELL, STRETCH = 0.6, 0.12  # share of the photographs, and of the path on which they were taken
BLURRED = 0.2  # share of the photographs
COUNTS = (16, 12, 8)  # of photographs of the real scenes
SEED = 2  # of the codebook


@dataclass(frozen=True, kw_only=True)
class Views(Study):
    """Score fields of chosen photographs against those of all and of as many evenly spaced ones.

    Dense captures of the layouts dwell on a part of the path. A fifth of their photographs is blurred, which does not
    change their regions. Regions are simulated, with independent errors in each: more photographs than real ones gain.
    The scenes of real models (`benchmarks.real_scenes`) have few photographs. mIoU is that of `scoup query --always`.
    """

    dense: tuple[str, ...] = ("table-41", "shelves-41", "hall-41", "yard-41")
    """Layouts of benchmarks.scenes with a seed."""
    real: tuple[str, ...] = tuple(FOLDERS)
    """Scenes of benchmarks.real_scenes."""
    size: SceneSize = field(default_factory=lambda: SceneSize(60_000, 320, 240, 150, 6))
    data: Path = field(default_factory=data_folder)
    """Folder of desk and of the scenes of real models."""

    rows_depend_on: ClassVar[tuple[str, ...]] = ("size",)

    def measure(self, known: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        for name in self.dense:
            if name not in known:
                yield name, _dense(name, self.size)
        for name in self.real:
            if name not in known:
                scene = make_scene(name, self.data, self.size)
                cameras = list(scoup.load_cameras(self.data / FOLDERS[name]))
                row = {"views": len(cameras), "all": _miou(scene, range(len(cameras)))}
                order = rank_views(cameras, scene.gaussians, torch.ones(len(cameras)), max(COUNTS))
                for count in COUNTS:
                    row[f"{count} chosen"] = _miou(scene, order[:count])
                    row[f"{count} even"] = _miou(scene, spread(range(len(cameras)), count))
                yield name, row

    def line(self, figures: Any) -> str:
        return "  ".join(f"{name} {value:g}" for name, value in figures.items())

    def record(self, rows: dict[str, Any]) -> Record:
        """Return the rows of each kind of scenes with their means, and what was chosen before."""
        kinds = {"dense": self.dense, "real": self.real}
        found = {kind: {name: rows[name] for name in names} for kind, names in kinds.items() if names}
        for of in found.values():
            heads = next(iter(of.values()))
            of["mean"] = {head: round(mean(row[head] for row in of.values()), 3) for head in heads}
        capture = {"share": DWELL, "of the path": STRETCH, "blurred": BLURRED}
        tuned = ["table-31", "hall-31", *FOLDERS]
        return {
            "scenes": found,
            "slow": capture,
            "always taken": FEW,
            "least gain": LEAST_GAIN,
            "tuned on": tuned,
        }

    @staticmethod
    def table(record: Record) -> str:
        return "\n\n".join(
            markdown(
                ["scene", *of["mean"]],
                [[name, *(f"{value:g}" for value in row.values())] for name, row in of.items()],
            )
            for of in record["scenes"].values()
        )


def _dense(name: str, size: SceneSize) -> Record:
    layout, seed = find_layout(name.rpartition("-")[0]), int(name.rpartition("-")[2])
    demo = make_demo_scene(seed, *size.of_procedural(), layout=_dwelling(layout, seed))
    scene, cameras = procedural_scene(name, demo), list(demo.building)
    blurred = np.random.default_rng([seed, 58]).random(len(cameras)) < BLURRED
    sharp = [_sharpness(demo, camera, bool(blur)) for camera, blur in zip(cameras, blurred, strict=True)]
    chosen = rank_views(cameras, demo.gaussians, torch.tensor(sharp))
    return {
        "views": len(cameras),
        "chosen": len(chosen),
        "blurred": round(float(blurred.mean()), 3),
        "blurred of the chosen": round(float(blurred[chosen].mean()), 3),
        "all, mIoU": _miou(scene, range(len(cameras))),
        "chosen, mIoU": _miou(scene, chosen),
        "even, mIoU": _miou(scene, spread(range(len(cameras)), len(chosen))),
    }


def _dwelling(layout: Layout, seed: int) -> Layout:
    """Return a layout whose camera moves slowly along one stretch of its path."""
    start = np.random.default_rng([seed, 57]).uniform(0, 1 - STRETCH)
    before = (1 - DWELL) * start / (1 - STRETCH)

    def path(step: int, count: int, held_out: bool, rng: np.random.Generator) -> Any:
        if held_out:
            return layout.path(step, count, held_out, rng)
        place = np.interp(
            (step + 0.5) / count, [0, before, before + DWELL, 1], [0, start, start + STRETCH, 1]
        )
        return layout.path(int(FINE * place), FINE, held_out, rng)

    return replace(layout, path=path)


def _sharpness(demo: DemoScene, camera: Camera, blurred: bool) -> float:
    image = Image.fromarray((render_colors(demo.gaussians, camera).clamp(0, 1) * 255).byte().numpy())
    return sharpness(np.asarray(image.filter(ImageFilter.GaussianBlur(1.5)) if blurred else image))


def _miou(scene: AnswerScene, views: Sequence[int]) -> float:
    """Return the mIoU of the field of some views."""
    there = sorted(views)
    levels = [level.kept(np.isin(level.views, there)) for level in scene.levels(1.0)]
    levels = [replace(level, views=np.searchsorted(there, level.views)) for level in levels]
    sums = as_region_sums(levels)
    sums.means = scene.gaussians.means
    inputs = UpliftInputs(sums, [level.embeddings for level in levels])
    fitted = METHODS["sparse"].uplift(inputs, MethodSettings(SEED))
    answers = answers_of(scene, fitted, tuple(scene.queries), with_everyday(scene.canonical, scene.everyday))
    return round(
        mean(
            iou(mask, frame.masks[label])
            for frame, view in scene.frames
            for label, mask in zip(
                frame.labels, drawn_masks([answers[label] for label in frame.labels], view), strict=True
            )
        ),
        3,
    )
