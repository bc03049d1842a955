"""Instructions a pixel: those of a lane (``instructions``) times the lanes of a pixel (``lanes``)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from benchmarks.gpu.lanes import WHAT
from benchmarks.gpu.timing import Row
from scoup.base.errors import FileFormatError
from scoup.bench import markdown
from scoup.io.reading import number, read_json

HINT = "give the file that python -m benchmarks.gpu.lanes --json FILE writes"
FORWARD = "gsplat, forward, "
# What one kernel does not do at once: how often which ones are launched for it.
SUMS: dict[str, tuple[tuple[int, str], ...]] = {
    "codes 3 x 128, as 2 and 1": ((1, "codes 2 x 128"), (1, "codes 1 x 128")),
    "cosines 3 x 128, as 2 and 1": ((1, "cosines 2 x 128"), (1, "cosines 1 x 128")),
    "512 channels, 64 at a time": ((8, "64 channels"),),
    "gsplat, forward, 512 channels, 32 at a time": ((16, "gsplat, forward, 32 channels"),),
}


def read_lanes(path: Path) -> list[dict[str, Any]]:
    """Views and their lanes, as ``benchmarks.gpu.lanes`` wrote them.

    Raises:
        FileFormatError: it is something else.
    """
    record = read_json(path, "lanes of views")
    if not isinstance(record, dict) or record.get("what") != WHAT:
        raise FileFormatError(path, "does not hold lanes of views", HINT)
    try:
        for scene in record["scenes"]:
            str(scene["name"])
            for row in scene["rows"]:
                needed = (
                    ("painting_steps", "skipping_steps") if row["name"] == "gsplat" else ("tile", "chunk")
                )
                for key in (*needed, "lanes"):
                    number(path, row[key], key)
    except (KeyError, TypeError) as error:
        raise FileFormatError(path, f"is not as expected: {error!r}", HINT) from error
    return record["scenes"]


def of_kernel(row: Row, scene: dict[str, Any]) -> float | None:
    """Instructions a pixel that a kernel takes for a view; None where its lanes are not counted.

    For gsplat those are its forward kernels: a step of a warp that paints goes the longest way through the loop, one
    that skips the shortest, and each counts for all 32 pixels, as a turn of ours does for all of its program.
    """
    longest = row["instructions"] / row["lanes"]
    for lanes in scene["rows"]:
        if lanes["name"] == "gsplat" and row["name"].startswith(FORWARD):
            shortest = row["shortest"] / row["shortest_lanes"]
            return lanes["painting_steps"] * longest + lanes["skipping_steps"] * shortest
        if "chunk" in row and (lanes["tile"], lanes.get("chunk")) == (row["tile"], row["chunk"]):
            return lanes["lanes"] * longest
    return None


def a_pixel(rows: list[Row], scenes: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """For each view its name and ``instructions`` a pixel: by name of the kernel, and of ``SUMS``.

    Left out are kernels whose loop was not counted, and those whose lanes are not known.
    """
    views = []
    for scene in scenes:
        counts = {row["name"]: of_kernel(row, scene) for row in rows if "instructions" in row}
        own = {name: count for name, count in counts.items() if count is not None}
        for name, parts in SUMS.items():
            if all(part in own for _, part in parts):
                own[name] = sum(times * own[part] for times, part in parts)
        views.append({"name": scene["name"], "instructions": own})
    return views


def table(rows: list[Row], views: list[dict[str, Any]]) -> str:
    """What ``a_pixel`` found, a column for each view, and which of our kernels' lanes are not known."""
    names = [
        name
        for name in (*(row["name"] for row in rows), *SUMS)
        if any(name in view["instructions"] for view in views)
    ]
    cells = [
        [
            name,
            *(f"{view['instructions'][name]:,.0f}" if name in view["instructions"] else "" for view in views),
        ]
        for name in names
    ]
    parts = [markdown(["instructions a pixel", *(view["name"] for view in views)], cells)] if cells else []
    left = [
        f"{row['name']} (tile {row['tile']}, chunk {row['chunk']})"
        for row in rows
        if "instructions" in row
        and "chunk" in row
        and not all(row["name"] in view["instructions"] for view in views)
    ]
    if left:
        parts.append(f"lanes are not in the file for all views: {', '.join(left)}")
    return "\n\n".join(parts)
