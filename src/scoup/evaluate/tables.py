"""Tables of scores: overall, by scene and by query, as Markdown, LaTeX and JSON."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from statistics import mean
from typing import Any

from scoup.evaluate.metrics import Interval, bootstrap_interval
from scoup.evaluate.published import PUBLISHED, Published
from scoup.evaluate.scores import SceneScore, overall

OURS = "this run"
CAVEATS = (
    "Thresholds are tuned for each data set by the papers.",
    "All views with regions are used for building, labelled ones too: nothing is held out.",
    "Intervals: 95 %, bootstrap over queries, the scenes being given.",
)


@dataclass(frozen=True)
class Table:
    """Text in rows and columns.

    Attributes:
        title: above.
        headers: of the columns; the first is aligned left, the others right.
        rows: of cells.
        notes: below.
    """

    title: str
    headers: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...] = ()

    def markdown(self) -> str:
        """A GitHub table under a heading."""
        lines = [
            f"## {self.title}",
            "",
            _line(self.headers),
            "|---" + "|---:" * (len(self.headers) - 1) + "|",
        ]
        lines += [_line([cell.replace("|", "\\|") for cell in row]) for row in self.rows]
        if self.notes:
            lines += ["", *(f"* {note}" for note in self.notes)]
        return "\n".join(lines) + "\n"

    def latex(self) -> str:
        """A ``table`` of booktabs."""
        columns = "l" + "r" * (len(self.headers) - 1)
        lines = [r"\begin{table}", r"\centering", rf"\caption{{{_escaped(self.title)}}}"]
        lines += [rf"\begin{{tabular}}{{{columns}}}", r"\toprule", _latex_line(self.headers), r"\midrule"]
        lines += [_latex_line(row) for row in self.rows]
        lines += [r"\bottomrule", r"\end{tabular}", *(rf"% {note}" for note in self.notes), r"\end{table}"]
        return "\n".join(lines) + "\n"


@dataclass(frozen=True)
class Report:
    """Scores of one protocol and one system's rules over scenes.

    Attributes:
        protocol: whose rules.
        system: whose constants.
        scenes: their scores.
        published_scenes: scenes of the published data set: published rows stand beside ours only where all of ours are
            among them.
        settings: what else tells this run from others, for the JSON.
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
        """Rows that may stand beside ours."""
        return PUBLISHED.get(self.protocol, ()) if self.comparable else ()


def miou_interval(scenes: Sequence[SceneScore]) -> Interval:
    """Of the mean over scenes, each counting alike; queries are drawn scene by scene."""
    pairs = [(scene.scene, pair) for scene in scenes for pair in scene.pairs]
    return bootstrap_interval(
        [pair.iou for _, pair in pairs],
        [pair.label for _, pair in pairs],
        scenes=[name for name, _ in pairs],
    )


def accuracy_interval(scenes: Sequence[SceneScore]) -> Interval | None:
    """The same of the localisation accuracy; None in protocols without it."""
    if not all(scene.localizes for scene in scenes):
        return None
    pairs = [(scene.scene, pair) for scene in scenes for pair in scene.pairs]
    return bootstrap_interval(
        [float(bool(pair.hit)) for _, pair in pairs],
        [pair.label for _, pair in pairs],
        scenes=[name for name, _ in pairs],
    )


def overall_table(report: Report) -> Table:
    """Ours with its intervals, then the published rows, marked as such. Scores in percent."""
    localizes = all(scene.localizes for scene in report.scenes)
    headers = ["system", "source", "mIoU", "95 % interval"]
    headers += ["localisation", "95 % interval"] if localizes else []
    row = [f"{OURS} ({report.system} rules)", "measured", *_cells(miou_interval(report.scenes))]
    found = accuracy_interval(report.scenes)
    row += _cells(found) if found is not None else []
    rows = [tuple(row)]
    for other in report.published:
        cells = [other.system, "published", _figure(other.miou), "-"]
        cells += [_figure(other.accuracy), "-"] if localizes else []
        rows.append(tuple(cells))
    notes = [*report.notes, *CAVEATS]
    if report.published:
        notes.append("Published rows are as the papers report them; none was measured here.")
    elif PUBLISHED.get(report.protocol):
        notes.append("The scenes are not those of the published data set: published figures are left out.")
    count = sum(len(scene.pairs) for scene in report.scenes)
    title = f"{report.protocol}: {len(report.scenes)} scenes, {count} (frame, label) pairs"
    return Table(title, tuple(headers), tuple(rows), tuple(notes))


def scene_table(report: Report) -> Table:
    """One row a scene, with what the papers report for it."""
    localizes = all(scene.localizes for scene in report.scenes)
    published = [other for other in report.published if other.by_scene]
    headers = ["scene", "pairs", "mIoU", "95 % interval"]
    headers += ["localisation", "95 % interval"] if localizes else []
    headers += [f"{other.system}, published" for other in published]
    rows = []
    for scene in report.scenes:
        cells = [scene.scene, str(len(scene.pairs)), *_cells(miou_interval([scene]))]
        found = accuracy_interval([scene])
        cells += _cells(found) if found is not None else []
        for other in published:
            miou, accuracy = other.by_scene.get(scene.scene, (None, None))
            figures = [miou, accuracy] if localizes else [miou]
            cells.append(" / ".join(_figure(value) for value in figures))
        rows.append(tuple(cells))
    return Table(f"{report.protocol}: by scene", tuple(headers), tuple(rows))


def query_table(report: Report, levels: Sequence[str] = ()) -> Table:
    """One row for each query of each scene, worst first within a scene.

    Args:
        report: the scores.
        levels: names of the levels, to tell which ones answered.
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
            "miou_interval": _ends(miou_interval(report.scenes)),
            "accuracy": accuracy,
            "accuracy_interval": None if found is None else _ends(found),
            "pairs": sum(len(scene.pairs) for scene in report.scenes),
        },
        "scenes": {
            scene.scene: {
                "miou": scene.miou,
                "miou_interval": _ends(miou_interval([scene])),
                "accuracy": scene.accuracy if scene.localizes else None,
                "queries": query_records(scene),
                "pairs": [_plain(asdict(pair)) for pair in scene.pairs],
            }
            for scene in report.scenes
        },
        "published_percent": [asdict(other) for other in report.published],
        "caveats": list(CAVEATS),
    }


def _plain(record: dict[str, Any]) -> dict[str, Any]:
    """JSON knows no NaN."""
    return {key: None if value != value else value for key, value in record.items()}


def _ends(interval: Interval) -> list[float]:
    return [interval.low, interval.high]


def _cells(interval: Interval) -> list[str]:
    return [_percent(interval.mean), f"{100 * interval.low:.1f} to {100 * interval.high:.1f}"]


def _percent(share: float) -> str:
    return f"{100 * share:.1f}"


def _figure(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}" if round(value, 1) == value else f"{value:.2f}"


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _latex_line(cells: Sequence[str]) -> str:
    return " & ".join(_escaped(cell) for cell in cells) + r" \\"


def _escaped(text: str) -> str:
    return "".join(_LATEX.get(char, char) for char in text)


_LATEX = {char: "\\" + char for char in "&%$#_{}"} | {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
}
