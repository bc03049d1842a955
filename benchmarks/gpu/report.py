"""The record as a page to read: a table per stage."""

from __future__ import annotations

from collections import Counter
from typing import Any

from benchmarks.gpu.runner import STAGES
from benchmarks.gpu.stage import Row
from scoup_lab.bench import markdown
from scoup_lab.bench.environment import in_one_line
from scoup_lab.bench.report import milliseconds

NONE = "-"


def report(record: dict[str, Any]) -> str:
    """Return Markdown of a record, whatever part of it there is."""
    interpreted = record["settings"]["interpreted"]
    unfinished = f"; **not finished** ({record.get('reason', 'still running')})"
    parts = [
        f"# GPU benchmark: {'interpreted on a CPU' if interpreted else record['machine']['gpu']}",
        "Written by `python -m benchmarks.gpu`; times are medians of interleaved runs, ratios are within this run. "
        "Nothing empties the caches between runs. Memory is what torch's allocator gave out at most; inputs of other "
        'rows count in "memory", not in what is above them.',
        f"{'Quick' if record['settings']['quick'] else 'Full'}, begun {record['started']}, {record['seconds']:.0f} s"
        + ("" if record["finished"] else unfinished),
        in_one_line(record["machine"]),
    ]
    if interpreted:
        parts.append("**Interpreted kernels of tiny scenes: no time here means anything.**")
    parts += [stage(name, result) for name, result in record["stages"].items()]
    return "\n\n".join(parts) + "\n"


def stage(name: str, result: dict[str, Any]) -> str:
    """Return heading, tables and notes of a stage."""
    parts = [f"## {STAGES.get(name, name)}", result.get("about", "")]
    if "reason" in result:
        parts.append(f"**Not complete**: {result['reason']}")
    rows = [row for row in result["rows"] if "outcome" not in row]
    counts = Counter(row["outcome"] for row in result["rows"] if "outcome" in row)
    parts.append(", ".join(f"{number} {outcome}" for outcome, number in counts.items()))
    timed = [row for row in rows if "median_s" in row]
    if timed:
        parts.append(timed_table(timed))
    notes = []
    for row in result["rows"]:
        notes += [f"* {row['name']}: {row[key]}" for key in ("value", "note", "reason") if key in row]
        if row.get("stages_s"):
            spent = ", ".join(f"{part} {value:.3g}" for part, value in row["stages_s"].items())
            notes.append(f"* {row['name']}, seconds: {spent}")
    return "\n\n".join(filter(None, [*parts, "\n".join(notes)]))


def timed_table(rows: list[Row]) -> str:
    """Return milliseconds, runs a second, memory, and ratios to what it is compared with."""
    compared = list(dict.fromkeys(name for row in rows for name in row.get("over", {})))
    headers = ["what", "ms", "least to most", "a second", "memory, MB", "of it above inputs"]
    body = []
    for row in rows:
        spread = f"{milliseconds(row['min_s'])} to {milliseconds(row['max_s'])}" if "min_s" in row else NONE
        memory = [row.get("peak_bytes"), row.get("working_bytes")]
        body.append(
            [row["name"], milliseconds(row["median_s"]), spread, f"{1 / row['median_s']:.3g}"]
            + [NONE if count is None else f"{count / 1e6:,.0f}" for count in memory]
            + [f"{row['over'][name]:.3g}" if name in row.get("over", {}) else NONE for name in compared]
        )
    return markdown([*headers, *(f"time over {name}" for name in compared)], body)
