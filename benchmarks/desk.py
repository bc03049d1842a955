"""The real scene "desk": photographs, regions, embeddings and labels, none of them simulated."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

import scoup
from scoup.models.words import CANONICAL_PHRASES
from scoup.scene.cameras import Camera, Cameras
from scoup.scene.regions import Regions
from scoup_lab.data.labels import LabelledFrame, match_frames, read_labels

DESKS = {"desk": "language_features", "desk-all": "language_features_all"}
"""Name of the scene -> folder of its regions: the same masks, with embeddings pooled in two ways."""


@dataclass(frozen=True, eq=False)
class Desk:
    """The scene without its Gaussians."""

    cameras: Cameras
    regions: Regions
    frames: list[tuple[LabelledFrame, Camera]]  # labelled photographs with their cameras
    words: tuple[str, ...]  # all names that have a text vector but the canonical phrases
    everyday: Tensor  # [words, D] their unit text vectors
    canonical: Tensor  # [P, D]
    absent: tuple[str, ...]  # those words that nothing in the scene is called

    @classmethod
    def open(cls, name: str, data: Path) -> Desk:
        """Open a scene of ``DESKS`` from the folder that contains desk/."""
        root = data / "desk"
        cameras = scoup.load_cameras(root)
        frames = [
            (frame.resized(camera.width, camera.height), camera)
            for frame, camera in match_frames(read_labels(root / "label"), cameras)
        ]
        encoder = scoup.TextEncoder.open(root / "desk_words.npz")
        words = tuple(word for word in encoder.names or () if word not in CANONICAL_PHRASES)
        return cls(
            cameras,
            scoup.load_regions(root / DESKS[name], cameras),
            frames,
            words,
            torch.nn.functional.normalize(encoder.encode(words), dim=1),
            encoder.canonical(),
            tuple(json.loads((root / "words.json").read_text())["absent"]),
        )
