"""The record as a page to read: what was expected, and a table a stage."""

from __future__ import annotations

from collections import Counter
from typing import Any

from benchmarks.gpu import build, precision, timing
from benchmarks.gpu.runner import STAGES
from benchmarks.gpu.stage import Row
from scoup_lab.bench import markdown
from scoup_lab.bench.environment import in_one_line
from scoup_lab.bench.report import milliseconds

NONE, MOST = "-", float("inf")


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
    else:
        table = markdown(["expected", "measured", "met"], yardsticks(record), left=2)
        parts.append(f"## Expected and measured\n\n{table}")
    parts += [stage(name, result) for name, result in record["stages"].items()]
    return "\n\n".join(parts) + "\n"


def yardsticks(record: dict[str, Any]) -> list[list[str]]:
    """Return what was expected before the backend was ever run on a GPU, the value measured, and whether that is met.

    On an H200, 1M Gaussians, 988 x 731, three levels, inputs in memory; on other devices ratios still say something.
    """
    rows = {row["name"]: row for result in record["stages"].values() for row in result["rows"]}

    def over(name: str, other: str, power: int = 1) -> float | None:
        ratio = rows.get(name, {}).get("over", {}).get(other)
        return ratio and ratio**power

    query = timing.relevancy_name(record["settings"]["n_atoms"][0])
    seconds = rows.get(query, {}).get("median_s")
    changed = rows.get(precision.answers_name("fp16x3"), {}).get("pixels_of_another_order")
    lines: list[tuple[str, float | None, str, float, float]] = [  # value, unit, least, most
        ("relevancy of a query: at most 1.5 x gsplat's RGB render", over(query, timing.RGB), "x", 0, 1.5),
        ("relevancy of a query: 1000 frames a second", seconds and 1 / seconds, "/s", 1000, MOST),
        (
            "relevancy: 10 x the rate of decoding to D channels",
            over(query, timing.DECODED, -1),
            "x",
            10,
            MOST,
        ),
        ("region sums of a view: at most 2 x gsplat's RGB render", over(timing.SUMS, timing.RGB), "x", 0, 2),
        ("region sums of a view: 50 x dense uplift", over(timing.SUMS, timing.DENSE, -1), "x", 50, MOST),
        ("build: 20 x the paper's procedure", over(build.NAMES["paper"], build.PAPER, -1), "x", 20, MOST),
        ("default precision: order of atoms changes at 1e-3 of pixels at most", changed, "", 0, 1e-3),
    ]
    for name in build.NAMES.values():
        peak = rows.get(name, {}).get("peak_bytes")
        lines.append((f"{name}: under 3 s", rows.get(name, {}).get("median_s"), "s", 0, 3))
        lines.append((f"{name}: under 3 GB", peak and peak / 1e9, "GB", 0, 3))
    return [
        [what, NONE, "not measured"]
        if value is None
        else [what, f"{value:.3g} {unit}".strip(), "yes" if least <= value <= most else "no"]
        for what, value, unit, least, most in lines
    ]


def stage(name: str, result: dict[str, Any]) -> str:
    """Return heading, tables and notes of a stage."""
    parts = [f"## {STAGES.get(name, name)}", result.get("about", "")]
    if "reason" in result:
        parts.append(f"**Not complete**: {result['reason']}")
    rows = [row for row in result["rows"] if "outcome" not in row]
    counts = Counter(row["outcome"] for row in result["rows"] if "outcome" in row)
    parts.append(", ".join(f"{number} {outcome}" for outcome, number in counts.items()))
    compared = [row for row in rows if precision.KEYS[0] in row]
    timed = [row for row in rows if "median_s" in row]
    if timed:
        parts.append(timed_table(timed))
    if compared:
        body = [[row["name"], *(f"{row[key]:.2g}" for key in precision.KEYS)] for row in compared]
        parts.append(markdown(["", *(key.replace("_", " ") for key in precision.KEYS)], body))
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
