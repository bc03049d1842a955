"""The report on one data set: tables overall, by scene and by query, and the record of everything."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from statistics import mean
from typing import Any

from scoup.base.counts import counted
from scoup_lab.evaluate.published import PUBLISHED, Published
from scoup_lab.evaluate.scores import SceneScore, accuracy_interval, miou_interval, overall
from scoup_lab.evaluate.tables import CAVEATS, Table, write_tables

OURS = "this run"


@dataclass(frozen=True)
class Report:
    """Scores of one protocol and one system's rules over scenes.

    Attributes:
        protocol: whose rules.
        system: whose constants.
        scenes: their scores.
        published_scenes: scenes of the published data set: published rows stand beside ours only where all of ours are
            among them.
        settings: of this run, for the JSON.
        notes: for below the overall table.
    """

    protocol: str
    system: str
    scenes: tuple[SceneScore, ...]
    published_scenes: tuple[str, ...] = ()
    settings: dict[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def comparable(self) -> bool:
        """Whether the scenes are those of the published data set, by name."""
        return {scene.scene for scene in self.scenes} <= set(self.published_scenes)

    @property
    def published(self) -> tuple[Published, ...]:
        """Rows that may stand beside ours: those of a protocol, where some tell of every scene here."""
        rows = PUBLISHED.get(self.protocol, ())
        known = {scene for row in rows for scene in row.by_scene}
        return rows if self.comparable and {scene.scene for scene in self.scenes} <= known else ()

    @property
    def footnotes(self) -> dict[str, int]:
        """Where the published rows are from, and their protocol where it differs -> number of the footnote."""
        return {note: n for n, note in enumerate(dict.fromkeys(row.note for row in self.published), 1)}


def overall_table(report: Report) -> Table:
    """Ours with its intervals, then the published rows, marked as such and by a footnote each. Scores in percent."""
    localizes = all(scene.localizes for scene in report.scenes)
    headers = ["system", "source", "mIoU", "95 % interval"]
    headers += ["localisation", "95 % interval"] if localizes else []
    row = [f"{OURS} ({report.system} rules)", "measured", *miou_interval(report.scenes).percent()]
    found = accuracy_interval(report.scenes)
    row += found.percent() if found is not None else []
    rows = [tuple(row)]
    for other in report.published:
        cells = [other.system, _mark(report, other), _figure(other.miou), "-"]
        cells += [_figure(other.accuracy), "-"] if localizes else []
        rows.append(tuple(cells))
    notes = [*report.notes, *CAVEATS]
    if report.published:
        notes.append("Published rows are as the papers report them; none was measured here.")
        notes += [f"[{number}] {note}." for note, number in report.footnotes.items()]
    elif PUBLISHED.get(report.protocol):
        notes.append("The scenes are not those of the published data set: published figures are left out.")
    count = sum(len(scene.pairs) for scene in report.scenes)
    title = (
        f"{report.protocol}: {counted(len(report.scenes), 'scene')}, {counted(count, '(frame, label) pair')}"
    )
    return Table(title, tuple(headers), tuple(rows), tuple(notes))


def scene_table(report: Report) -> Table:
    """One row a scene."""
    localizes = all(scene.localizes for scene in report.scenes)
    headers = ["scene", "pairs", "mIoU", "95 % interval"]
    headers += ["localisation", "95 % interval"] if localizes else []
    rows = []
    for scene in report.scenes:
        cells = [scene.scene, str(len(scene.pairs)), *miou_interval([scene]).percent()]
        found = accuracy_interval([scene])
        cells += found.percent() if found is not None else []
        rows.append(tuple(cells))
    return Table(f"{report.protocol}: by scene", tuple(headers), tuple(rows))


def published_table(report: Report) -> Table:
    """What the papers report for the scenes here, below our own; footnotes as in the overall table."""
    localizes = all(scene.localizes for scene in report.scenes)
    ours = [
        " / ".join(_percent(share) for share in (scene.miou, scene.accuracy)[: 1 + localizes])
        for scene in report.scenes
    ]
    rows = [(OURS, "measured", *ours)]
    for other in report.published:
        if other.by_scene:
            found = [other.by_scene.get(scene.scene, (None, None)) for scene in report.scenes]
            rows.append((other.system, _mark(report, other), *(_figures(each, localizes) for each in found)))
    title = f"{report.protocol}: published, by scene, mIoU" + (" / localisation" if localizes else "")
    return Table(title, ("system", "source", *(scene.scene for scene in report.scenes)), tuple(rows))


def _mark(report: Report, row: Published) -> str:
    return f"published [{report.footnotes[row.note]}]"


def _figures(both: tuple[float | None, float | None], localizes: bool) -> str:
    return " / ".join(_figure(value) for value in (both if localizes else both[:1]))


def query_table(report: Report, levels: Sequence[str] = ()) -> Table:
    """One row for each query of each scene, worst first within a scene.

    Args:
        report: the scores.
        levels: names of the levels, to name those that answered.
    """
    localizes = all(scene.localizes for scene in report.scenes)
    headers = ["query", "scene", "frames", "mIoU"]
    headers += ["localisation"] if localizes else []
    headers += ["levels"] if levels else []
    rows = []
    for scene in report.scenes:
        for record in query_records(scene):
            cells = [record["query"], scene.scene, str(record["frames"]), _percent(record["miou"])]
            cells += [_percent(record["accuracy"])] if localizes else []
            counts = [(levels[level] if levels and level >= 0 else "-", n) for level, n in record["levels"]]
            cells += [" ".join(f"{name}{n}" for name, n in counts)] if levels else []
            rows.append(tuple(cells))
    return Table(f"{report.protocol}: by query", tuple(headers), tuple(rows))


def query_records(scene: SceneScore) -> list[dict[str, Any]]:
    """For each query of a scene: frames, mean IoU, share of hits, how often each level answered; worst first."""
    by_label: dict[str, list] = {}
    for pair in scene.pairs:
        by_label.setdefault(pair.label, []).append(pair)
    records = [
        {
            "query": label,
            "frames": len(pairs),
            "miou": mean(pair.iou for pair in pairs),
            "accuracy": mean(bool(pair.hit) for pair in pairs) if scene.localizes else None,
            "levels": Counter(pair.level for pair in pairs).most_common(),
        }
        for label, pairs in by_label.items()
    ]
    return sorted(records, key=lambda record: (record["miou"], record["query"]))


def report_record(report: Report) -> dict[str, Any]:
    """Everything, for JSON: scores 0..1 and not rounded, published figures apart and in percent."""
    miou, accuracy = overall(report.scenes)
    found = accuracy_interval(report.scenes)
    return {
        "protocol": report.protocol,
        "system": report.system,
        "settings": report.settings,
        "overall": {
            "miou": miou,
            "miou_interval": miou_interval(report.scenes).ends,
            "accuracy": accuracy,
            "accuracy_interval": None if found is None else found.ends,
            "pairs": sum(len(scene.pairs) for scene in report.scenes),
        },
        "scenes": {
            scene.scene: {
                "miou": scene.miou,
                "miou_interval": miou_interval([scene]).ends,
                "accuracy": scene.accuracy if scene.localizes else None,
                "queries": query_records(scene),
                "pairs": [_plain(asdict(pair)) for pair in scene.pairs],
            }
            for scene in report.scenes
        },
        "published_percent": [asdict(other) | {"footnote": other.note} for other in report.published],
        "caveats": list(CAVEATS),
    }


def _plain(record: dict[str, Any]) -> dict[str, Any]:
    """JSON knows no NaN."""
    return {key: None if value != value else value for key, value in record.items()}


def _percent(share: float) -> str:
    return f"{100 * share:.1f}"


def _figure(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}" if round(value, 1) == value else f"{value:.2f}"


def write_report(
    report: Report, folder: Path, stem: str, levels: Sequence[str] = (), overwrite: bool = False
) -> dict[str, Any]:
    """Write ``stem.md``, ``stem.json`` and ``stem.tex``; the record of the JSON.

    Raises:
        OutputExistsError: one is there and ``overwrite`` is false.
    """
    of_papers = [published_table(report)] if report.published else []
    tables = [overall_table(report), scene_table(report), *of_papers, query_table(report, levels)]
    record = report_record(report)
    write_tables(tables, folder, stem, f"{report.protocol}, rules of {report.system}", record, overwrite)
    return record
