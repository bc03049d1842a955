"""The scenes of benchmarks/voting.py, each rasterised once: what is coded, what is asked, and the truth."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

import scoup
from benchmarks.kitchen import make_features
from benchmarks.scenes import find_layout
from scoup import raster
from scoup.io.labels import LabelledFrame, match_frames, read_labels
from scoup.scene.cameras import Camera, Cameras
from scoup.scene.gaussians import Gaussians
from scoup.scene.regions import Regions
from scoup.synthetic.faults import LevelSums, gaussians_by_name, level_sums
from scoup.synthetic.scene import LABELLED_LEVELS, make_demo_scene
from scoup.uplift.rasterise import region_sums


@dataclass(frozen=True)
class SceneSize:
    """How large scenes are made.

    Attributes:
        n_gaussians, width, height, n_building, n_held_out: of procedural scenes; those held out are asked.
        kitchen_scale: size of the views that kitchen is asked in, relative to the original 960 x 720.
    """

    n_gaussians: int = 120_000
    width: int = 480
    height: int = 360
    n_building: int = 24
    n_held_out: int = 6
    kitchen_scale: float = 0.5


@dataclass(frozen=True, eq=False)
class VotingScene:
    """A scene ready to be coded and asked.

    Attributes:
        name: for tables.
        gaussians: N of them.
        levels: region sums and embeddings, fine to coarse.
        frames: labelled frames with their views; of one size.
        queries: label -> [D] unit text vector.
        canonical: [P, D].
        shares: which Gaussians belong to each label (``gaussians_by_name``).
    """

    name: str
    gaussians: Gaussians
    levels: list[LevelSums]
    frames: list[tuple[LabelledFrame, raster.Projection]]
    queries: dict[str, Tensor]
    canonical: Tensor
    shares: dict[str, np.ndarray]

    @property
    def pairs(self) -> list[tuple[str, str]]:
        """(frame, label) in the order they are scored."""
        return [(frame.name, label) for frame, _ in self.frames for label in frame.labels]


def make_scene(name: str, data: Path, size: SceneSize) -> VotingScene:
    """A scene by name: "kitchen", or a layout of ``benchmarks.scenes`` and a seed, such as "shelves-0"."""
    if name == "kitchen":
        return _kitchen(data, size.kitchen_scale)
    layout, _, seed = name.rpartition("-")
    demo = make_demo_scene(
        int(seed),
        size.n_gaussians,
        size.width,
        size.height,
        size.n_building,
        size.n_held_out,
        find_layout(layout),
    )
    labelled = [(demo.labelled_frame(camera.name, LABELLED_LEVELS), camera) for camera in demo.held_out]
    frames = [(frame, camera) for frame, camera in labelled if frame.labels]
    labels = _labels(frames)
    vectors = dict(zip(labels, demo.text_vectors(labels), strict=True))
    return _prepared(name, demo.gaussians, demo.building, demo.regions, frames, vectors, demo.canonical)


def _kitchen(data: Path, scale: float) -> VotingScene:
    kitchen = data / "kitchen"
    gaussians = scoup.load_gaussians(kitchen / "scene" / "model.splat")
    cameras = scoup.load_cameras(kitchen)
    frames = [
        (frame.resized(camera.width, camera.height), camera)
        for frame, camera in match_frames(read_labels(kitchen / "label"), cameras.scaled(scale))
    ]
    labels = _labels(frames)
    encoder = scoup.TextEncoder.open(data / "clip" / "text_vit_b16_laion2b.npz")
    vectors = dict(zip(labels, encoder.encode(labels), strict=True))
    with tempfile.TemporaryDirectory() as folder:
        regions = scoup.load_regions(make_features(kitchen, Path(folder)), cameras)
        canonical = encoder.canonical()
        return _prepared("kitchen", gaussians, cameras, regions, frames, vectors, canonical)


def _prepared(
    name: str,
    gaussians: Gaussians,
    cameras: Cameras,
    regions: Regions,
    frames: list[tuple[LabelledFrame, Camera]],
    queries: dict[str, Tensor],
    canonical: Tensor,
) -> VotingScene:
    levels = level_sums(region_sums(gaussians, cameras, regions), regions)
    return VotingScene(
        name,
        gaussians,
        levels,
        [(frame, raster.project(gaussians, camera)) for frame, camera in frames],
        {label: torch.nn.functional.normalize(vector, dim=0) for label, vector in queries.items()},
        canonical,
        gaussians_by_name(gaussians, frames),
    )


def _labels(frames: list[tuple[LabelledFrame, Camera]]) -> list[str]:
    return sorted({label for frame, _ in frames for label in frame.labels})
