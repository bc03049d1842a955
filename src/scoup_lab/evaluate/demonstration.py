"""The demo: make a scene, write it as files, build a field from the files, query it for every name, and score it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch

from scoup.base import Progress, no_progress
from scoup.io import load_cameras, load_gaussians, load_regions
from scoup.query import LanguageField, Question, TextVectors, build
from scoup.uplift import BuildSettings, FieldSources
from scoup_lab.bench.measure import Stopwatch
from scoup_lab.evaluate.metrics import any_inside, iou
from scoup_lab.evaluate.pixel_report import query_records
from scoup_lab.evaluate.scores import PairScore, SceneScore
from scoup_lab.synthetic.art.layout import Layout
from scoup_lab.synthetic.art.table import TABLE
from scoup_lab.synthetic.folder import write_demo_scene
from scoup_lab.synthetic.scene import LABELLED_LEVELS, DemoScene, make_demo_scene
from scoup_lab.synthetic.words import CANONICAL


@dataclass(frozen=True, eq=False)
class DemoResult:
    """The demo's scene, field and scores."""

    scene: DemoScene  # the scene and its truth
    field: LanguageField  # the field built
    score: SceneScore  # as `scoup query --always` answers, every named thing in sight in the held-out views
    seconds: dict[str, float]  # by stage, in the order they ran


@dataclass(frozen=True)
class NameRow:
    """The scores of one name over all held-out views that show it."""

    name: str  # the query
    views: int  # how many views
    iou: float  # mean
    accuracy: float  # share of hits
    levels: dict[str, int]  # how often each level was chosen, "s", "m", "l"


def run_demo(
    out: Path,
    seed: int,
    n_gaussians: int,
    width: int,
    height: int,
    n_building: int,
    layout: Layout = TABLE,
    progress: Progress = no_progress,
) -> DemoResult:
    """Run everything. New files go to ``out/scene`` and ``out/demo.scoup``.

    ``seed``: of the scene and of the codebook; a quarter as many views as ``n_building`` are held out for scoring.
    """
    clock = Stopwatch()
    size = n_gaussians, width, height, n_building, max(1, n_building // 4)
    scene = clock("make the scene", make_demo_scene, seed, *size, layout)
    folder = clock("write it as files", write_demo_scene, scene, out / "scene", progress=progress)
    field = clock("read the files, and build the field", _built, folder, seed, progress)
    field.save(out / "demo.scoup")
    score = clock("query and score", answered, field, scene)
    return DemoResult(scene, field, score, {stage: sum(times) for stage, times in clock.seconds.items()})


def _built(folder: Path, seed: int, progress: Progress) -> LanguageField:
    splat, cameras = folder / "point_cloud.ply", load_cameras(folder)
    return build(
        load_gaussians(splat),
        cameras,
        load_regions(folder, cameras),
        settings=BuildSettings(seed=seed),
        sources=FieldSources(words=folder / "text.npz", geometry_path=splat),
        progress=progress,
    )


def question_of(scene: DemoScene, labels: Sequence[str]) -> Question[list[str]]:
    """Return labels beside all words that have a vector, as `scoup query` compares them; presence is not judged."""
    words = [word for word in scene.words.texts if word not in CANONICAL]
    everyday = scene.text_vectors(words)
    vectors = TextVectors(tuple(labels), scene.text_vectors(list(labels)), scene.canonical, everyday)
    return Question.from_vectors(vectors.with_everyday())


def answered(field: LanguageField, scene: DemoScene) -> SceneScore:
    """Score what the field answers in the held-out views; presence is not judged."""
    pairs = []
    for camera in scene.held_out:
        frame = scene.labelled_frame(camera.name, LABELLED_LEVELS)
        for answer in field.at(camera).answer(question_of(scene, frame.labels)) if frame.labels else ():
            point = torch.tensor([answer.point or (-1, -1)])
            hit = any_inside(point, frame.boxes[answer.text])
            level = field.level_index(answer.level)
            overlap = iou(answer.mask, frame.masks[answer.text])
            pairs.append(
                PairScore(frame.name, answer.text, overlap, hit, level, answer.score or 0.0, answer.point)
            )
    return SceneScore("", "default", tuple(pairs))


def rows_by_name(result: DemoResult) -> list[NameRow]:
    """Return one row per name, best IoU first."""
    levels = result.field.levels
    return [
        NameRow(
            of["query"],
            of["frames"],
            of["miou"],
            of["accuracy"],
            {levels[level]: count for level, count in of["levels"]},
        )
        for of in reversed(query_records(result.score))
    ]
