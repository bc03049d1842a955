"""Tables of text, as Markdown to read and LaTeX to print."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from scoup_lab.bench.report import markdown

CAVEATS = (
    "Thresholds are tuned for each data set by the papers.",
    "All views with regions are used for building, labelled ones too: nothing is held out.",
    "Intervals: 95 %, bootstrap over queries, the scenes being given.",
)


@dataclass(frozen=True)
class Table:
    """Text in rows and columns."""

    title: str  # above
    headers: tuple[str, ...]  # of the columns; the first is aligned left, the others right
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...] = ()  # below

    def markdown(self) -> str:
        """Return a GitHub table under a heading."""
        rows = [[cell.replace("|", "\\|") for cell in row] for row in self.rows]
        lines = [f"## {self.title}", "", markdown(self.headers, rows)]
        if self.notes:
            lines += ["", *(f"* {note}" for note in self.notes)]
        return "\n".join(lines) + "\n"

    def latex(self) -> str:
        """Return a ``table`` of booktabs, with the notes in small print below."""
        columns = "l" + "r" * (len(self.headers) - 1)
        lines = [r"\begin{table}", r"\centering", rf"\caption{{{_escaped(self.title)}}}"]
        lines += [rf"\begin{{tabular}}{{{columns}}}", r"\toprule", _latex_line(self.headers), r"\midrule"]
        lines += [_latex_line(row) for row in self.rows]
        lines += [r"\bottomrule", r"\end{tabular}"]
        lines += [rf"\par\footnotesize {_escaped(note)}" for note in self.notes]
        lines.append(r"\end{table}")
        return "\n".join(lines) + "\n"


def percent(share: float) -> str:
    """Return the cell of a share in 0..1; a dash for NaN."""
    return "-" if share != share else f"{100 * share:.1f}"


def number_or_none(value: float) -> float | None:
    """Return a number for JSON, which has no NaN."""
    return None if value != value else value


def _latex_line(cells: Sequence[str]) -> str:
    return " & ".join(_escaped(cell) for cell in cells) + r" \\"


def _escaped(text: str) -> str:
    return "".join(_LATEX.get(char, char) for char in text)


_LATEX = {char: "\\" + char for char in "&%$#_{}"} | {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
}
