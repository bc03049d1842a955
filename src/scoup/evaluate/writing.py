"""Reports as files: Markdown to read, JSON to compute with, LaTeX to print."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from scoup.evaluate.tables import Report, Table, overall_table, query_table, report_record, scene_table
from scoup.io import write_text


def write_report(
    report: Report, folder: Path, stem: str, levels: Sequence[str] = (), overwrite: bool = False
) -> dict[str, Any]:
    """Write ``stem.md``, ``stem.json`` and ``stem.tex``; the record of the JSON.

    Raises:
        OutputExistsError: one is there and ``overwrite`` is false.
    """
    tables = [overall_table(report), scene_table(report), query_table(report, levels)]
    record = report_record(report)
    write_tables(tables, folder, stem, f"{report.protocol}, rules of {report.system}", record, overwrite)
    return record


def write_tables(
    tables: Sequence[Table],
    folder: Path,
    stem: str,
    title: str,
    record: dict[str, Any],
    overwrite: bool = False,
    pictures: Sequence[str] = (),
) -> None:
    """Write tables as ``stem.md`` and ``stem.tex``, and a record as ``stem.json``.

    Args:
        tables: in order.
        folder: made if it is missing.
        stem: of the file names.
        title: of the Markdown page.
        record: of the JSON; no NaN.
        overwrite: replace what is there.
        pictures: file names to show at the end of the page.
    """
    folder.mkdir(parents=True, exist_ok=True)
    shown = [f"![{Path(name).stem}]({name})\n" for name in pictures]
    page = "\n".join([f"# {title}\n", *(table.markdown() for table in tables), *shown])
    write_text(folder / f"{stem}.md", page, overwrite)
    write_text(folder / f"{stem}.tex", "\n".join(table.latex() for table in tables), overwrite)
    write_text(folder / f"{stem}.json", json.dumps(record, indent=1, allow_nan=False) + "\n", overwrite)
