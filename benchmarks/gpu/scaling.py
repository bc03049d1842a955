"""How times grow with Gaussians, pixels and levels."""

from __future__ import annotations

from functools import partial
from typing import Any

from benchmarks.gpu.context import Context, project
from benchmarks.gpu.region_sums import ours, peer_rgb
from benchmarks.gpu.rendering import ask
from benchmarks.gpu.timing import Row, Work, add_ratios, measure, reason
from scoup.bench import Workload, fit_slope

ASK, SUMS, LOOK, PEER = "ours: relevancy of a query", "ours: region sums", "ours: look", "gsplat: RGB"


def scaling(context: Context) -> None:
    """Rows for every size, and the slope of each thing over each quantity: 1 where time is proportional to it."""
    sizes = context.sizes
    n_atoms = sizes.n_atoms[0]
    context.result["about"] = (
        f"otherwise {sizes.n_gaussians:,} Gaussians, a view of {sizes.width} x {sizes.height}, three levels; "
        f"L = {n_atoms}"
    )
    points: list[tuple[str, float, dict[str, Any]]] = []
    for zoom in sizes.zooms:
        size = max(1, round(sizes.width * zoom)), max(1, round(sizes.height * zoom))
        points.append(("pixels", size[0] * size[1], {"size": size}))
    points += [("levels", levels, {"levels": levels}) for levels in sizes.levels]
    points += [("Gaussians", count, {"n_gaussians": count}) for count in sizes.counts]
    for grows, amount, change in points:
        point(context, grows, amount, change)
    slopes(context)


def point(context: Context, grows: str, amount: float, change: dict[str, Any]) -> None:
    """Rows of one size."""
    here = {"grows": grows, "amount": amount}
    left_out = context.about_to(f"data, {amount} {grows}")
    if left_out is not None or context.time_is_up():
        context.result["rows"].append({"name": "all", **here, "reason": left_out or "no time was left"})
        return
    try:
        work = context.work(context.sizes.n_atoms[0], **change)
    except Exception as error:
        context.result["rows"].append({"name": "all", **here, "reason": reason(error)})
        context.clock.recover()
        return
    known = context.result["rows"]
    rows: list[Row] = []

    def keep() -> None:
        add_ratios(rows, {PEER: [PEER]})
        context.result["rows"] = known + [{**row, **here} for row in rows]
        slopes(context)
        context.save(context.result)

    measure(
        works_of(context, work),
        context.clock,
        context.sizes.repeats,
        context.time_is_up,
        context.sizes.warm_up,
        into=rows,
        about_to=lambda name: context.about_to(f"{name}, {amount} {grows}"),
        known=keep,
    )
    keep()


def works_of(context: Context, work: Workload) -> list[Work]:
    return [
        Work(LOOK, partial(project, work.gaussians, work.camera)),
        Work(ASK, partial(ask, work)),
        Work(SUMS, partial(ours, work)),
        Work(PEER, partial(peer_rgb, context, work)),
    ]


def slopes(context: Context) -> None:
    """Of everything that has been measured at two sizes or more."""
    found: dict[tuple[str, str], list[tuple[float, float]]] = {}
    for row in context.result["rows"]:
        if "median_s" in row:
            found.setdefault((row["grows"], row["name"]), []).append((row["amount"], row["median_s"]))
    context.result["slopes"] = [
        {"grows": grows, "name": name, **fit_slope(*zip(*points, strict=True)).record()}
        for (grows, name), points in found.items()
        if len({amount for amount, _ in points}) > 1
    ]
