"""The report on labelled frames: tables overall, by scene and by query, and the record of everything."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from statistics import mean
from typing import Any

from scoup.base import counted
from scoup_lab.evaluate.published import PUBLISHED, SOURCE, Published
from scoup_lab.evaluate.report import OURS, Report
from scoup_lab.evaluate.scores import SceneScore, accuracy_interval, miou_interval, overall
from scoup_lab.evaluate.tables import CAVEATS, Table, number_or_none, percent


@dataclass(frozen=True)
class PixelScores:
    """Scores of one protocol and one system's rules over scenes."""

    protocol: str  # its title
    system: str  # whose constants
    scenes: tuple[SceneScore, ...]
    published_scenes: tuple[str, ...] = ()  # published rows are shown only if these contain all of ours
    settings: dict[str, Any] = field(default_factory=dict)  # of this run, for the JSON
    notes: tuple[str, ...] = ()  # for below the overall table

    def report(self, stem: str, levels: Sequence[str] = ()) -> Report:
        """Return tables and record; ``levels`` are the names of the levels that answered."""
        of_papers = [published_table(self)] if self.published else []
        tables = [overall_table(self), scene_table(self), *of_papers, query_table(self, levels)]
        title = f"{self.protocol}, rules of {self.system}"
        return Report(stem, title, tables, report_record(self), shown=2)

    @property
    def localizes(self) -> bool:
        """Return whether points were scored too."""
        return all(scene.localizes for scene in self.scenes)

    @property
    def published(self) -> tuple[Published, ...]:
        """Rows that may stand beside ours: those of a protocol, where some tell of every scene here."""
        rows = PUBLISHED.get(self.protocol, ())
        known = {scene for row in rows for scene in row.by_scene or ()} & set(self.published_scenes)
        return rows if {scene.scene for scene in self.scenes} <= known else ()


def overall_table(scores: PixelScores) -> Table:
    """Return our row with its intervals, then the published rows; in percent."""
    localizes = scores.localizes
    headers = ("system", "source", *_score_heads(localizes))
    rows: list[tuple[str, ...]] = [
        (f"{OURS} ({scores.system} rules)", "measured", *_score_cells(scores.scenes))
    ]
    for other in scores.published:
        cells = [other.system, "published", _figure(other.miou), "-"]
        cells += [_figure(other.accuracy), "-"] if localizes else []
        rows.append(tuple(cells))
    notes = [*scores.notes, *CAVEATS]
    if scores.published:
        notes.append(f"Published rows are as {SOURCE} reports them; none was measured here.")
    elif PUBLISHED.get(scores.protocol):
        notes.append("The scenes are not those of the published data set: published figures are left out.")
    count = sum(len(scene.pairs) for scene in scores.scenes)
    title = (
        f"{scores.protocol}: {counted(len(scores.scenes), 'scene')}, {counted(count, '(frame, label) pair')}"
    )
    return Table(title, headers, tuple(rows), tuple(notes))


def scene_table(scores: PixelScores) -> Table:
    """Return one row per scene."""
    headers = ("scene", "pairs", *_score_heads(scores.localizes))
    rows = [(scene.scene, str(len(scene.pairs)), *_score_cells([scene])) for scene in scores.scenes]
    return Table(f"{scores.protocol}: by scene", headers, tuple(rows))


def _score_heads(localizes: bool) -> list[str]:
    return ["mIoU", "95 % interval", *(["localisation", "95 % interval"] if localizes else [])]


def _score_cells(scenes: Sequence[SceneScore]) -> list[str]:
    accuracy = accuracy_interval(scenes)
    return [*miou_interval(scenes).percent(), *(() if accuracy is None else accuracy.percent())]


def published_table(scores: PixelScores) -> Table:
    """Return what the paper reports for the scenes here, below our own."""
    localizes = scores.localizes
    ours = [
        " / ".join(percent(share) for share in (scene.miou, *([scene.accuracy] if localizes else [])))
        for scene in scores.scenes
    ]
    rows = [(OURS, "measured", *ours)]
    for other in scores.published:
        if other.by_scene:
            figures = [other.by_scene[scene.scene] for scene in scores.scenes]
            rows.append((other.system, "published", *(_figures(figure, localizes) for figure in figures)))
    title = f"{scores.protocol}: published, by scene, mIoU" + (" / localisation" if localizes else "")
    return Table(title, ("system", "source", *(scene.scene for scene in scores.scenes)), tuple(rows))


def _figures(both: tuple[float | None, float | None], localizes: bool) -> str:
    return " / ".join(_figure(value) for value in (both if localizes else both[:1]))


def query_table(scores: PixelScores, levels: Sequence[str] = ()) -> Table:
    """Return one row for each query of each scene, worst first within a scene."""
    localizes = scores.localizes
    headers = ["query", "scene", "frames", "mIoU"]
    headers += ["localisation"] if localizes else []
    headers += ["levels"] if levels else []
    rows = []
    for scene in scores.scenes:
        for record in query_records(scene):
            cells = [record["query"], scene.scene, str(record["frames"]), percent(record["miou"])]
            cells += [percent(record["accuracy"])] if localizes else []
            counts = [(levels[level] if levels and level >= 0 else "-", n) for level, n in record["levels"]]
            cells += [" ".join(f"{name}{n}" for name, n in counts)] if levels else []
            rows.append(tuple(cells))
    return Table(f"{scores.protocol}: by query", tuple(headers), tuple(rows))


def query_records(scene: SceneScore) -> list[dict[str, Any]]:
    """Return per query of a scene frames, mean IoU, share of hits, how often each level answered; worst first."""
    records = [
        {
            "query": label,
            "frames": len(pairs),
            "miou": mean(pair.iou for pair in pairs),
            "accuracy": mean(bool(pair.hit) for pair in pairs) if scene.localizes else None,
            "levels": Counter(pair.level for pair in pairs).most_common(),
        }
        for label, pairs in scene.by_label().items()
    ]
    return sorted(records, key=lambda record: (record["miou"], record["query"]))


def report_record(scores: PixelScores) -> dict[str, Any]:
    """Return everything, for JSON: scores 0..1 and not rounded, published figures apart and in percent."""
    miou, accuracy = overall(scores.scenes)
    interval = accuracy_interval(scores.scenes)
    return {
        "protocol": scores.protocol,
        "system": scores.system,
        "settings": scores.settings,
        "overall": {
            "miou": miou,
            "miou_interval": miou_interval(scores.scenes).ends,
            "accuracy": accuracy,
            "accuracy_interval": None if interval is None else interval.ends,
            "pairs": sum(len(scene.pairs) for scene in scores.scenes),
        },
        "scenes": {
            scene.scene: {
                "miou": scene.miou,
                "miou_interval": miou_interval([scene]).ends,
                "accuracy": scene.accuracy if scene.localizes else None,
                "queries": query_records(scene),
                "pairs": [asdict(pair) | {"score": number_or_none(pair.score)} for pair in scene.pairs],
            }
            for scene in scores.scenes
        },
        "published_percent": [asdict(other) for other in scores.published],
        "caveats": list(CAVEATS),
    }


def _figure(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}"
