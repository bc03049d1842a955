"""A small scene of random regions with two labelled views, for studies and methods."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import torch

from scoup.query import TextVectors
from scoup.scene import Regions
from scoup_lab.baselines.rasterised_scene import RasterisedScene
from scoup_lab.data.labels import LabelledFrame
from scoup_lab.evaluate.protocols.lerf_ovs import PROTOCOL
from scoup_lab.evaluate.protocols.pixels import LabelledScene
from scoup_lab.evaluate.studies.study_scene import StudyScene
from support import small_scene

LABELS = ("cup", "pot")


def study_scene(
    name: str, folder: Path, vectors: Callable[[LabelledScene, Regions], TextVectors], seed: int = 0
) -> StudyScene:
    """Four views, two of them labelled: each label is a region of the middle level."""
    gaussians, cameras, regions = small_scene(120, seed=seed)
    frames = []
    for camera in list(cameras)[:2]:
        found = regions.load(camera.name, "m").labels
        masks = {label: found == number for number, label in enumerate(LABELS)}
        boxes = {label: torch.tensor([[0.0, 0.0, 39.0, 29.0]]) for label in LABELS}
        frames.append((LabelledFrame(camera.name, 40, 30, masks, boxes), camera))
    labelled = LabelledScene(name, folder, folder, folder, cameras, PROTOCOL, frames)
    return StudyScene(labelled, vectors(labelled, regions), RasterisedScene(gaussians, cameras, regions))
