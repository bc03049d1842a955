"""The demo: make a scene, write it as files, build a field from the files, query it for every name, and score it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import mean

import torch

from scoup.base.progress import Progress, no_progress
from scoup.field.language_field import LanguageField
from scoup.io import load_cameras, load_gaussians, load_regions
from scoup.query.question import Question, TextVectors
from scoup.uplift.build import build
from scoup.uplift.build_settings import BuildSettings
from scoup.uplift.rasterise import region_sums
from scoup_lab.baselines.fitted import FittedField, FittedMethod
from scoup_lab.baselines.method import MethodSettings
from scoup_lab.baselines.methods import METHODS
from scoup_lab.baselines.rasterised_scene import RasterisedScene
from scoup_lab.bench.measure import timed
from scoup_lab.evaluate.metrics import any_inside, bootstrap_interval, iou
from scoup_lab.evaluate.protocols.lerf_ovs import PROTOCOL
from scoup_lab.evaluate.protocols.pixels import LabelledScene
from scoup_lab.evaluate.rules import MASK_RULES
from scoup_lab.evaluate.scores import PairScore, SceneScore
from scoup_lab.evaluate.studies.study_scene import StudyScene
from scoup_lab.synthetic.art.layout import Layout
from scoup_lab.synthetic.art.table import TABLE
from scoup_lab.synthetic.folder import write_demo_scene
from scoup_lab.synthetic.scene import LABELLED_LEVELS, DemoScene, make_demo_scene
from scoup_lab.synthetic.words import CANONICAL

METHOD, VOTES = "things", "sparse, top-K vote"
ALL_ATOMS, DENSE = "sparse, no top-K", "dense 512-d"
"""The first as `scoup query --always` answers, the others by the paper's rule for LERF-OVS."""


@dataclass(frozen=True)
class DemoSettings:
    """Sizes of the demo."""

    seed: int = 0  # of the scene and of the codebook
    n_gaussians: int = 160_000  # of the scene
    width: int = 480  # of its views, in pixels
    height: int = 360
    n_building: int = 24  # views the field is built from; a quarter as many are held out for scoring
    layout: Layout = TABLE  # the kind of scene


@dataclass(frozen=True, eq=False)
class DemoResult:
    """The demo's scene, field and scores."""

    scene: DemoScene  # the scene and its truth
    field: LanguageField  # the field built
    field_path: Path  # its file
    scores: dict[str, SceneScore]  # by method, over every named thing in sight in the held-out views
    bytes_per_gaussian: dict[str, float]  # by method
    seconds: dict[str, float]  # by stage, in the order they ran


@dataclass(frozen=True)
class NameRow:
    """The scores of one name over all held-out views that show it."""

    name: str  # the query
    views: int  # how many views
    iou: dict[str, float]  # mean by method
    accuracy: dict[str, float]  # share of hits by method
    levels: dict[str, int]  # how often each level was chosen by ours, "s", "m", "l"


