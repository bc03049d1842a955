"""The report of an evaluation or a study: tables, a record, and plots, written together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from scoup.base.atomic import atomic_file
from scoup.base.records import record_text
from scoup.base.staging import check_outputs, staged
from scoup_lab.evaluate.plots import IntervalPlot, can_draw, png
from scoup_lab.evaluate.tables import Table

OURS = "this run"  # the name of our own row
SUFFIXES = (".md", ".json", ".tex")


@dataclass(frozen=True)
class Report:
    """Tables, record and plots of one evaluation or study."""

    stem: str  # of the file names
    title: str  # of the page
    tables: Sequence[Table]
    record: dict[str, Any]  # for JSON; no NaN
    plots: Mapping[str, IntervalPlot] = field(default_factory=dict)  # by file name
    shown: int | None = None  # how many tables are printed; None for all, which the JSON then contains too

    def write(self, folder: Path, overwrite: bool = False) -> list[Path]:
        """Write ``stem.md``, ``stem.json``, ``stem.tex`` and, if matplotlib is installed, the plots: all or none.

        Returns all these files.
        """
        pictures = {name: png(plot) for name, plot in self.plots.items()} if can_draw() else {}
        record = self.record
        if self.shown is None:
            record = {**record, "tables": [asdict(table) for table in self.tables]}
        shown = [f"![{Path(name).stem}]({name})\n" for name in pictures]
        texts = {
            ".md": "\n".join([f"# {self.title}\n", *(table.markdown() for table in self.tables), *shown]),
            ".json": record_text(record) + "\n",
            ".tex": "\n".join(table.latex() for table in self.tables),
        }
        contents = {f"{self.stem}{suffix}": text.encode() for suffix, text in texts.items()}
        check_outputs(folder, list(contents), overwrite)
        contents |= pictures
        with staged(folder, list(contents), overwrite=True) as hidden:
            for name, content in contents.items():
                with atomic_file(hidden / name) as stream:
                    stream.write(content)
        return [folder / name for name in contents]
