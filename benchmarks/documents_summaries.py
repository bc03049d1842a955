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


def scales(record: Records) -> str:
    """Return, per set of scenes, the mIoU of full-size region sums and what other scales differ from it."""
    ways, differences = record("scale")["ways"], record("scale")["differences"]
    pairs = {"500 pixels (default)": "default"} | {
        f"scale {way.rpartition(' ')[2]}": way for way in ways if way[-1] != "1" and way != "default"
    }
    rows = [
        [
            key.removesuffix(", clean"),
            f"{of['always']:.3f}",
            *(difference_cell(differences[f"{way} - default at 1"][key]["always"]) for way in pairs.values()),
        ]
        for key, of in ways["default at 1"].items()
    ]
    large = record("scale_large")
    for key, of in large["ways"]["default at 1"].items():
        cell = difference_cell(large["differences"]["default - default at 1"][key]["always"])
        name = f"{key.removesuffix(', clean')}, 960 x 720"
        rows.append([name, f"{of['always']:.3f}", cell, *[""] * (len(pairs) - 1)])
    return markdown(["scenes, `always`", "scale 1", *pairs], rows)
