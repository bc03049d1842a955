"""How like the real scene desk simulated scenes are: embeddings of regions, and faults of masks."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import mean
from typing import Any

import numpy as np
import torch

from benchmarks.data import data_folder
from benchmarks.embedding_kinds import KINDS
from benchmarks.extract import FOUND
from benchmarks.kitchen_draws import Truth, make_draw
from benchmarks.mask_rules import FATES, fate
from benchmarks.real_scenes import RealScene
from benchmarks.study import Record, Study
from scoup.scene.cameras import Camera
from scoup.scene.regions import LEVELS, Regions
from scoup_lab.bench import markdown
from scoup_lab.data.labels import LabelledFrame
from scoup_lab.synthetic.art.meshes import Floats
from scoup_lab.synthetic.words import unit

COLUMNS = {
    "regions": "regions per view",
    "within": "cosine within a thing",
    "between": "between things",
    "own": "with its name",
    "others": "with other names",
    **{name: name for name in FATES[:3]},
}


@dataclass(frozen=True, kw_only=True)
class Likeness(Study):
    """Compare regions of draws of the kitchen with those of the real desk, per level.

    Only labelled things in labelled views count. A thing's region is the one with the largest IoU, from 0.5. Cosines:
    medians between regions of one thing in two views, and between mean embeddings of two things; means between a region
    and names.
    """

    seeds: tuple[int, ...] = (1, 2)
    """Draws of each kind; figures are means over them."""
    data: Path = field(default_factory=data_folder)
    """Folder that contains kitchen/, clip/ and desk/."""

    def measure(self, known: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        for name in ("desk", "desk-all"):
            if name not in known:
                desk = RealScene.open(name, self.data)
                words = dict(zip(desk.words, desk.everyday.numpy(), strict=True))
                yield name, likeness(desk.regions, desk.frames, words)
        truth = Truth.open(self.data, 1.0)
        for suffix, kind in {"": None, **{f"-{name}": kind for name, kind in KINDS.items()}}.items():
            if f"kitchen{suffix}" not in known:
                draws = [make_draw(truth, seed, kind=kind) for seed in self.seeds]
                each = [likeness(draw.regions, draw.frames, truth.words) for draw in draws]
                yield (
                    f"kitchen{suffix}",
                    {
                        level: {key: mean(one[level][key] for one in each) for key in COLUMNS}
                        for level in LEVELS
                    },
                )

    @staticmethod
    def table(record: Record) -> str:
        """Return one row per scene and level."""
        body = [
            [name, level, f"{of['regions']:.0f}", *(f"{of[key]:.2f}" for key in list(COLUMNS)[1:])]
            for name, levels in record["rows"].items()
            for level, of in levels.items()
        ]
        return markdown(["scene", "level", *COLUMNS.values()], body)


def likeness(
    regions: Regions, frames: Sequence[tuple[LabelledFrame, Camera]], words: Mapping[str, Floats]
) -> dict[str, dict[str, float]]:
    """Compare regions with the labels of their views: level -> key of ``COLUMNS`` -> figure.

    ``words``: label -> [D] unit text vector.
    """
    labels = sorted({label for frame, _ in frames for label in frame.labels})
    vectors = np.stack([words[label] for label in labels])
    found = {}
    for place, level in enumerate(regions.levels):
        of_thing: dict[str, list[Floats]] = defaultdict(list)
        counts: list[int] = []
        fates: list[str] = []
        for frame, camera in frames:
            shown = regions.load_labels(camera.name, frame.width, frame.height)[place].numpy()
            rows = torch.nn.functional.normalize(regions.load_embeddings(camera.name, level), dim=1).numpy()
            counts.append(len(rows))
            for label, mask in frame.masks.items():
                truth = mask.numpy()
                number, iou, became = fate(shown, truth)
                fates.append(became)
                if iou >= FOUND:
                    of_thing[label].append(rows[number])
        found[level] = {
            "regions": mean(counts),
            **_cosines(of_thing, labels, vectors),
            **{name: fates.count(name) / len(fates) for name in FATES[:3]},
        }
    return found


def _cosines(
    of_thing: Mapping[str, list[Floats]], labels: Sequence[str], vectors: Floats
) -> dict[str, float]:
    """Return the figures of embeddings: of the regions of each thing, and text vectors [L, D] of all labels."""
    stacked = {label: np.stack(rows) for label, rows in of_thing.items()}
    within = np.concatenate([_pairs(rows) for rows in stacked.values()])
    cosines = np.concatenate([rows @ vectors.T for rows in stacked.values()])
    own = np.concatenate(
        [np.tile(np.array(labels) == label, (len(rows), 1)) for label, rows in stacked.items()]
    )
    means = unit(np.stack([rows.mean(0) for rows in stacked.values()]))
    figures = {
        "within": np.median(within),
        "between": np.median(_pairs(means)),
        "own": cosines[own].mean(),
        "others": cosines[~own].mean(),
    }
    return {key: float(value) for key, value in figures.items()}


def _pairs(rows: Floats) -> Floats:
    return (rows @ rows.T)[np.triu_indices(len(rows), 1)]
