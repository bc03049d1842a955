"""The record as a page to read: one table a stage."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from benchmarks.gpu.expectations import expectations
from benchmarks.gpu.worker import STAGES
from scoup.bench import markdown
from scoup.bench.report import milliseconds

NONE = "-"
Row = dict[str, Any]


def report(record: dict[str, Any]) -> str:
    """Markdown of a record of ``conduct``, whatever part of it there is."""
    parts = [f"# GPU benchmark: {title(record)}", heading(record), parity(record["parity"])]
    if record["peer"]["reason"]:
        parts.append(f"gsplat: {record['peer']['reason']}")
    expected = expectations(record)
    if expected:
        parts.append(
            "## Expected and measured\n\n" + markdown(["expected", "measured", "met"], expected, left=2)
        )
    for name, result in record["stages"].items():
        parts.append(stage(name, result))
    return "\n\n".join(parts) + "\n"


def title(record: dict[str, Any]) -> str:
    device = record["machine"]["device"]
    return device["name"] if device and not record["settings"]["interpreted"] else "interpreted on a CPU"


def heading(record: dict[str, Any]) -> str:
    machine = record["machine"]
    versions = ", ".join(f"{name} {version}" for name, version in machine["versions"].items() if version)
    device = machine["device"]
    lines = [
        "Written by `python -m benchmarks.gpu`; times are medians of interleaved runs, ratios are within this run. "
        "Nothing empties the caches between runs. Memory is what torch's allocator gave out at most; inputs of other "
        'rows count in "memory", not in what is above them.',
        "",
        f"* mode {record['mode']}, begun {record['started']}, {record['seconds']:.0f} s"
        + ("" if record["finished"] else f"; **not finished** ({record.get('reason', 'still running')})"),
        f"* commit {machine['commit']}",
        f"* {versions}, Python {machine['python']}, CUDA {machine['cuda']}, driver {machine['driver']}",
        f"* CPU {machine['cpu']}, {machine['cores']} cores",
    ]
    if device:
        lines.append(
            f"* {device['name']}, compute capability {device['compute_capability']}, {device['multiprocessors']} "
            f"multiprocessors, {device['memory_bytes'] / 2**30:.0f} GiB"
        )
    if record["settings"]["interpreted"]:
        lines.append("* **interpreted kernels of tiny scenes: no time here means anything**")
    return "\n".join(lines)


def parity(found: dict[str, Any]) -> str:
    counts = ", ".join(f"{number} {name}" for name, number in found.get("counts", {}).items())
    state = "passed" if found.get("passed") else found.get("reason", "failed")
    texts = found.get("texts", {})
    failed = "".join(
        f"\n* {name}" + (f": `{last_line(texts[name])}`" if texts.get(name) else "")
        for name in found.get("failed", ())
    )
    return f"## Parity with the reference\n\n{state}" + (f": {counts}" if counts else "") + failed


def last_line(text: str) -> str:
    """Of an error with its traceback, what it says."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    said = [line for line in lines if line.startswith("E ")]
    return (said or lines)[0 if said else -1].replace("`", "'")[:200]


def stage(name: str, result: dict[str, Any]) -> str:
    """Heading, reason, table, and what else the stage tells."""
    parts = [f"## {STAGES[name][1]}"]
    if "about" in result:
        parts.append(result["about"])
    if "reason" in result:
        parts.append(f"**Not complete**: {result['reason']}")
    rows = result["rows"]
    tables = {
        "agreement": agreement_table,
        "ceilings": ceiling_table,
        "roofline": roofline_table,
        "scaling": scaling_table,
    }
    if rows:
        parts.append(tables.get(name, timed_table)(rows))
    if result.get("differences"):
        parts.append(difference_table(result["differences"]))
    if result.get("slopes"):
        parts.append(slope_table(result["slopes"]))
    for kind in ("pictures", "agreement"):
        for what, value in result.get(kind, {}).items():
            parts.append(f"{what}: {value if isinstance(value, str) else f'{value:.2g}'}")
    for what, seconds in result.get("stages_s", {}).items():
        parts.append(
            f"{what}, seconds: " + ", ".join(f"{part} {value:.3g}" for part, value in seconds.items())
        )
    notes = dict.fromkeys(f"* {row['name']}: {row['note']}" for row in rows if "note" in row)
    reasons = dict.fromkeys(f"* {row['name']}: {row['reason']}" for row in rows if "reason" in row)
    for lines in (notes, reasons):
        if lines:
            parts.append("\n".join(lines))
    return "\n\n".join(parts)


