"""The report on a point-level data set: tables overall, by scene and by class, and the record of everything."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from scoup.base.counts import counted, listed
from scoup.base.errors import InputError
from scoup_lab.evaluate.metrics import Interval
from scoup_lab.evaluate.point_scenes import PointDataSet
from scoup_lab.evaluate.protocols.point_labels import (
    ClassList,
    class_accuracies,
    class_ious,
    class_mean,
    class_totals,
    drawn_totals,
    frequency_weighted_iou,
    interval_of,
    overall_accuracy,
)
from scoup_lab.evaluate.tables import Table, write_tables

Score = Callable[[Tensor], Tensor]
"""From totals [..., 3, C] to a score [...]."""


@dataclass(frozen=True, eq=False)
class PointReport:
    """Confusion matrices of scenes and systems by one list of classes.

    Attributes:
        data_set: whose protocol was followed.
        classes: the list.
        scenes: names.
        matrices: system -> [C, C + 1] of each scene.
        settings: of this run, for the JSON.
        notes: for below the overall table.
    """

    data_set: PointDataSet
    classes: ClassList
    scenes: tuple[str, ...]
    matrices: dict[str, list[Tensor]]
    settings: dict[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        data_set: PointDataSet,
        classes: ClassList,
        scenes: Mapping[str, Mapping[str, Mapping[str, Tensor]]],
        settings: dict[str, Any] | None = None,
    ) -> PointReport:
        """The report on what ``evaluate_point_scene`` gave for scenes, by name; those without points are left out.

        Raises:
            InputError: no scene has points of these classes.
        """
        found = {name: counts[classes.name] for name, counts in scenes.items() if classes.name in counts}
        if not found:
            raise InputError(
                f"none of the scenes ({listed(list(scenes))}) has points of a class of {classes.name}"
            )
        systems = next(iter(found.values()))
        matrices = {system: [of_scene[system] for of_scene in found.values()] for system in systems}
        left = [name for name in scenes if name not in found]
        notes = (f"Left out, without points of these classes: {', '.join(left)}.",) if left else ()
        return cls(data_set, classes, tuple(found), matrices, settings or {}, notes)

    @property
    def scores(self) -> dict[str, Score]:
        """The protocol's scores by name, in order; the first one leads."""
        foreground = self.classes.foreground
        means: dict[str, Score] = {
            "mIoU": lambda totals: class_mean(class_ious(totals)),
            "mAcc": lambda totals: class_mean(class_accuracies(totals)),
        }
        if self.data_set.pooled:
            means = {
                "f-mIoU": lambda totals: class_mean(class_ious(totals), foreground),
                "f-mAcc": lambda totals: class_mean(class_accuracies(totals), foreground),
                **means,
            }
        return means | {"accuracy": overall_accuracy, "frequency-weighted IoU": frequency_weighted_iou}

    def totals(self, system: str) -> Tensor:
        """[T, 3, C] float64 of a system's scenes."""
        return torch.stack([class_totals(matrix) for matrix in self.matrices[system]])

    def interval(self, system: str, score: Score) -> Interval:
        """A score over all scenes with its interval over them; nothing but its value where there is one scene."""
        totals = self.totals(system)
        if self.data_set.pooled:
            return interval_of(score(totals.sum(0)), score(drawn_totals(totals)))
        values = score(totals)
        # A mean over scenes, drawn like them: as totals of one class.
        one = torch.stack([values, torch.ones_like(values), values], -1)[..., None]
        drawn = drawn_totals(one)[..., 0]
        return interval_of(values.mean(), drawn[:, 0] / drawn[:, 1])


def overall_table(report: PointReport) -> Table:
    """One row a system, in percent; the leading score with its interval."""
    headers = ["system", *report.scores]
    headers.insert(2, "95 % interval")
    rows = []
    for system in report.matrices:
        intervals = [report.interval(system, score) for score in report.scores.values()]
        cells = [system, *(_percent(each.mean) for each in intervals)]
        cells.insert(2, intervals[0].percent()[1] if len(report.scenes) > 1 else "-")
        rows.append(tuple(cells))
    counted_as = (
        "Points of all scenes are counted together."
        if report.data_set.pooled
        else "Figures are means over scenes, each counting alike."
    )
    notes = [
        *report.notes,
        counted_as,
        "Means are over the classes that have points (of a scene, where scenes are averaged); all classes are queried.",
        "Intervals: 95 %, bootstrap over scenes.",
        "All views with regions are used for building: nothing is held out. Never set beside 2D scores.",
    ]
    if report.data_set.pooled and report.classes.excluded:
        notes.insert(0, f"f: foreground, without {', '.join(sorted(report.classes.excluded))}.")
    points = sum(int(matrix.sum()) for matrix in next(iter(report.matrices.values())))
    title = (
        f"{report.data_set.protocol}, {report.classes.name} ({len(report.classes.classes)} classes): "
        f"{counted(len(report.scenes), 'scene')}, {counted(points, 'point')}"
    )
    return Table(title, tuple(headers), tuple(rows), tuple(notes))


