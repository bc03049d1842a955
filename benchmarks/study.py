"""The base of all studies, and the one runner: options, environment, rows that are kept, table and JSON.

A study is a dataclass whose fields are its options and whose docstring is its help. It yields rows, says what record
is made of them, and how a table is made of a record. Everything else is here.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, ClassVar, TypeAlias

from scoup.base import InputError, check_output, write_text
from scoup_lab.bench import describe_environment, write_json
from scoup_lab.bench.environment import in_one_line

Record: TypeAlias = dict[str, Any]
"""Content of JSON."""


@dataclass(frozen=True, kw_only=True)
class Study:
    """Options of the runner, and what a study has to say."""

    out: Path | None = None
    """JSON file for the figures, the machine and the commit."""
    rows: Path | None = None
    """File that keeps rows while the study runs; a run with the same options continues from it."""
    overwrite: bool = False
    """Replace OUT."""

    rows_depend_on: ClassVar[tuple[str, ...] | None] = None
    """Options without which kept rows cannot be used; all of the study's own by default."""

    def check(self) -> None:
        """Refuse options that cannot work, before any work."""

    def measure(self, known: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        """Yield the name and the figures of each row that is not known."""
        raise NotImplementedError

    def line(self, figures: Any) -> str:
        """Return what is printed of a row while the study runs."""
        return "done"

    def record(self, rows: dict[str, Any]) -> Record:
        """Return the content of the JSON beside the settings and the machine."""
        return {"rows": rows}

    @staticmethod
    def table(record: Record) -> str:
        """Return Markdown of a record."""
        raise NotImplementedError

    def settings(self) -> Record:
        """Return the study's own options; folders are of this machine and left out."""
        of_runner = {field.name for field in fields(Study)}
        return {
            name: value
            for name, value in asdict(self).items()
            if name not in of_runner and not isinstance(value, Path)
        }


def run(study: Study, name: str) -> Record:
    """Run a study: measure what is not kept, print its table, write its record."""
    study.check()
    if study.out is not None:
        check_output(study.out, overwrite=study.overwrite)
    environment = describe_environment()
    head = {"what": f"benchmarks {name}", "machine": environment}
    rows = _kept(study)
    for key, figures in study.measure(dict(rows)):
        rows[key] = figures
        print(f"{key}: {study.line(figures)}", file=sys.stderr, flush=True)
        if study.rows is not None:
            write_text(study.rows, json.dumps({**head, **_identity(study), "rows": rows}), overwrite=True)
    record = {**head, "settings": study.settings()}
    record = json.loads(json.dumps(record | study.record(rows)))
    print(in_one_line(environment))
    print(study.table(record))
    if study.out is not None:
        write_json(study.out, record, study.overwrite)
    return record


def report(stage: str, done: int, total: int) -> None:
    """Print progress, on a terminal only."""
    if sys.stderr.isatty():
        end = "\n" if done == total else ""
        print(f"\r{stage} {done}/{total} ", end=end, file=sys.stderr, flush=True)


def _identity(study: Study) -> Record:
    settings, names = study.settings(), study.rows_depend_on
    return {"settings": settings if names is None else {name: settings[name] for name in names}}


def _kept(study: Study) -> dict[str, Any]:
    if study.rows is None or not study.rows.exists():
        return {}
    kept = json.loads(study.rows.read_text())
    if kept["settings"] != json.loads(json.dumps(_identity(study)["settings"])):
        raise InputError(f"{study.rows}: its rows were measured with {kept['settings']}; pass another --rows")
    return kept["rows"]
