"""Markdown tables for people, JSON files for everything else."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from scoup.base import write_text


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


def record_text(record: Mapping[str, Any], depth: int = 1) -> str:
    """Return JSON (no NaN) with a line for each entry of a mapping; a list, however long, stays on one. ``depth`` is
    that of the indentation."""
    lines = []
    for key, value in record.items():
        nested = isinstance(value, Mapping) and value
        text = record_text(value, depth + 1) if nested else json.dumps(value, allow_nan=False)
        lines.append(f"{' ' * depth}{json.dumps(key)}: {text}")
    return "{\n" + ",\n".join(lines) + "\n" + " " * (depth - 1) + "}"
