"""The report on classes of points: tables overall, by scene and by class, and the record of everything."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from scoup.base import InputError, counted, listed
from scoup_lab.evaluate.metrics import Interval, bootstrap_interval
from scoup_lab.evaluate.protocols import scannet
from scoup_lab.evaluate.protocols.points import (
    ClassList,
    class_accuracies,
    class_ious,
    class_mean,
    class_totals,
)
from scoup_lab.evaluate.report import Report
from scoup_lab.evaluate.tables import Table, number_or_none, percent

Score = Callable[[Tensor], Tensor]
"""From totals [..., 3, C] to a score [...]."""


@dataclass(frozen=True, eq=False)
class PointScores:
    """Confusion matrices of scenes and systems by one list of classes."""

    classes: ClassList
    scenes: tuple[str, ...]  # names
    matrices: dict[str, list[Tensor]]  # system -> [C, C + 1] of each scene
    settings: dict[str, Any] = field(default_factory=dict)  # of this run, for the JSON
    notes: tuple[str, ...] = ()  # for below the overall table

    @classmethod
    def of(
        cls,
        classes: ClassList,
        scenes: Mapping[str, Mapping[str, Mapping[str, Tensor]]],
        settings: dict[str, Any] | None = None,
    ) -> PointScores:
        """Collect what ``PointEvaluation.scene`` gave for scenes, by name; those without points are left out."""
        matched = {name: counts[classes.name] for name, counts in scenes.items() if classes.name in counts}
        if not matched:
            raise InputError(
                f"none of the scenes ({listed(list(scenes))}) has points of a class of {classes.name}"
            )
        systems = next(iter(matched.values()))
        matrices = {system: [of_scene[system] for of_scene in matched.values()] for system in systems}
        left = [name for name in scenes if name not in matched]
        notes = (f"Left out, without points of these classes: {', '.join(left)}.",) if left else ()
        return cls(classes, tuple(matched), matrices, settings or {}, notes)

    def report(self, stem: str) -> Report:
        """Return tables and record."""
        tables = [overall_table(self), scene_table(self), class_table(self)]
        return Report(stem, scannet.TITLE, tables, report_record(self), shown=1)

    @property
    def scores(self) -> dict[str, Score]:
        """The protocol's scores by name, in order; the first one leads."""
        return {
            "mIoU": lambda totals: class_mean(class_ious(totals)),
            "mAcc": lambda totals: class_mean(class_accuracies(totals)),
        }

    def totals(self, system: str) -> Tensor:
        """Return [T, 3, C] float64 of a system's scenes."""
        return torch.stack([class_totals(matrix) for matrix in self.matrices[system]])

    def interval(self, system: str, score: Score) -> Interval:
        """Return the mean of a score over scenes with its interval over them."""
        return bootstrap_interval(score(self.totals(system)).tolist(), self.scenes)


def overall_table(scores: PointScores) -> Table:
    """Return one row a system, in percent; the leading score with its interval."""
    headers = ["system", *scores.scores]
    headers.insert(2, "95 % interval")
    rows = []
    for system in scores.matrices:
        intervals = [scores.interval(system, score) for score in scores.scores.values()]
        cells = [system, *(percent(interval.mean) for interval in intervals)]
        cells.insert(2, intervals[0].percent()[1] if len(scores.scenes) > 1 else "-")
        rows.append(tuple(cells))
    notes = [
        *scores.notes,
        "Figures are means over scenes, each counting alike.",
        "Means are over the classes that have points in a scene; all classes are queried.",
        "Intervals: 95 %, bootstrap over scenes.",
        "All views with regions are used for building: nothing is held out. Never set beside 2D scores.",
    ]
    points = sum(int(matrix.sum()) for matrix in next(iter(scores.matrices.values())))
    title = (
        f"{scannet.TITLE}, {scores.classes.name} ({len(scores.classes.classes)} classes): "
        f"{counted(len(scores.scenes), 'scene')}, {counted(points, 'point')}"
    )
    return Table(title, tuple(headers), tuple(rows), tuple(notes))


def scene_table(scores: PointScores) -> Table:
    """Return one row per scene and system, in percent."""
    headers = ["scene", "system", "points", "classes", *scores.scores]
    rows = []
    for number, scene in enumerate(scores.scenes):
        for system in scores.matrices:
            totals = scores.totals(system)[number]
            true = totals[1]
            figures = (percent(float(score(totals))) for score in scores.scores.values())
            rows.append((scene, system, f"{int(true.sum())}", f"{int((true > 0).sum())}", *figures))
    return Table(f"{scannet.TITLE}: by scene", tuple(headers), tuple(rows))


def class_table(scores: PointScores) -> Table:
    """Return one row a class that has points, those of all scenes together, most frequent first."""
    systems = list(scores.matrices)
    headers = ["class", "scenes", "share of points"]
    headers += [f"{what}, {system}" for system in systems for what in ("IoU", "accuracy")]
    records = {system: class_records(scores, system) for system in systems}
    order = sorted(records[systems[0]], key=lambda record: -record["points"])
    rows = []
    for record in order:
        number = record["number"]
        cells = [record["class"], str(record["scenes"]), percent(record["share"])]
        for system in systems:
            of_system = next(row for row in records[system] if row["number"] == number)
            cells += [percent(of_system["iou"]), percent(of_system["accuracy"])]
        rows.append(tuple(cells))
    notes = ["Points of all scenes together."]
    return Table(f"{scannet.TITLE}: by class", tuple(headers), tuple(rows), tuple(notes))


def class_records(scores: PointScores, system: str) -> list[dict[str, Any]]:
    """Return per class that has points its number, scenes, points, share of all points, IoU and accuracy."""
    by_scene = scores.totals(system)
    totals = by_scene.sum(0)
    ious, accuracies, true = class_ious(totals), class_accuracies(totals), totals[1]
    return [
        {
            "class": name,
            "number": number,
            "scenes": int((by_scene[:, 1, number] > 0).sum()),
            "points": int(true[number]),
            "share": float(true[number] / true.sum()),
            "iou": float(ious[number]),
            "accuracy": float(accuracies[number]),
        }
        for number, name in enumerate(scores.classes.classes)
        if true[number] > 0
    ]


def report_record(scores: PointScores) -> dict[str, Any]:
    """Return everything, for JSON: scores 0..1 and not rounded; None where there is none."""
    systems = {}
    for system, matrices in scores.matrices.items():
        intervals = {name: scores.interval(system, score) for name, score in scores.scores.items()}
        several = len(scores.scenes) > 1
        systems[system] = {
            "overall": {name: number_or_none(interval.mean) for name, interval in intervals.items()},
            "intervals": {name: interval.ends if several else None for name, interval in intervals.items()},
            "scenes": {
                scene: {name: number_or_none(float(score(totals))) for name, score in scores.scores.items()}
                for scene, totals in zip(scores.scenes, scores.totals(system), strict=True)
            },
            "classes": class_records(scores, system),
            "confusion": {
                scene: matrix.tolist() for scene, matrix in zip(scores.scenes, matrices, strict=True)
            },
        }
    return {
        "protocol": scannet.TITLE,
        "classes": list(scores.classes.classes),
        "settings": scores.settings,
        "systems": systems,
    }
