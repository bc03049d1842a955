"""The scenes of the studies of answers, each rasterised once: what is coded, what is asked, and the truth."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

import scoup
from benchmarks.embedding_kinds import KINDS
from benchmarks.kitchen_draws import Truth, make_draw
from benchmarks.other_names import names_of
from benchmarks.real_scenes import REAL_SCENES, RealScene
from benchmarks.scenes import scene_of
from scoup import raster
from scoup.base import looked_up
from scoup.models import CANONICAL_PHRASES
from scoup.scene import Camera, Cameras, Gaussians, Regions
from scoup.uplift import BuildSettings, RegionSums, region_sums
from scoup.uplift.settings import Scale
from scoup_lab.baselines.fitted import FittedField
from scoup_lab.baselines.rasterised_scene import UpliftInputs
from scoup_lab.data.labels import LabelledFrame
from scoup_lab.synthetic.scene import LABELLED_LEVELS, DemoScene
from scoup_lab.synthetic.words import CANONICAL, DISTRACTORS


@dataclass(frozen=True)
class SceneSize:
    """Sizes of scenes."""

    # n_gaussians, width, height, n_building, n_held_out: of procedural scenes; those held out are asked
    n_gaussians: int = 120_000
    width: int = 480
    height: int = 360
    n_building: int = 24
    n_held_out: int = 6
    # size of the views that kitchen is asked in, relative to the original 960 x 720
    kitchen_scale: float = 0.5

    def of_procedural(self) -> tuple[int, int, int, int, int]:
        """Return the sizes that ``make_demo_scene`` takes."""
        return self.n_gaussians, self.width, self.height, self.n_building, self.n_held_out


@dataclass(frozen=True, eq=False)
class AnswerScene:
    """A scene ready to be coded and asked."""

    name: str  # for tables
    gaussians: Gaussians  # N of them
    sums: Callable[[Scale], RegionSums]  # at a scale of the images, each made once
    seconds: dict[Scale, float]  # that each of them took
    embeddings: list[Tensor]  # per level [R, D]
    frames: list[tuple[LabelledFrame, raster.Projection]]  # labelled frames with their views; of one size
    cameras: list[Camera]  # of the labelled frames
    queries: dict[str, Tensor]  # label -> [D] unit text vector
    canonical: Tensor  # [P, D]
    everyday: Tensor  # [B, D] unit vectors of everyday words, the labels among them
    words: tuple[str, ...]  # the everyday words
    absent: tuple[str, ...]  # those of them that nothing in the scene is called
    names: Mapping[str, tuple[str, ...]]  # label -> all its names among the words, itself first
    # What was scored before: ways and rules often have the same codes, and give the same answers.
    known_overlaps: dict[tuple[str, bytes, bytes], list[tuple[int, int]]] = field(default_factory=dict)
    known_relevancy: list[tuple[FittedField, dict[str, list[float]]]] = field(default_factory=list)

    @property
    def pairs(self) -> list[tuple[str, str]]:
        """(frame, label) in the order they are scored."""
        return [(frame.name, label) for frame, _ in self.frames for label in frame.labels]

    def inputs(self, scale: Scale = "auto") -> UpliftInputs:
        """Return what methods are fitted to; no codes are kept in it yet."""
        return UpliftInputs(self.sums(scale), self.embeddings)


class DrawName(NamedTuple):
    """A draw of the kitchen by the name of its scene: "kitchen-3", "kitchen-3x2" with noise twice as strong,
    "kitchen-3-desk" with embeddings of a kind."""

    seed: int
    noise: float
    kind: str | None

    @classmethod
    def parse(cls, name: str) -> DrawName | None:
        """Parse the name of a scene; none if it is not a draw of the kitchen."""
        found = re.fullmatch(r"kitchen-(\d+)(?:x(\d+(?:\.\d+)?))?(?:-(\w+))?", name)
        if not found:
            return None
        seed, noise, kind = found.groups()
        if kind is not None:
            looked_up("kind of embeddings", kind, KINDS)
        return cls(int(seed), float(noise or 1), kind)

    def __str__(self) -> str:
        return f"kitchen-{self.seed}x{self.noise:g}" + (f"-{self.kind}" if self.kind else "")


def make_scene(name: str, data: Path, size: SceneSize) -> AnswerScene:
    """Return a scene by name: a draw of the kitchen (``DrawName``, ``benchmarks.kitchen_draws``), a scene of real
    models (``benchmarks.real_scenes``), or a layout of ``benchmarks.scenes`` and a seed, such as "shelves-0"."""
    if name in REAL_SCENES:
        return with_splat(RealScene.open(name, data), name)
    draw = DrawName.parse(name)
    if draw is not None:
        return _kitchen_draw(data, draw, size.kitchen_scale)
    return _procedural_scene(name, scene_of(name, *size.of_procedural()))


def _procedural_scene(name: str, demo: DemoScene) -> AnswerScene:
    labelled = [(demo.labelled_frame(camera.name, LABELLED_LEVELS), camera) for camera in demo.held_out]
    frames = [(frame, camera) for frame, camera in labelled if frame.labels]
    words = tuple(word for word in demo.words.texts if word not in CANONICAL)
    texts = Texts(demo.canonical, words, demo.text_vectors(words), DISTRACTORS)
    return prepared(name, demo.gaussians, demo.building, demo.regions, frames, texts)


def _kitchen_draw(data: Path, name: DrawName, scale: float) -> AnswerScene:
    truth = Truth.open(data, scale)
    draw = make_draw(truth, name.seed, name.noise, KINDS[name.kind] if name.kind else None)
    texts = texts_of(data, truth)
    return prepared(str(name), truth.gaussians, truth.cameras, draw.regions, draw.frames, texts)


def with_splat(scene: RealScene, name: str = "") -> AnswerScene:
    """Return a scene of real models with its Gaussians."""
    texts = Texts(scene.canonical, scene.words, scene.everyday, scene.absent)
    return prepared(name, scene.gaussians(), scene.cameras, scene.regions, scene.frames, texts)


class Texts(NamedTuple):
    """The text vectors of a scene: canonical phrases [P, D], and everyday words [B, D] with those that are absent."""

    canonical: Tensor
    words: tuple[str, ...]
    everyday: Tensor
    absent: tuple[str, ...]


def texts_of(data: Path, truth: Truth) -> Texts:
    """Return the text vectors of the kitchen."""
    encoder = scoup.TextEncoder.open(data / "clip" / "text_vit_b16_laion2b.npz")
    words = tuple(name for name in encoder.names or () if name not in CANONICAL_PHRASES)
    return Texts(encoder.canonical(), words, encoder.encode(words), truth.absent(words))


def prepared(
    name: str,
    gaussians: Gaussians,
    cameras: Cameras,
    regions: Regions,
    frames: list[tuple[LabelledFrame, Camera]],
    texts: Texts,
) -> AnswerScene:
    """Return a scene with the region sums of its cameras."""

    seconds: dict[Scale, float] = {}

    @cache
    def sums(scale: Scale) -> RegionSums:
        started = time.perf_counter()
        made = region_sums(gaussians, cameras, regions, BuildSettings(scale=scale))
        seconds[scale] = time.perf_counter() - started
        return made

    everyday = torch.nn.functional.normalize(texts.everyday, dim=1)
    labels = sorted({label for frame, _ in frames for label in frame.labels})
    return AnswerScene(
        name,
        gaussians,
        sums,
        seconds,
        [regions.embeddings(level)[0] for level in regions.levels],
        [(frame, raster.project(gaussians, camera)) for frame, camera in frames],
        [camera for _, camera in frames],
        {label: everyday[texts.words.index(label)] for label in labels},
        texts.canonical,
        everyday,
        texts.words,
        texts.absent,
        names_of(labels, texts.words) if name in REAL_SCENES else {label: (label,) for label in labels},
    )
