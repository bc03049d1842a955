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
_NONE = "-"


@dataclass(frozen=True)
class Row:
    """One measured thing."""

    scene: str  # name of the scene
    n_gaussians: int  # N
    stage: str  # see ``stages.STAGES``
    backend: str  # of the rasteriser
    threads: int  # torch threads
    timing: Timing  # its seconds

    def setting(self) -> dict[str, Any]:
        """Return what was measured, for JSON."""
        return {
            "scene": self.scene,
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
        (row.scene, row.n_gaussians, row.stage, row.threads): row.timing.median
        for row in rows
        if row.backend == SPECIFICATION
    }
    found = {}
    for row in rows:
        against = base.get((row.scene, row.n_gaussians, row.stage, row.threads))
        if row.backend != SPECIFICATION and against is not None:
            found[row] = row.timing.median / against
    return found


def comparison(rows: Iterable[Row]) -> dict[str, list[dict[str, Any]]]:
    """Return the rows and their ratios, for JSON."""
    rows = list(rows)
    over = [{**row.setting(), f"time_over_{SPECIFICATION}": ratio} for row, ratio in ratios(rows).items()]
    return {"rows": [row.to_dict() for row in rows], "ratios": over}


def stage_table(rows: Sequence[Row]) -> str:
    """Return Markdown: a line for each scene and stage; milliseconds of each backend and number of threads; ratios.

    Where medians come from different numbers of repetitions, the heading of each column says how many.
    """
    columns = list(dict.fromkeys((row.backend, row.threads) for row in rows))
    lines = list(dict.fromkeys((row.scene, row.n_gaussians, row.stage) for row in rows))
    cells = {(row.scene, row.n_gaussians, row.stage, row.backend, row.threads): row for row in rows}
    against = ratios(rows)
    compared = list(dict.fromkeys((row.backend, row.threads) for row in against))
    counts = {len(row.timing.seconds) for row in rows}

    def heading(column: tuple[str, int]) -> str:
        name = f"{column[0]}, {_threads(column[1])}, ms"
        if len(counts) < 2:
            return name
        own = {len(row.timing.seconds) for row in rows if (row.backend, row.threads) == column}
        return f"{name} ({'/'.join(map(str, sorted(own)))} runs)"

    headers = ["scene", "Gaussians", "stage", *map(heading, columns)]
    headers += [f"{backend}/{SPECIFICATION}, {_threads(threads)}" for backend, threads in compared]
    body = []
    for line in lines:
        scene, count, stage = line
        cell = [scene, f"{count:,}", stage]
        for column in columns:
            row = cells.get((*line, *column))
            cell.append(_NONE if row is None else milliseconds(row.timing.median))
        for column in compared:
            row = cells.get((*line, *column))
            cell.append(_NONE if row not in against else f"{against[row]:.3g}")
        body.append(cell)
    return markdown(headers, body, left=3)


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


def _threads(count: int) -> str:
    return f"{count} thread" + ("" if count == 1 else "s")
