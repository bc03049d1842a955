"""How like the given kitchen, and how like desk, draws of the kitchen are."""

from __future__ import annotations

import tempfile
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, astuple, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

import scoup
from benchmarks.data import data_folder, make_features
from benchmarks.desk import DESKS, Desk
from benchmarks.embedding_kinds import KINDS
from benchmarks.kitchen_draws import Truth, make_draw
from benchmarks.study import Record, Study
from scoup.scene.cameras import Camera
from scoup.scene.regions import LEVELS, Regions
from scoup_lab.bench import markdown
from scoup_lab.data.labels import LabelledFrame, match_frames, read_labels
from scoup_lab.synthetic.art.meshes import Floats
from scoup_lab.synthetic.observe import IntMap
from scoup_lab.synthetic.words import unit


@dataclass(frozen=True)
class Likeness:
    """What scenes can be compared by, at one level.

    A thing's region in a labelled view is the one with the largest IoU with its mask. Below ``OWN_REGION`` the thing
    has none there.

    Attributes:
        regions: per labelled view.
        within, within_5: median and 5th percentile of the cosine of one thing's regions in two views.
        between: median cosine of the mean embeddings of two things.
        own, own_spread: mean and standard deviation of the cosine of a thing's region with its own name.
        others, others_spread: the same with the names of other labelled things.
        without: share of the labelled (view, thing) pairs in which the thing has no region.
    """

    regions: float
    within: float
    within_5: float
    between: float
    own: float
    own_spread: float
    others: float
    others_spread: float
    without: float


OWN_REGION = 0.5
COLUMNS = (
    "regions per view", "within a thing", "5 %", "between things", "own name", "sd", "other names", "sd",
    "no own region",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Draws(Study):
    """Compare draws of the kitchen with the given scene and with desk: how alike regions of one thing are, and how near
    their names."""

    seeds: tuple[int, ...] = (1, 2, 3)
    """Draws to describe, as means over them."""
    data: Path = field(default_factory=data_folder)
    """Folder that contains kitchen/ and clip/, and perhaps desk/."""

    def measure(self, known: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        truth = Truth.open(self.data, 1.0)
        kitchen = self.data / "kitchen"
        with tempfile.TemporaryDirectory() as folder:
            regions = scoup.load_regions(make_features(kitchen, Path(folder)), truth.cameras)
            frames = match_frames(read_labels(kitchen / "label"), truth.cameras)
            yield "kitchen", _plain(likeness(regions, frames, truth.words))
        for suffix, kind in {"": None, **{f"-{name}": kind for name, kind in KINDS.items()}}.items():
            draws = [make_draw(truth, seed, kind=kind) for seed in self.seeds]
            each = [likeness(draw.regions, draw.frames, truth.words) for draw in draws]
            means = {level: np.mean([astuple(one[level]) for one in each], 0).tolist() for level in LEVELS}
            yield f"draws{suffix}", _plain({level: Likeness(*values) for level, values in means.items()})
        for name in DESKS if (self.data / "desk").is_dir() else ():
            desk = Desk.open(name, self.data)
            words = dict(zip(desk.words, desk.everyday.numpy(), strict=True))
            yield name, _plain(likeness(desk.regions, desk.frames, words))

    @staticmethod
    def table(record: Record) -> str:
        body = [
            [name, level, f"{of['regions']:.0f}", *(f"{value:.3f}" for value in list(of.values())[1:])]
            for name, levels in record["rows"].items()
            for level, of in levels.items()
        ]
        return markdown(["scene", "level", *COLUMNS], body)


def likeness(
    regions: Regions, frames: Sequence[tuple[LabelledFrame, Camera]], words: Mapping[str, Floats]
) -> dict[str, Likeness]:
    """Compare regions with the labels of their views, per level; ``words`` has the [D] unit vector of each label."""
    labels = sorted({label for frame, _ in frames for label in frame.labels})
    vectors = np.stack([words[label] for label in labels])
    found = {}
    for place, level in enumerate(regions.levels):
        of_thing: dict[str, list[Floats]] = defaultdict(list)
        count, pairs = 0, 0
        for frame, camera in frames:
            shown = regions.load_labels(camera.name, frame.width, frame.height)[place].numpy()
            rows = torch.nn.functional.normalize(regions.load_embeddings(camera.name, level), dim=1).numpy()
            count, pairs = count + len(rows), pairs + len(frame.labels)
            for label, mask in frame.masks.items():
                number = _own_region(shown, mask.numpy(), len(rows))
                if number is not None:
                    of_thing[label].append(rows[number])
        stacked = {label: np.stack(rows) for label, rows in of_thing.items()}
        within = np.concatenate([_pair_cosines(rows) for rows in stacked.values()])
        cosines = np.concatenate([rows @ vectors.T for rows in stacked.values()])
        mine = np.concatenate(
            [np.tile(np.array(labels) == label, (len(stacked[label]), 1)) for label in stacked]
        )
        found[level] = Likeness(
            count / len(frames),
            float(np.median(within)),
            float(np.quantile(within, 0.05)),
            float(np.median(_pair_cosines(unit(np.stack([rows.mean(0) for rows in stacked.values()]))))),
            *(float(value) for of in (cosines[mine], cosines[~mine]) for value in (of.mean(), of.std())),
            without=1 - len(cosines) / pairs,
        )
    return found


def _own_region(shown: IntMap, mask: NDArray[np.bool_], count: int) -> int | None:
    """The region with the largest IoU with a mask, if that is at least ``OWN_REGION``."""
    both = np.bincount(shown[mask & (shown >= 0)], minlength=count)
    ious = both / (np.bincount(shown[shown >= 0], minlength=count) + mask.sum() - both)
    return int(ious.argmax()) if ious.max() >= OWN_REGION else None


def _pair_cosines(rows: Floats) -> Floats:
    return (rows @ rows.T)[np.triu_indices(len(rows), 1)]


def _plain(levels: Mapping[str, Likeness]) -> Record:
    return {level: asdict(values) for level, values in levels.items()}
