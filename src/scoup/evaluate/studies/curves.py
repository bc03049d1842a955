"""Accuracy against what goes wrong: masks that shift or are missing, embeddings that are noisy or another thing's,
fewer views. Every method meets the same faults."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import mean
from typing import Any

import numpy as np
import torch
from scipy import ndimage

from scoup.base.errors import looked_up
from scoup.base.progress import Progress, no_progress
from scoup.baselines.methods import DEFAULTS, Method, MethodSettings
from scoup.evaluate.scores import SceneScore
from scoup.evaluate.studies.comparison import paired_difference, signed
from scoup.evaluate.studies.rasterised import PreparedScene, Rule
from scoup.evaluate.tables import CAVEATS, Table, miou_interval
from scoup.pictures.colors import Picture
from scoup.pictures.plots import Series, line_plot
from scoup.query.presets import QueryPreset
from scoup.scene.regions import RegionMap, Regions
from scoup.synthetic.faults import LevelSums, as_region_sums, level_sums, perturbed
from scoup.uplift.region_sums import RegionSums

SMOOTHNESS = 6.0  # pixels of an image 480 wide: how far displacements of neighbouring pixels go together


@dataclass(frozen=True)
class Fault:
    """Something that goes wrong, more and more.

    Attributes:
        name: short, for file names.
        label: of the plot's axis.
        strengths: in units of the label; the first is none at all.
    """

    name: str
    label: str
    strengths: tuple[float, ...]


FAULTS: dict[str, Fault] = {
    fault.name: fault
    for fault in (
        Fault(
            "masks",
            "displacement of mask borders, pixels of an image 480 wide (standard deviation)",
            (0, 2, 4, 8),
        ),
        Fault("missing", "share of masks missing, %", (0, 20, 40, 60)),
        Fault("noise", "length of noise on unit embeddings, hundredths", (0, 30, 60, 90)),
        Fault("wrong", "share of regions with another region's embedding, %", (0, 10, 20, 40)),
        Fault("views", "share of the views used, %", (100, 50, 25, 12.5)),
    )
}
"""By name."""


@dataclass(frozen=True)
class CurvePoint:
    """A method under a fault.

    Attributes:
        fault, strength, method: which.
        scores: of each scene.
    """

    fault: str
    strength: float
    method: str
    scores: list[SceneScore]


def find_fault(name: str) -> Fault:
    """A fault by name.

    Raises:
        UnknownNameError: there is none.
    """
    return looked_up("fault", name, FAULTS)


def run_curves(
    scenes: Sequence[PreparedScene],
    methods: Sequence[Method],
    faults: Sequence[Fault],
    preset: QueryPreset,
    settings: MethodSettings = DEFAULTS,
    draw: int = 0,
    progress: Progress = no_progress,
) -> list[CurvePoint]:
    """Score every method under every strength of every fault; without faults each is scored once.

    Args:
        scenes: rasterised once for each way of gathering, and again for displaced masks.
        methods: see ``scoup.baselines.methods``.
        faults: see ``FAULTS``.
        preset: the protocol's rules.
        settings: of the methods.
        draw: seed of the faults, the same for all methods.
        progress: told after each point and scene.
    """
    points = [
        (fault, strength, method) for fault in faults for strength in fault.strengths for method in methods
    ]
    found: dict[tuple[str, float, str], list[SceneScore]] = {}
    total, done = len(points) * len(scenes), 0
    progress("curves", 0, total)
    for scene in scenes:
        clean: dict[str, SceneScore] = {}
        displaced: dict[float, PreparedScene] = {}
        for fault, strength, method in points:
            none = strength == fault.strengths[0]
            if not none or method.name not in clean:
                place = scene
                if fault.name == "masks" and not none:
                    if strength not in displaced:
                        moved = displaced_masks(scene.regions, strength, draw)
                        displaced = {strength: replace(scene, regions=moved, sums={}, seconds={})}
                    place = displaced[strength]
                score = _score(place, method, fault, strength, preset, settings, draw)
                if none:
                    clean[method.name] = score
            else:
                score = clean[method.name]
            found.setdefault((fault.name, strength, method.name), []).append(score)
            done += 1
            progress("curves", done, total)
    return [CurvePoint(*key, scores) for key, scores in found.items()]


def _score(
    scene: PreparedScene,
    method: Method,
    fault: Fault,
    strength: float,
    preset: QueryPreset,
    settings: MethodSettings,
    draw: int,
) -> SceneScore:
    sums, rows = scene.gathered(method.gather), scene.embeddings()
    if strength != fault.strengths[0] and fault.name != "masks":
        sums, rows = _faulty(level_sums(sums, scene.regions), fault.name, strength, draw)
    made = method.make(sums, rows, settings)
    return scene.scores(made, {"all": Rule(preset)})["all"]


def _faulty(
    levels: list[LevelSums], fault: str, strength: float, draw: int
) -> tuple[RegionSums, list[torch.Tensor]]:
    if fault == "views":
        count = max(int(level.views.max(initial=0)) for level in levels) + 1
        kept = max(1, round(count * strength / 100))
        chosen = ((np.arange(kept) + 0.5) * count / kept).astype(int)
        levels = [level.kept(np.isin(level.views, chosen)) for level in levels]
    else:
        levels = perturbed(levels, f"{fault}{round(strength)}", draw)
    return as_region_sums(levels), [level.embeddings for level in levels]


def displaced_masks(regions: Regions, pixels: float, seed: int = 0) -> Regions:
    """The regions with all borders moved smoothly, by so many pixels of an image 480 wide (standard deviation).

    Embeddings stay: it is the masks that bleed over edges. Each level of each view is moved in its own way, the same
    for the same seed.
    """

    def load(view: str, level: str) -> RegionMap:
        found = regions.load(view, level)
        height, width = found.labels.shape
        random = np.random.default_rng([seed, *f"{view} {level}".encode()])
        scale = width / 480
        rows, columns = np.indices((height, width))
        shifts = []
        for _ in range(2):
            noise = ndimage.gaussian_filter(
                random.normal(size=(height, width)), SMOOTHNESS * scale, mode="wrap"
            )
            shifts.append(noise / max(noise.std(), 1e-12) * pixels * scale)
        take_rows = np.rint(rows + shifts[0]).astype(int).clip(0, height - 1)
        take_columns = np.rint(columns + shifts[1]).astype(int).clip(0, width - 1)
        return RegionMap(found.labels[take_rows, take_columns], found.embeddings)

    return Regions(regions.levels, regions.view_names, load, regions.load_embeddings)


def curve_tables(points: Sequence[CurvePoint], faults: Sequence[Fault], protocol: str) -> list[Table]:
    """A table for each fault: mIoU of each method, then the first method minus each other's."""
    tables = []
    for fault in faults:
        mine = [point for point in points if point.fault == fault.name]
        methods = list(dict.fromkeys(point.method for point in mine))
        by_place = {(point.method, point.strength): point.scores for point in mine}
        headers = ("method", *(f"{strength:g}" for strength in fault.strengths))
        rows = [
            (
                name,
                *(
                    f"{100 * mean(s.miou for s in by_place[name, strength]):.1f}"
                    for strength in fault.strengths
                ),
            )
            for name in methods
        ]
        rows += [
            (
                f"{methods[0]} - {name}",
                *(
                    signed(paired_difference(by_place[methods[0], strength], by_place[name, strength]))
                    for strength in fault.strengths
                ),
            )
            for name in methods[1:]
        ]
        notes = ("Differences: 95 % intervals, paired over queries, the scenes being given.", *CAVEATS[:2])
        tables.append(Table(f"{protocol}: {fault.label}", headers, tuple(rows), notes))
    return tables


def curve_plot(points: Sequence[CurvePoint], fault: Fault, protocol: str) -> Picture:
    """mIoU of every method, with bands of the 95 % interval over queries."""
    mine = [point for point in points if point.fault == fault.name]
    series = []
    for name in dict.fromkeys(point.method for point in mine):
        own = sorted((point for point in mine if point.method == name), key=lambda point: point.strength)
        intervals = [miou_interval(point.scores) for point in own]
        columns = [
            tuple(100 * getattr(interval, part) for interval in intervals) for part in ("mean", "low", "high")
        ]
        series.append(Series(name, tuple(point.strength for point in own), *columns))
    return line_plot(series, f"Accuracy, {protocol}", fault.label, "mIoU, %", 980, 560)


def curve_record(points: Sequence[CurvePoint]) -> list[dict[str, Any]]:
    """For JSON."""
    record = []
    for point in points:
        interval = miou_interval(point.scores)
        record.append(
            {
                "fault": point.fault,
                "strength": point.strength,
                "method": point.method,
                "miou": interval.mean,
                "miou_interval": [interval.low, interval.high],
                "scenes": {score.scene: score.miou for score in point.scores},
            }
        )
    return record
