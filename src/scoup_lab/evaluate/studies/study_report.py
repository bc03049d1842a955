"""What a study gives: tables, plots, and a record of everything."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from scoup_lab.evaluate.plots import Plot, can_draw, png
from scoup_lab.evaluate.tables import Table, write_tables


@dataclass(frozen=True)
class StudyReport:
    """Of one study.

    Attributes:
        stem: of the file names.
        title: of the page.
        tables: in order.
        record: for JSON, which gets the tables too; no NaN.
        plots: by file name.
    """

    stem: str
    title: str
    tables: Sequence[Table]
    record: dict[str, Any]
    plots: Mapping[str, Plot] = field(default_factory=dict)

    def write(self, folder: Path, overwrite: bool = False) -> list[Path]:
        """Write ``stem.md``, ``stem.json``, ``stem.tex`` and, if matplotlib is installed, the plots; all these files.

        Raises:
            OutputExistsError: a table is there and ``overwrite`` is false.
        """
        plots = {name: png(plot) for name, plot in self.plots.items()} if can_draw() else {}
        record = {**self.record, "tables": [asdict(table) for table in self.tables]}
        return write_tables(self.tables, folder, self.stem, self.title, record, overwrite, plots)
