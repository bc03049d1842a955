"""Tables of the documents, made from the records kept in docs/benchmarks.

    python -m benchmarks.documents [--check]

What lies in a document between ``<!-- table: NAME -->`` and ``<!-- end of table -->`` is what ``TABLES[NAME]`` gives
today; the command puts it there. With --check nothing is written, and documents that say something else are named.
Numbers elsewhere are held against the records by tests/test_documents.py.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import tyro

from benchmarks import (
    absence,
    answers,
    city,
    city_model,
    endurance,
    fewer_pixels,
    labels,
    selection,
    server_load,
    stream,
    threshold,
    viewer,
)
from benchmarks.coding_tables import compared_table
from benchmarks.documents_claims import claims_table
from benchmarks.hostile import __main__ as hostile
from scoup_lab.bench import markdown

ROOT = Path(__file__).resolve().parents[1]
RECORDS = ROOT / "docs" / "benchmarks"
DOCUMENTS = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
BLOCK = re.compile(r"(<!-- table: ([^>]+?) -->\n).*?(<!-- end of table -->)", re.DOTALL)


@cache
def record(name: str) -> dict[str, Any]:
    """One of the records."""
    return json.loads((RECORDS / f"{name}.json").read_text())


def interval(values: Sequence[float]) -> str:
    """A difference with its interval."""
    return "{:+.3f} [{:+.3f}, {:+.3f}]".format(*values)


def readme() -> str:
    """Ours beside others, by the protocol and as users ask; the real scene first."""
    found = record("answers")
    names = {
        "default": "`scoup build`",
        "paper": "`scoup build --preset paper`",
        "dense": "dense 512-d uplift",
    }
    columns = {f"{group}, clean": title for group, title in README_COLUMNS.items()}
    parts = []
    for rule, title in README_RULES.items():
        for way, name in names.items():
            figures = [found["ways"][way][key][rule] for key in columns]
            if None not in figures:  # what is no field cannot judge presence
                parts.append([title, name, *(f"{figure:.3f}" for figure in figures)])
        for other in ("dense", "paper"):
            of_sets = found["differences"][f"default - {other}"]
            if all(of_sets[key][rule] for key in columns):
                cells = (interval(of_sets[key][rule]) for key in columns)
                parts.append([title, f"default - {other}", *cells])
    return markdown(["read", "field", *columns.values()], parts)


README_RULES = {
    "asked": "as `scoup query` answers",
    "always": "as `scoup query --always` answers",
    "peak": "by the protocol",
}
README_COLUMNS = {
    "desk (real)": "desk (real)",
    "kitchen draws, desk's statistics": "kitchen, as desk",
    "kitchen draws, CLIP's statistics": "kitchen, as CLIP",
    "kitchen draws": "kitchen, as before",
    "procedural": "procedural",
}


def study(name: str, number: int) -> str:
    """A table of ``scoup eval`` as it was written."""
    table = record(name)["tables"][number]
    return markdown(table["headers"], table["rows"])


def faults() -> str:
    """Every way under each fault by the protocol and as answered always, then the differences."""
    found = record("answers_faults")
    keys = [key for key in next(iter(found["ways"].values())) if key != "all"]
    rows = [
        [way, *(f"{of[key]['peak']:.3f} / {of[key]['always']:.3f}" for key in keys)]
        for way, of in found["ways"].items()
    ]
    rows += [
        [f"{pair}, {rule}", *(interval(of[key][rule]) for key in keys)]
        for pair, of in found["differences"].items()
        for rule in ("peak", "always")
    ]
    return markdown(["peak / always", *keys], rows)


def consistency() -> str:
    """The means over scenes and levels."""
    table = record("eval-consistency")["tables"][0]
    rows = [[row[0], row[4], *row[6:]] for row in table["rows"] if row[1] == "all"]
    return markdown(["features", "matched", "of different points", "difference"], rows)


def reference() -> str:
    """Stages of the plain torch rasteriser, relative to a colour render."""
    ratios = record("reference")["relative to the colour render"]
    return markdown(["stage", "relative"], [[name, f"{ratio:.2f}"] for name, ratio in ratios.items()])


def joint() -> str:
    """Codes learned through renderings beside the others: CPU seconds, scores, and ratios."""
    found = record("joint")
    times = found["published"]["cpu_s"]["times"]
    rows = []
    for name, of in found["methods"].items():
        ratio = f"{times[name]:.0f}" if name in times else ""
        figures = [f"{100 * of['miou']:.1f}", f"{100 * of['localisation']:.1f}", f"{of['cpu_s']:.1f}"]
        rows.append([name, *figures, f"{of['peak_bytes'] / 1e6:.0f}", ratio])
    last = f"times as long: joint-codes, {found['published']['iterations']:,} steps (extrapolated)"
    return markdown(["method", "mIoU", "localisation", "CPU seconds", "peak memory, MB", last], rows)


def fewer() -> str:
    """Time and agreement with all pixels and views, by variant."""
    found = record("fewer_pixels")
    return fewer_pixels.table({name: of for name, of in found.items() if name != "environment"})


def points(name: str, metric: str) -> str:
    """Scores of points by class: every system with its interval."""
    systems = record(name)["systems"]
    rows = [
        [
            system,
            f"{100 * of['overall'][metric]:.1f}",
            "{:.1f} to {:.1f}".format(*(100 * end for end in of["intervals"][metric])),
        ]
        for system, of in systems.items()
    ]
    return markdown(
        [f"{record(name)['protocol']}, {len(record(name)['classes'])} classes", metric, "95 % interval"], rows
    )


def lerf_sized() -> str:
    """Stages of a whole build, as shares of it."""
    found = record("lerf_sized")
    stages = {"coding": 0.0, "region sums": 0.0, "vote": 0.0, "all else": 0.0}
    for name, seconds in found["seconds"].items():
        stage = next((stage for stage in stages if stage in name), "all else")
        stages[stage] += seconds
    total, settings = found["total_s"], found["settings"]
    rows = [[name, f"{100 * seconds / total:.0f} %"] for name, seconds in stages.items()]
    rows.append([f"all, {settings['threads']} threads, of a minute", f"{total / 60:.2f}"])
    rows.append(["peak memory, GB", f"{found['peak_memory_bytes'] / 1e9:.2f}"])
    return markdown(["stage", "share of the time"], rows)


def lerf_sized_beside() -> str:
    """A whole build now and before, by turns in one run."""
    rows = []
    for name, threads in (("lerf_sized_beside", 2), ("lerf_sized_beside_1", 1)):
        for figure, of_figure in record(name)["figures"].items():
            unit, scale = ("s", 1.0) if figure == "total_s" else ("GB", 1e-9)
            cells = [f"{scale * of_figure[when]:.1f} {unit}" for when in ("before", "now")]
            title = "whole build" if unit == "s" else "peak memory"
            rows.append([f"{title}, {threads} threads", *cells, f"{of_figure['ratio']:.2f}"])
    return markdown(["", "before", "now", "now / before"], rows)


TABLES: dict[str, Callable[[], str]] = {
    "readme": readme,
    **{
        f"answers on {group}": lambda group=group: answers.table_of(record("answers"), f"{group}, clean")
        for group in (*README_COLUMNS, "kitchen draws, noise x 2")
    },
    "answers under faults": faults,
    "baselines": lambda: study("eval-baselines", 0),
    "baselines, differences": lambda: study("eval-baselines", 1),
    "baselines, 3D selection": lambda: study("eval-baselines", 2),
    "ablations": lambda: study("eval-ablations", 0),
    "ablations, entropy": lambda: study("eval-ablations-entropy", 0),
    "ablations, Adam": lambda: study("eval-ablations-adam", 0),
    "autoencoder": lambda: study("eval-autoencoder", 0),
    "consistency": consistency,
    "claims": lambda: claims_table(record),
    "thresholds": lambda: threshold.table(record("threshold")["rules"]),
    "selections": lambda: selection.table(record("selection")["scores"]),
    "labels": lambda: labels.table(record("labels")["scores"]),
    "absence": lambda: absence.table(record("absence")["scenes"]),
    "scannet": lambda: points("eval-scannet", "mIoU"),
    "scenesplat": lambda: points("eval-scenesplat", "f-mIoU"),
    "joint": joint,
    "fewer pixels": fewer,
    "reference": reference,
    "lerf sized": lerf_sized,
    "lerf sized beside": lerf_sized_beside,
    "viewer": lambda: viewer.sent_table(record("viewer")),
    "viewer in a browser": lambda: viewer.pages_table(record("viewer")),
    "city": lambda: city.table(record("city")["cases"]),
    "city, slopes": lambda: city.slope_table(record("city")["slopes"]),
    "city, predicted": lambda: city_model.check_table(record("city_model")["checks"]),
    "city, on paper": lambda: city_model.city_table(record("city_model")["city"]),
    "city, limits": lambda: city_model.limit_table(record("city_model")["limits"]),
    "hostile": lambda: hostile.table(record("hostile")["readers"]),
    "endurance": lambda: endurance.table(record("endurance")["verbs"]),
    "server load": lambda: server_load.table(record("server_load")),
    "stream": lambda: stream.table(record("stream")["rows"]),
    "coding, compared": lambda: compared_table(record("coding")["sizes"]),
}
"""By name."""


def made(text: str) -> str:
    """A document with its tables made anew, without what aligns their columns."""

    def block(found: re.Match[str]) -> str:
        return (
            found[1] + re.sub("-{4,}", "---", re.sub(" +", " ", TABLES[found[2]]().strip())) + "\n" + found[3]
        )

    return BLOCK.sub(block, text)


@dataclass(frozen=True)
class Arguments:
    check: bool = False
    """Write nothing; name the documents that say something else than the records, and exit with 1."""


def main(arguments: Arguments) -> list[Path]:
    """Make the tables; returns the documents that change."""
    changed = []
    for path in DOCUMENTS:
        before = path.read_text(encoding="utf-8")
        after = made(before)
        if after != before:
            changed.append(path)
            print(path.relative_to(ROOT))
            if not arguments.check:
                path.write_text(after, encoding="utf-8")
    return changed


if __name__ == "__main__":
    arguments = tyro.cli(Arguments, description=__doc__)
    sys.exit(int(bool(main(arguments)) and arguments.check))
