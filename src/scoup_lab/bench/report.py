"""One Markdown table for people, one JSON file for everything else."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scoup.base.records import record_text
from scoup.io import write_text
from scoup_lab.bench.measure import Timing

SPECIFICATION = "reference"  # the backend others are compared with


@dataclass(frozen=True)
class Row:
    """One measured thing."""

    n_gaussians: int  # N
    stage: str  # see ``stages.STAGES``
    backend: str  # of the rasteriser
    threads: int  # torch threads
    timing: Timing  # its seconds

    def setting(self) -> dict[str, Any]:
        """Return what was measured, for JSON."""
        return {
            "gaussians": self.n_gaussians,
            "stage": self.stage,
            "backend": self.backend,
            "threads": self.threads,
        }

    def to_dict(self) -> dict[str, Any]:
        """Return the record, for JSON."""
        return {**self.setting(), **self.timing.to_dict()}


def ratios(rows: Iterable[Row]) -> dict[Row, float]:
    """Time of a row over that of the reference, same scene, stage and threads, wherever both were measured."""
    rows = list(rows)
    base = {
        (row.n_gaussians, row.stage, row.threads): row.timing.median
        for row in rows
        if row.backend == SPECIFICATION
    }
    found = {}
    for row in rows:
        against = base.get((row.n_gaussians, row.stage, row.threads))
        if row.backend != SPECIFICATION and against is not None:
            found[row] = row.timing.median / against
    return found


def comparison(rows: Iterable[Row]) -> dict[str, list[dict[str, Any]]]:
    """Return the rows and their ratios, for JSON."""
    rows = list(rows)
    over = [{**row.setting(), f"time_over_{SPECIFICATION}": ratio} for row, ratio in ratios(rows).items()]
    return {"rows": [row.to_dict() for row in rows], "ratios": over}


def stage_table(rows: Sequence[Row]) -> str:
    """Return Markdown: a line per row, with its median and that over the reference's."""
    over = ratios(rows)
    body = [
        [
            *(f"{row.n_gaussians:,}", row.stage, row.backend, str(row.threads)),
            milliseconds(row.timing.median),
            f"{over[row]:.3g}" if row in over else "-",
        ]
        for row in rows
    ]
    heads = ["Gaussians", "stage", "backend", "threads", "ms", f"time over {SPECIFICATION}"]
    return markdown(heads, body, left=3)


def milliseconds(seconds: float) -> str:
    """Return milliseconds with three significant figures, without exponent."""
    value = 1e3 * seconds
    return f"{value:,.0f}" if value >= 100 else f"{value:.1f}" if value >= 10 else f"{value:.3g}"


def markdown(headers: Sequence[str], rows: Iterable[Sequence[str]], left: int = 1) -> str:
    """Return a Markdown table, padded so that it can be read as it stands; all but the first ``left``
    columns to the right."""
    table = [list(headers), *map(list, rows)]
    widths = [max(3, *(len(line[column]) for line in table)) for column in range(len(headers))]

    def line(cells: Sequence[str]) -> str:
        padded = [
            cell.ljust(width) if column < left else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(cells, widths, strict=True))
        ]
        return f"| {' | '.join(padded)} |"

    rule = ["-" * width if column < left else "-" * (width - 1) + ":" for column, width in enumerate(widths)]
    return "\n".join([line(table[0]), f"| {' | '.join(rule)} |", *map(line, table[1:])])


def write_json(path: str | Path, record: dict[str, Any], overwrite: bool = False) -> None:
    """Write a record, all or nothing."""
    write_text(path, record_text(record) + "\n", overwrite)
