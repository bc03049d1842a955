"""Tables and charts of the documents, made from the records kept in docs/benchmarks.

    python -m benchmarks.documents [--check]

What lies in a document between ``<!-- table: NAME -->`` and ``<!-- end of table -->`` is what ``TABLES[NAME]`` gives
today; the command puts it there. With --check nothing is written, and documents that say something else are named.
Numbers elsewhere are held against the records by tests/test_documents.py.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import tyro

from benchmarks.answers import Real
from benchmarks.archive_times import ArchiveTimes
from benchmarks.compare import Compare
from benchmarks.documents_chart import bars
from benchmarks.documents_summaries import ablations, answers, baselines
from benchmarks.first_words import FirstWords
from benchmarks.gpu import Gpu
from benchmarks.laptop import EMBEDDERS, Laptop
from benchmarks.lerf_sized import LerfSized
from benchmarks.query import Query
from benchmarks.real_scenes import PHOTOGRAPHED, place_of
from benchmarks.registration import Registration
from benchmarks.stages import Stages
from benchmarks.study import Study
from benchmarks.things import Things
from benchmarks.viewer import ViewerCost
from scoup_lab.bench import markdown

ROOT = Path(__file__).resolve().parents[1]
RECORDS = ROOT / "docs" / "benchmarks"
DOCUMENTS = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
BLOCK = re.compile(r"(<!-- table: ([^>]+?) -->\n).*?(<!-- end of table -->)", re.DOTALL)


@cache
def record(name: str) -> dict[str, Any]:
    """Return one of the records."""
    return json.loads((RECORDS / f"{name}.json").read_text())


def readme() -> str:
    """Return the ways of building on scenes with real models, the size of a field and the seconds of a build; bold: the
    best of a column, whichever way has it."""
    of = record("real")
    names = {
        "default": ("`scoup build`", 42),
        "paper": ("`scoup build --preset paper`", 36),
        "dense": ("dense 512-d uplift", 6144),
    }
    rendered = {place_of(name) for name in of["scenes"]["default"]} - {*PHOTOGRAPHED}
    columns = {
        title.format(len(rendered)): {way: of["ways"][way][group]["always"] for way in names}
        for group, title in README_COLUMNS.items()
    }
    rows = [
        [
            title,
            *(
                f"**{values[way]:.3f}**" if values[way] == max(values.values()) else f"{values[way]:.3f}"
                for values in columns.values()
            ),
            f"{size:,}",
        ]
        for way, (title, size) in names.items()
    ]
    return markdown(["mIoU", *columns, "bytes per Gaussian"], rows)


def single_steps() -> str:
    """Return the time of steps of scenes as large as LERF's."""
    build, query = record("lerf_sized"), record("query")["least"]
    rows = [
        ["`scoup build`", "1M Gaussians, 200 views of 988 x 731", f"{build['total_s']:.0f} s, 2 threads"],
        [
            "`scoup query`, one text and view",
            "the same size, files read",
            f"{query['scoup query']:.1f} CPU s",
        ],
        ["a further text in Python", "the same view", f"{query['query, same camera']:.2f} CPU s"],
    ]
    return markdown(["step", "measured on", "time"], rows)


README_COLUMNS = {
    "desk (real)": "desk (real)",
    "fox (real)": "fox (real)",
    "rendered photographs, real models": "mean of the {} rendered",
}


def laptop_chart() -> str:
    """Return the steps from photographs to the first answer as bars."""
    steps = Laptop.steps(record("laptop"), next(iter(EMBEDDERS)))
    return bars("From 200 photographs to the first answer: seconds on two CPU cores", steps, "s")


CHARTS: dict[str, Callable[[], str]] = {"times": laptop_chart}
"""Name of the picture in docs/images, without its ending."""
STUDIES: dict[str, tuple[type[Study], str]] = {
    "things": (Things, "things"),
    "lerf sized": (LerfSized, "lerf_sized"),
    "real": (Real, "real"),
    "laptop": (Laptop, "laptop"),
    "query": (Query, "query"),
    "first words": (FirstWords, "first_words"),
    "stages": (Stages, "stages"),
    "viewer": (ViewerCost, "viewer"),
    "archive times": (ArchiveTimes, "archive_times"),
    "compare": (Compare, "compare"),
    "registration": (Registration, "registration"),
    "gpu": (Gpu, "gpu-nvidia-h200"),
}
"""Tables that a study makes of its record: the study, and the name of the record."""
TABLES: dict[str, Callable[[], str]] = {
    "readme": readme,
    "single steps": single_steps,
    "answers": lambda: answers(record, "answers", ("always", "peak")),
    "baselines": lambda: baselines(record),
    "ablations": lambda: ablations(record),
    **{name: lambda of=of: of[0].table(record(of[1])) for name, of in STUDIES.items()},
}
"""By name."""
HIDDEN = {
    "stages": "100,000|backend",
    "things": "table-4|shelves-2|kitchen-22",
    "baselines": "visible-centre-pixel|top-contributors",
    "real": "from 0.(2|45)",
    "archive times": "150,018 .*|memory: import of torch alone",
    "ablations": "paper's mIoU|no top-K|L=(32|128)|K=[28]|without the 50 % of .* entropy|level by peak|"
    "two rounds, no top-K|every .*|Adam, .*|none without a code in blending|only level .|"
    "1/. of the views",
    "query": "location in the scene, (same text again|ten further .*)|relevancy, .*",
    "viewer": "exported words.*|program, bytes|scoup info, s",
}
"""Headings and first cells of the columns and rows that only the record has."""


def shown(table: str, hidden: str) -> str:
    """Return Markdown without the hidden columns and rows of its tables."""
    lines, kept = [], None
    for line in table.splitlines():
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
        if not line.startswith("|"):
            kept = None
            lines.append(line)
        elif kept is None or not re.fullmatch(hidden, cells[0]):
            if kept is None:
                kept = [place for place, cell in enumerate(cells) if not re.fullmatch(hidden, cell)]
            lines.append(f"| {' | '.join(cells[place] for place in kept)} |")
    return "\n".join(lines)


def fill_tables(text: str) -> str:
    """Return a document with its tables made again, without what aligns their columns."""

    def block(found: re.Match[str]) -> str:
        table = shown(TABLES[found[2]](), HIDDEN.get(found[2], "(?!)"))
        return found[1] + re.sub("-{4,}", "---", re.sub(" +", " ", table.strip())) + "\n" + found[3]

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
        after = fill_tables(before)
        if after != before:
            changed.append(path)
            print(path.relative_to(ROOT))
            if not arguments.check:
                path.write_text(after, encoding="utf-8")
    for name, chart in CHARTS.items():
        path = ROOT / "docs" / "images" / f"{name}.svg"
        if not path.is_file() or path.read_text(encoding="utf-8") != chart():
            changed.append(path)
            print(path.relative_to(ROOT))
            if not arguments.check:
                path.write_text(chart(), encoding="utf-8")
    return changed


if __name__ == "__main__":
    arguments = tyro.cli(Arguments, description=__doc__)
    sys.exit(int(bool(main(arguments)) and arguments.check))
