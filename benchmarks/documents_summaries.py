"""Summaries of records for the documents: a few rows where the record has many."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from benchmarks.answers import difference_cell
from scoup_lab.bench import markdown

Records = Callable[[str], dict[str, Any]]
"""The record of a name."""


def baselines(record: Records) -> str:
    """Return every method: scores in views, what the default gains, scores in space, cost."""
    plain, differences, selected = (table["rows"] for table in record("eval-baselines")["tables"])
    gains = {name.removeprefix("sparse - "): gain for name, gain in differences}
    in_space = {name: f"{score} ({ends})" for name, score, ends in selected}
    rows = [
        [name, score, gains.get(name, "-"), located, in_space[name], fit, query, size]
        for name, score, _, located, _, fit, query, size, *_ in plain
    ]
    heads = ["method", "mIoU", "sparse minus it", "localisation", "3D selection, mIoU", "fit, s"]
    return markdown([*heads, "query per frame, ms", "bytes per Gaussian"], rows)


def ablations(record: Records) -> str:
    """Return every change of the base, of three records; Adam ran with one codebook seed."""
    rows = []
    for name, note in {"": "", "-entropy": "", "-adam": " (one seed)"}.items():
        for change, _, score, *_, gain, published in record(f"eval-ablations{name}")["tables"][0]["rows"]:
            if gain != "-" or not name:
                rows.append([change + note, score, gain, published.partition(" / ")[0]])
    return markdown(["change", "mIoU", "minus base", "paper's mIoU"], rows)


def answers(record: Records, name: str, rules: Sequence[str]) -> str:
    """Return each set of scenes by each rule: every way, then the differences from the default."""
    ways, differences = record(name)["ways"], record(name)["differences"]
    pairs = [pair for pair in ("default - paper", "default - dense") if pair in differences]
    rows = [
        [
            key.removesuffix(", clean"),
            rule,
            *(f"{of[key][rule]:.3f}" for of in ways.values()),
            *(difference_cell(differences[pair][key][rule]) for pair in pairs),
        ]
        for key in next(iter(ways.values()))
        if key != "all"
        for rule in rules
    ]
    return markdown(["scenes", "rule", *ways, *pairs], rows, left=2)
