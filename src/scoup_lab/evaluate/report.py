"""The report of an evaluation or a study: tables and a record, written together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from scoup.base import atomic_file, check_output, staged
from scoup_lab.bench.report import record_text
from scoup_lab.evaluate.tables import Table

OURS = "this run"  # the name of our own row
SUFFIXES = (".md", ".json", ".tex")


def refuse_existing(folder: Path, stem: str, overwrite: bool) -> None:
    """Refuse a report that is there already, before any work."""
    check_output(*(folder / f"{stem}{suffix}" for suffix in SUFFIXES), overwrite=overwrite)


@dataclass(frozen=True)
class Report:
    """Tables and record of one evaluation or study."""

    stem: str  # of the file names
    title: str  # of the page
    tables: Sequence[Table]
    record: dict[str, Any]  # for JSON; no NaN
    shown: int | None = None  # how many tables are printed; None for all, which the JSON then contains too

    def write(self, folder: Path, overwrite: bool = False) -> list[Path]:
        """Write ``stem.md``, ``stem.json`` and ``stem.tex``, all or none; return these files."""
        record = self.record
        if self.shown is None:
            record = {**record, "tables": [asdict(table) for table in self.tables]}
        texts = {
            ".md": "\n".join([f"# {self.title}\n", *(table.markdown() for table in self.tables)]),
            ".json": record_text(record) + "\n",
            ".tex": "\n".join(table.latex() for table in self.tables),
        }
        contents = {f"{self.stem}{suffix}": text.encode() for suffix, text in texts.items()}
        check_output(*(folder / name for name in contents), overwrite=overwrite)
        with staged(folder, list(contents), overwrite=True) as hidden:
            for name, content in contents.items():
                with atomic_file(hidden / name) as stream:
                    stream.write(content)
        return [folder / name for name in contents]