def run_demo(out: Path, settings: DemoSettings, progress: Progress = no_progress) -> DemoResult:
    """Run everything. New files go to ``out/scene`` and ``out/demo.scoup``."""
    path = out / "demo.scoup"
    build_settings = BuildSettings(seed=settings.seed)
    seconds: dict[str, float] = {}
    with timed(seconds, "make the scene"):
        scene = make_demo_scene(
            settings.seed,
            settings.n_gaussians,
            settings.width,
            settings.height,
            settings.n_building,
            max(1, settings.n_building // 4),
            settings.layout,
        )
    with timed(seconds, "write it as files"):
        folder = write_demo_scene(scene, out / "scene", progress=progress)
    with timed(seconds, "read the files"):
        splat = folder / "point_cloud.ply"
        gaussians = load_gaussians(splat)
        cameras = load_cameras(folder)
        regions = load_regions(folder, cameras)
    with timed(seconds, "rasterise: region sums of all views"):
        sums = region_sums(gaussians, cameras, regions, progress=progress)
    with timed(seconds, "build the field: coding and vote"):
        field = build(
            gaussians,
            cameras,
            regions,
            settings=build_settings,
            words=folder / "text.npz",
            geometry_path=splat,
            sums=sums,
            progress=progress,
        )
    field.save(path)
    rasterised = RasterisedScene(gaussians, cameras, regions, sums=sums)
    with timed(seconds, "no top-K and dense 512-d uplift, to compare"):
        fitted = _fitted(rasterised, field, build_settings)
    with timed(seconds, "query and score all four"):
        labelled = _labelled(scene, folder)
        study = StudyScene(labelled, _vectors(scene, labelled.labels), rasterised)
        scores = {}
        progress("scoring", 0, len(fitted))
        for name, method in fitted.items():
            scores[name] = study.score(method, MASK_RULES["scoup"])
            progress("scoring", len(scores), len(fitted))
        scores = {METHOD: answered(field, scene, labelled), **scores}
    sizes = {name: method.bytes_per_gaussian for name, method in fitted.items()}
    sizes = {METHOD: sizes[VOTES], **sizes}
    return DemoResult(scene, field, path, scores, sizes, seconds)


def _fitted(scene: RasterisedScene, field: LanguageField, settings: BuildSettings) -> dict[str, FittedMethod]:
    """Return the field, the same without the top-K step, and dense uplift."""
    return {
        VOTES: FittedField(field),
        ALL_ATOMS: METHODS["sparse-all"].fit(scene, MethodSettings(settings.seed, settings)),
        DENSE: METHODS["dense"].fit(scene),
    }


def _labelled(scene: DemoScene, folder: Path) -> LabelledScene:
    """Return the held-out views with their labels."""
    frames = [(scene.labelled_frame(camera.name, LABELLED_LEVELS), camera) for camera in scene.held_out]
    return LabelledScene("", folder, folder, folder, scene.held_out, PROTOCOL, frames)


def question_of(scene: DemoScene, labels: Sequence[str]) -> Question[list[str]]:
    """Return labels beside all words that have a vector, as `scoup query` compares them; presence is not judged."""
    words = [word for word in scene.words.texts if word not in CANONICAL]
    everyday = scene.text_vectors(words)
    vectors = TextVectors(tuple(labels), scene.text_vectors(list(labels)), scene.canonical, everyday)
    return Question.from_vectors(vectors.with_everyday())


def answered(field: LanguageField, scene: DemoScene, labelled: LabelledScene) -> SceneScore:
    """Score what the field answers in the labelled views; presence is not judged."""
    pairs = []
    for frame, camera in labelled.frames:
        for answer in field.at(camera).answer(question_of(scene, frame.labels)) if frame.labels else ():
            point = torch.tensor([answer.point or (-1, -1)])
            hit = any_inside(point, frame.boxes[answer.text])
            level = field.level_index(answer.level)
            found = iou(answer.mask, frame.masks[answer.text])
            pairs.append(
                PairScore(frame.name, answer.text, found, hit, level, answer.score or 0.0, answer.point)
            )
    return SceneScore("", "default", tuple(pairs))


def _vectors(scene: DemoScene, labels: list[str]) -> TextVectors:
    canonical = scene.canonical
    return TextVectors(tuple(labels), scene.text_vectors(labels), canonical, canonical[:0])


def rows_by_name(result: DemoResult) -> list[NameRow]:
    """Return one row per name, best IoU of ours first."""
    by_name: dict[str, dict[str, list[PairScore]]] = {}
    for method, score in result.scores.items():
        for pair in score.pairs:
            by_name.setdefault(pair.label, {}).setdefault(method, []).append(pair)
    rows = [
        NameRow(
            name,
            len(pairs[METHOD]),
            {method: mean(pair.iou for pair in of_method) for method, of_method in pairs.items()},
            {method: mean(bool(pair.hit) for pair in of_method) for method, of_method in pairs.items()},
            dict(Counter(result.field.levels[pair.level] for pair in pairs[METHOD])),
        )
        for name, pairs in by_name.items()
    ]
    return sorted(rows, key=lambda row: -row.iou[METHOD])


def summary(result: DemoResult) -> dict[str, dict[str, float | list[float]]]:
    """Return by method mIoU with its 95 % interval over names, localisation accuracy, bytes per Gaussian."""
    table = {}
    for method, score in result.scores.items():
        interval = bootstrap_interval(
            [pair.iou for pair in score.pairs], [pair.label for pair in score.pairs]
        )
        table[method] = {
            "miou": score.miou,
            "interval": [interval.low, interval.high],
            "accuracy": score.accuracy,
            "bytes_per_gaussian": result.bytes_per_gaussian[method],
        }
    return table
