"""Accuracy under faults: masks that are displaced or missing, embeddings that are noisy or another region's, fewer
views. Every method meets the same faults."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import mean
from typing import Any, ClassVar

import numpy as np
import torch

from scoup.base.errors import looked_up
from scoup.base.progress import Progress, no_progress
from scoup.query.presets import QueryPreset
from scoup.scene.regions import RegionMap, Regions
from scoup_lab.baselines.method import DEFAULTS, Method, MethodSettings
from scoup_lab.baselines.rasterised_scene import UpliftInputs
from scoup_lab.evaluate.plots import Curve, CurvePlot
from scoup_lab.evaluate.report import Report
from scoup_lab.evaluate.scores import SceneScore, miou_interval, pair_names, rounded_ious
from scoup_lab.evaluate.studies.comparison import paired_difference
from scoup_lab.evaluate.studies.study import Study
from scoup_lab.evaluate.studies.study_scene import StudyScene
from scoup_lab.evaluate.tables import CAVEATS, Table
from scoup_lab.synthetic.faults import as_region_sums, level_sums, perturbed
from scoup_lab.synthetic.observe import moved_borders

SMOOTHNESS = 6.0  # pixels of an image 480 wide: how far displacements of neighbouring pixels go together


@dataclass(frozen=True)
class FaultScale:
    """A fault, stronger and stronger."""

    name: str  # short, for file names
    label: str  # of the plot's axis
    strengths: tuple[float, ...]  # in units of the label; the first is none at all


FAULT_SCALES: dict[str, FaultScale] = {
    fault.name: fault
    for fault in (
        FaultScale(
            "masks",
            "displacement of mask borders, pixels of an image 480 wide (standard deviation)",
            (0, 2, 4, 8),
        ),
        FaultScale("missing", "share of masks missing, %", (0, 20, 40, 60)),
        FaultScale("noise", "length of noise on unit embeddings, hundredths", (0, 30, 60, 90)),
        FaultScale("wrong", "share of regions with another region's embedding, %", (0, 10, 20, 40)),
        FaultScale("views", "share of the views used, %", (100, 50, 25, 12.5)),
    )
}
"""By name."""


@dataclass(frozen=True)
class CurvePoint:
    """A method under a fault."""

    fault: str
    strength: float
    method: str
    scores: list[SceneScore]  # of each scene


def find_fault(name: str) -> FaultScale:
    """Return a fault by name."""
    return looked_up("fault", name, FAULT_SCALES)


@dataclass(frozen=True)
class Curves(Study[CurvePoint]):
    """Every method under every strength of every fault; without faults each is scored once."""

    methods: Sequence[Method]
    faults: Sequence[FaultScale]
    preset: QueryPreset  # the protocol's rules
    settings: MethodSettings = DEFAULTS
    draw: int = 0  # seed of the faults, the same for all methods

    stem: ClassVar[str] = "curves"

    def results(self, scenes: Sequence[StudyScene], progress: Progress = no_progress) -> list[CurvePoint]:
        """See ``Study``; scenes are rasterised once for each way of counting pixels, and again for displaced masks."""
        found: dict[tuple[str, float, str], list[SceneScore]] = {}
        total = len(self.methods) * sum(len(fault.strengths) for fault in self.faults) * len(scenes)
        done = 0
        progress("curves", 0, total)
        for scene in scenes:
            clean = {method.name: self._score(scene, method) for method in self.methods}
            for fault in self.faults:
                for strength in fault.strengths:
                    faulty = scene
                    if fault.name == "masks" and strength != fault.strengths[0]:
                        moved = displaced_masks(scene.rasterised.regions, strength, self.draw)
                        faulty = replace(scene, rasterised=scene.rasterised.with_regions(moved))
                    for method in self.methods:
                        if strength == fault.strengths[0]:
                            score = clean[method.name]
                        elif fault.name == "masks":
                            score = self._score(faulty, method)
                        else:
                            inputs = faulty_inputs(scene, method, fault.name, strength, self.draw)
                            score = scene.score(method.uplift(inputs, self.settings), self.preset)
                        found.setdefault((fault.name, strength, method.name), []).append(score)
                        done += 1
                        progress("curves", done, total)
        return [CurvePoint(*key, scores) for key, scores in found.items()]

    def report(self, results: Sequence[CurvePoint], protocol: str, described: dict[str, Any]) -> Report:
        record = {
            "protocol": protocol,
            **described,
            "pairs": pair_names(results[0].scores),
            "points": curve_record(results),
        }
        plots = {f"curve_{fault.name}.png": curve_plot(results, fault, protocol) for fault in self.faults}
        tables = curve_tables(results, self.faults, protocol)
        return Report(self.stem, "Accuracy and faults", tables, record, plots)

    def _score(self, scene: StudyScene, method: Method) -> SceneScore:
        return scene.score(method.fit(scene.rasterised, self.settings), self.preset)


def faulty_inputs(scene: StudyScene, method: Method, fault: str, strength: float, draw: int) -> UpliftInputs:
    """Return what a method is fitted to, with a fault put into region sums and embeddings."""
    levels = level_sums(scene.rasterised.region_sums(method.pixels), scene.rasterised.regions)
    if fault == "views":
        count = max(int(level.views.max(initial=0)) for level in levels) + 1
        kept = max(1, round(count * strength / 100))
        chosen = ((np.arange(kept) + 0.5) * count / kept).astype(int)
        levels = [level.kept(np.isin(level.views, chosen)) for level in levels]
    else:
        levels = perturbed(levels, f"{fault}{round(strength)}", draw)
    return UpliftInputs(as_region_sums(levels), [level.embeddings for level in levels])


def displaced_masks(regions: Regions, pixels: float, seed: int = 0) -> Regions:
    """Return the regions with all borders moved smoothly, by so many pixels of an image 480 wide (standard deviation).

    Embeddings stay: it is the masks that bleed over edges. Each level of each view is moved in its own way, the same
    for the same seed.
    """

    def load(view: str, level: str) -> RegionMap:
        found = regions.load(view, level)
        random = np.random.default_rng([seed, *f"{view} {level}".encode()])
        labels = moved_borders(found.labels.numpy(), random, pixels, SMOOTHNESS)
        return RegionMap(torch.from_numpy(labels), found.embeddings)

    return Regions(regions.levels, regions.view_names, load, regions.load_embeddings)


def curve_tables(points: Sequence[CurvePoint], faults: Sequence[FaultScale], protocol: str) -> list[Table]:
    """Return a table for each fault: mIoU of each method, then the first method minus each other's."""
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
                    paired_difference(by_place[methods[0], strength], by_place[name, strength]).signed()
                    for strength in fault.strengths
                ),
            )
            for name in methods[1:]
        ]
        notes = ("Differences: 95 % intervals, paired over queries, the scenes being given.", *CAVEATS[:2])
        tables.append(Table(f"{protocol}: {fault.label}", headers, tuple(rows), notes))
    return tables


def curve_plot(points: Sequence[CurvePoint], fault: FaultScale, protocol: str) -> CurvePlot:
    """Return mIoU of every method, with bands of the 95 % interval over queries."""
    mine = [point for point in points if point.fault == fault.name]
    curves = []
    for name in dict.fromkeys(point.method for point in mine):
        own = sorted((point for point in mine if point.method == name), key=lambda point: point.strength)
        intervals = tuple(miou_interval(point.scores).scaled(100) for point in own)
        curves.append(Curve(name, tuple(point.strength for point in own), intervals))
    return CurvePlot(curves, f"Accuracy, {protocol}", fault.label, "mIoU, %")


def curve_record(points: Sequence[CurvePoint]) -> list[dict[str, Any]]:
    """Return the record, for JSON."""
    record = []
    for point in points:
        interval = miou_interval(point.scores)
        record.append(
            {
                "fault": point.fault,
                "strength": point.strength,
                "method": point.method,
                "iou": rounded_ious(pair.iou for score in point.scores for pair in score.pairs),
                "miou": interval.mean,
                "miou_interval": interval.ends,
                "scenes": {score.scene: score.miou for score in point.scores},
            }
        )
    return record
