"""Tables of text, as Markdown to read and LaTeX to print."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scoup.base.atomic import atomic_file
from scoup.base.records import record_text
from scoup.base.staging import check_outputs, staged

CAVEATS = (
    "Thresholds are tuned for each data set by the papers.",
    "All views with regions are used for building, labelled ones too: nothing is held out.",
    "Intervals: 95 %, bootstrap over queries, the scenes being given.",
)


@dataclass(frozen=True)
class Table:
    """Text in rows and columns.

    Attributes:
        title: above.
        headers: of the columns; the first is aligned left, the others right.
        rows: of cells.
        notes: below.
    """

    title: str
    headers: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...] = ()

    def markdown(self) -> str:
        """A GitHub table under a heading."""
        lines = [
            f"## {self.title}",
            "",
            _line(self.headers),
            "|---" + "|---:" * (len(self.headers) - 1) + "|",
        ]
        lines += [_line([cell.replace("|", "\\|") for cell in row]) for row in self.rows]
        if self.notes:
            lines += ["", *(f"* {note}" for note in self.notes)]
        return "\n".join(lines) + "\n"

    def latex(self) -> str:
        """A ``table`` of booktabs, with the notes in small print below."""
        columns = "l" + "r" * (len(self.headers) - 1)
        lines = [r"\begin{table}", r"\centering", rf"\caption{{{_escaped(self.title)}}}"]
        lines += [rf"\begin{{tabular}}{{{columns}}}", r"\toprule", _latex_line(self.headers), r"\midrule"]
        lines += [_latex_line(row) for row in self.rows]
        lines += [r"\bottomrule", r"\end{tabular}"]
        lines += [rf"\par\footnotesize {_escaped(note)}" for note in self.notes]
        lines.append(r"\end{table}")
        return "\n".join(lines) + "\n"


def write_tables(
    tables: Sequence[Table],
    folder: Path,
    stem: str,
    title: str,
    record: dict[str, Any],
    overwrite: bool = False,
    pictures: Mapping[str, bytes] | None = None,
) -> list[Path]:
    """Write tables as ``stem.md`` and ``stem.tex``, a record as ``stem.json``, and pictures: all or none; these files.

    Args:
        tables: in order.
        folder: made if it is missing.
        stem: of the file names.
        title: of the Markdown page.
        record: of the JSON; no NaN.
        overwrite: replace what is there; pictures are always replaced.
        pictures: contents by file name, to show at the end of the page.

    Raises:
        OutputExistsError: a table is there and ``overwrite`` is false.
    """
    pictures = pictures or {}
    shown = [f"![{Path(name).stem}]({name})\n" for name in pictures]
    page = "\n".join([f"# {title}\n", *(table.markdown() for table in tables), *shown])
    texts = {
        f"{stem}.md": page,
        f"{stem}.json": record_text(record) + "\n",
        f"{stem}.tex": "\n".join(table.latex() for table in tables),
    }
    check_outputs(folder, list(texts), overwrite)
    contents = {name: text.encode() for name, text in texts.items()} | dict(pictures)
    with staged(folder, list(contents), overwrite=True) as hidden:
        for name, content in contents.items():
            with atomic_file(hidden / name) as stream:
                stream.write(content)
    return [folder / name for name in contents]


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _latex_line(cells: Sequence[str]) -> str:
    return " & ".join(_escaped(cell) for cell in cells) + r" \\"


def _escaped(text: str) -> str:
    return "".join(_LATEX.get(char, char) for char in text)


_LATEX = {char: "\\" + char for char in "&%$#_{}"} | {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
}
