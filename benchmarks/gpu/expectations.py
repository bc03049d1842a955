"""What was expected of the backend before it was ever run on a GPU, beside what came of it.

On an H200, 1M Gaussians, 988 x 731, three levels, inputs in memory; on other devices the ratios still mean something.
"""

from __future__ import annotations

from typing import Any

from benchmarks.gpu import building, region_sums, rendering

Row = dict[str, Any]

UNKNOWN = "not measured"


def expectations(record: dict[str, Any]) -> list[list[str]]:
    """Lines of expectation, measured, "yes", "no" or "not measured": one for each; none of interpreted kernels."""
    if record["settings"]["interpreted"]:
        return []
    first = record["settings"]["n_atoms"][0]
    views = rows_of(record, "rendering")
    sums = rows_of(record, "sums")
    builds = rows_of(record, "building")
    ask = views.get(rendering.relevancy_name(first), {})
    summed = sums.get(region_sums.OURS, {})
    build = builds.get(building.ours_name("paper"), {})
    lines = [
        most("relevancy of a query: at most 1.5 x gsplat's RGB render", ratio(ask, rendering.RGB), 1.5, "x"),
        least("relevancy of a query: 1000 frames a second", inverse(ask.get("median_s")), 1000, "/s"),
        least(
            "relevancy: 10 x the rate of decoding to D channels",
            inverse(ratio(ask, rendering.DECODED)),
            10,
            "x",
        ),
        most("region sums of a view: at most 2 x gsplat's RGB render", ratio(summed, rendering.RGB), 2, "x"),
        least("region sums of a view: 50 x dense uplift", inverse(ratio(summed, region_sums.DENSE)), 50, "x"),
        least(
            "build: 20 x the paper's procedure (plain solver)", inverse(ratio(build, building.PAPER)), 20, "x"
        ),
    ]
    for preset in ("paper", "default"):
        row = builds.get(building.ours_name(preset), {})
        lines.append(most(f"{building.ours_name(preset)}: under 3 s", row.get("median_s"), 3, "s"))
        peak = row.get("peak_bytes")
        lines.append(most(f"{building.ours_name(preset)}: under 3 GB", peak and peak / 1e9, 3, "GB"))
    differences = record["stages"].get("precision", {}).get("differences", [])
    default = next((found for found in differences if found["name"] == "fp16x3"), {})
    changed = default.get("pixels_of_another_order")
    lines.append(
        most("default precision: order of atoms changes at 1e-3 of pixels at most", changed, 1e-3, "")
    )
    return lines


def rows_of(record: dict[str, Any], stage: str) -> dict[str, Row]:
    return {row["name"]: row for row in record["stages"].get(stage, {}).get("rows", [])}


def ratio(row: Row, over: str) -> float | None:
    return row.get("over", {}).get(over)


def inverse(value: float | None) -> float | None:
    return 1 / value if value else None


def most(what: str, value: float | None, bound: float, unit: str) -> list[str]:
    return judged(what, value, unit, value is not None and value <= bound)


def least(what: str, value: float | None, bound: float, unit: str) -> list[str]:
    return judged(what, value, unit, value is not None and value >= bound)


def judged(what: str, value: float | None, unit: str, met: bool) -> list[str]:
    if value is None:
        return [what, "-", UNKNOWN]
    return [what, f"{value:.3g} {unit}".strip(), "yes" if met else "no"]