def timed_table(rows: Sequence[Row]) -> str:
    """Milliseconds, frames a second, memory, and ratios to what it is compared with."""
    compared = list(dict.fromkeys(name for row in rows for name in row.get("over", {})))
    headers = ["what", "ms", "least to most", "a second", "memory, MB", "of it above inputs"]
    headers += [f"time over {name}" for name in compared]
    body = []
    for row in rows:
        if "median_s" not in row:
            body.append([row["name"], *[NONE] * (len(headers) - 1)])
            continue
        spread = f"{milliseconds(row['min_s'])} to {milliseconds(row['max_s'])}" if "min_s" in row else NONE
        once = " (untimed runs only)" if row.get("repeats") == 0 else ""
        body.append(
            [row["name"] + once, milliseconds(row["median_s"]), spread, f"{1 / row['median_s']:.3g}"]
            + [megabytes(row.get(key)) for key in ("peak_bytes", "working_bytes")]
            + [f"{row['over'][name]:.3g}" if name in row.get("over", {}) else NONE for name in compared]
        )
    return markdown(headers, body)


def agreement_table(rows: Sequence[Row]) -> str:
    """What disagrees first."""
    body = [
        [row["name"], "yes" if row["agrees"] else "**no**"]
        + [f"{row['difference']:.2g}", f"{row['beyond']:.2g}"]
        if "agrees" in row
        else [row["name"], "not known", NONE, NONE]
        for row in sorted(rows, key=lambda row: row.get("agrees", False))
    ]
    return markdown(["what", "agrees", "greatest difference", "share of numbers that differ"], body, left=2)


def ceiling_table(rows: Sequence[Row]) -> str:
    body = [
        [row["name"], f"{row['rate']:.3g}" if "rate" in row else NONE, milliseconds(row["median_s"])]
        for row in rows
        if "median_s" in row
    ]
    return markdown(["what", "a second, best run", "median, ms"], body)


def roofline_table(rows: Sequence[Row]) -> str:
    """Largest gap first."""
    headers = ["kernel", "for", "ms", "bound, ms", "bound by", "share of the bound", "lanes that paint"]
    headers += ["MB", "float32, 1e9", "float64, 1e9", "powers, 1e9", "tensor, 1e9"]
    body = []
    for row in rows:
        count = row.get("count", {})
        painting = count.get("painting")
        body.append(
            [row["name"], row.get("for", NONE), milliseconds(row["median_s"]) if "median_s" in row else NONE]
            + [milliseconds(row["bound_s"]) if "bound_s" in row else NONE, row.get("bound_by", NONE)]
            + [NONE if row.get("share_of_bound") is None else f"{row['share_of_bound']:.0%}"]
            + [NONE if painting is None else f"{painting:.0%}"]
            + [f"{count['bytes'] / 1e6:.1f}" if "bytes" in count else NONE]
            + [
                f"{count[kind] / 1e9:.3g}" if kind in count else NONE
                for kind in ("float32", "float64", "powers", "tensor")
            ]
        )
    return markdown(headers, body, left=2)


def scaling_table(rows: Sequence[Row]) -> str:
    """A line for each size, a column for each thing."""
    names = list(dict.fromkeys(row["name"] for row in rows if "median_s" in row))
    cells = {(row["grows"], row["amount"], row["name"]): row for row in rows}
    body = []
    for grows, amount in dict.fromkeys((row["grows"], row["amount"]) for row in rows):
        found = [cells.get((grows, amount, name), {}) for name in names]
        body.append(
            [f"{amount:,} {grows}"]
            + [milliseconds(row["median_s"]) if "median_s" in row else NONE for row in found]
        )
    return markdown(["size", *(f"{name}, ms" for name in names)], body)


def slope_table(slopes: Sequence[dict[str, Any]]) -> str:
    body = [
        [item["grows"], item["name"], f"{item['slope']:.2f}"]
        + [NONE if item["standard_error"] is None else f"{item['standard_error']:.2f}"]
        for item in slopes
    ]
    return markdown(["with", "what", "slope", "standard error"], body, left=2)


def difference_table(found: Sequence[dict[str, Any]]) -> str:
    """Against "ieee"."""
    keys = {
        "coefficients_max": "coefficients, greatest difference",
        "cosines_max": "cosines, greatest difference",
        "sums_max_relative": "sums of codes, greatest difference over greatest number",
        "pixels_of_another_order": "pixels whose first K atoms change",
        "votes_of_another_order": "Gaussians whose vote changes",
    }
    body = [
        [row["name"], *(f"{row[key]:.2g}" if key in row else row.get("reason", NONE) for key in keys)]
        for row in found
    ]
    return markdown(["against ieee", *keys.values()], body)


def megabytes(count: float | None) -> str:
    return NONE if count is None else f"{count / 1e6:,.0f}"