def scene_table(report: PointReport) -> Table:
    """One row a scene and system, in percent."""
    scores = list(report.scores.items())
    headers = ["scene", "system", "points", "classes", *(name for name, _ in scores)]
    rows = []
    for number, scene in enumerate(report.scenes):
        for system in report.matrices:
            totals = report.totals(system)[number]
            true = totals[1]
            figures = (_percent(float(score(totals))) for _, score in scores)
            rows.append((scene, system, f"{int(true.sum())}", f"{int((true > 0).sum())}", *figures))
    return Table(f"{report.data_set.protocol}: by scene", tuple(headers), tuple(rows))


def class_table(report: PointReport) -> Table:
    """One row a class that has points, those of all scenes together, most frequent first."""
    systems = list(report.matrices)
    headers = ["class", "scenes", "share of points"]
    headers += [f"{what}, {system}" for system in systems for what in ("IoU", "accuracy")]
    records = {system: class_records(report, system) for system in systems}
    order = sorted(records[systems[0]], key=lambda record: -record["points"])
    rows = []
    for record in order:
        number = record["number"]
        cells = [record["class"], str(record["scenes"]), _percent(record["share"])]
        for system in systems:
            of_system = next(each for each in records[system] if each["number"] == number)
            cells += [_percent(of_system["iou"]), _percent(of_system["accuracy"])]
        rows.append(tuple(cells))
    notes = ["Points of all scenes together."]
    return Table(f"{report.data_set.protocol}: by class", tuple(headers), tuple(rows), tuple(notes))


def class_records(report: PointReport, system: str) -> list[dict[str, Any]]:
    """For each class that has points: its number, scenes, points, share of all points, IoU and accuracy."""
    by_scene = report.totals(system)
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
        for number, name in enumerate(report.classes.classes)
        if true[number] > 0
    ]


def report_record(report: PointReport) -> dict[str, Any]:
    """Everything, for JSON: scores 0..1 and not rounded; None where there is none."""
    systems = {}
    for system, matrices in report.matrices.items():
        intervals = {name: report.interval(system, score) for name, score in report.scores.items()}
        several = len(report.scenes) > 1
        systems[system] = {
            "overall": {name: _number(each.mean) for name, each in intervals.items()},
            "intervals": {
                name: each.ends if several and each.low == each.low else None
                for name, each in intervals.items()
            },
            "scenes": {
                scene: {name: _number(float(score(totals))) for name, score in report.scores.items()}
                for scene, totals in zip(report.scenes, report.totals(system), strict=True)
            },
            "classes": class_records(report, system),
            "confusion": {
                scene: matrix.tolist() for scene, matrix in zip(report.scenes, matrices, strict=True)
            },
        }
    return {
        "protocol": report.data_set.protocol,
        "classes": list(report.classes.classes),
        "excluded_from_foreground": sorted(report.classes.excluded),
        "pooled": report.data_set.pooled,
        "settings": report.settings,
        "systems": systems,
    }


def write_point_report(
    report: PointReport, folder: Path, stem: str, overwrite: bool = False
) -> dict[str, Any]:
    """Write ``stem.md``, ``stem.json`` and ``stem.tex``; the record of the JSON.

    Raises:
        OutputExistsError: one is there and ``overwrite`` is false.
    """
    record = report_record(report)
    write_tables(point_tables(report), folder, stem, report.data_set.protocol, record, overwrite)
    return record


def point_tables(report: PointReport) -> Sequence[Table]:
    """All tables, in order."""
    return [overall_table(report), scene_table(report), class_table(report)]


def _percent(share: float) -> str:
    return "-" if share != share else f"{100 * share:.1f}"


def _number(value: float) -> float | None:
    """JSON knows no NaN."""
    return None if value != value else value
