"""Each kernel against what the device can do: the time that its bytes and operations take at the measured ceilings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from statistics import median
from typing import Any

from benchmarks.gpu import ceilings
from benchmarks.gpu.context import Context, project
from benchmarks.gpu.counting import FORMULAS, Count, Facts, sorting
from benchmarks.gpu.kernel_times import Launches, timed_kernels
from benchmarks.gpu.region_sums import ours
from benchmarks.gpu.rendering import ask, coefficients, colors, features
from benchmarks.gpu.timing import reason
from scoup.bench import Workload

ROUNDS = 7
OF_THE_VIEW = ("region_sums_kernel",)  # whose formula counts all launches together
SORTING = "sorts, sums and gathers of torch in look"


def roofline(context: Context) -> None:
    """A row for each kernel and what it was launched for."""
    sizes = context.sizes
    context.result["about"] = (
        f"{sizes.n_gaussians:,} Gaussians, a view of {sizes.width} x {sizes.height}, three levels, L = "
        f"{sizes.n_atoms[0]}; each kernel by itself"
    )
    work = context.work(sizes.n_atoms[0])
    view = project(work.gaussians, work.camera)
    facts = Facts(work, view)  # pyright: ignore[reportArgumentType]
    context.result["facts"] = facts.record()
    passes: dict[str, Callable[[], object]] = {
        "project": partial(project, work.gaussians, work.camera),
        "RGB": partial(colors, work),
        "coefficient maps": partial(coefficients, work),
        "relevancy": partial(ask, work),
        "features": partial(features, work),
        "region sums": partial(ours, work, view),
    }
    seen: set[str] = set()
    for purpose, run in passes.items():
        left_out = context.about_to(purpose)
        if left_out is not None or context.time_is_up():
            context.result["rows"].append({"name": purpose, "reason": left_out or "no time was left"})
            continue
        try:
            launched = rounds_of(context, run)
        except Exception as error:
            context.result["rows"].append({"name": purpose, "reason": reason(error)})
            context.clock.recover()
            continue
        if purpose == "project":
            add_sorting(context, facts, work, launched)
        for name, rounds in launched.items():
            # A kernel is told of once for each thing it is made for; `look` is part of every pass.
            if not rounds[0].seconds or (name in seen and name != "products_kernel"):
                continue
            seen.add(name)
            context.result["rows"].append(kernel_row(context, facts, name, purpose, rounds))
        context.save(context.result)
    context.result["rows"].sort(key=lambda row: -row.get("gap_s", 0.0))
    context.save(context.result)


def rounds_of(context: Context, run: Callable[[], object]) -> dict[str, list[Launches]]:
    """By kernel, its launches in each of several runs; those that compile are not counted."""
    found: dict[str, list[Launches]] = {}
    count = min(ROUNDS, context.sizes.repeats)
    if context.sizes.warm_up:
        run()
    for _ in range(count):
        with timed_kernels(context.clock) as launched:
            run()
        for name, launches in launched.items():
            found.setdefault(name, []).append(launches)
    return found


def kernel_row(
    context: Context, facts: Facts, name: str, purpose: str, rounds: list[Launches]
) -> dict[str, Any]:
    """Median over the runs of all launches in one, and the bound."""
    row: dict[str, Any] = {
        "name": name,
        "for": purpose,
        "launches": len(rounds[0].seconds),
        "median_s": median(sum(launches.seconds) for launches in rounds),
    }
    formula = FORMULAS.get(name)
    if formula is None:
        row["reason"] = "nobody has counted what it does: add a formula to benchmarks/gpu/counting.py"
        return row
    launched = rounds[0]
    try:
        counts = [formula(facts, *launch) for launch in zip(launched.grids, launched.constants, strict=True)]
    except Exception as error:
        row["reason"] = f"its formula does not fit how it is launched: {reason(error)}"
        context.clock.recover()
        return row
    total = counts[0] if name in OF_THE_VIEW else sum_of(counts)
    return add_bound(row, total, context.ceilings)


def sum_of(counts: list[Count]) -> Count:
    """Of several launches."""
    total = counts[0]
    for other in counts[1:]:
        total = replace(
            total,
            bytes=total.bytes + other.bytes,
            float32=total.float32 + other.float32,
            float64=total.float64 + other.float64,
            powers=total.powers + other.powers,
            tensor=total.tensor + other.tensor,
        )
    return total


def add_sorting(context: Context, facts: Facts, work: Workload, launched: dict[str, list[Launches]]) -> None:
    """What is left of ``look`` beside its kernels; host and device take turns there, so part of it is waiting."""
    from benchmarks.gpu.timing import Work, measure

    whole = measure(
        [Work("project", partial(project, work.gaussians, work.camera))],
        context.clock,
        min(ROUNDS, context.sizes.repeats),
        warm_up=context.sizes.warm_up,
    )[0]
    if "median_s" not in whole:
        return
    kernels = sum(median(sum(r.seconds) for r in rounds) for rounds in launched.values())
    row = {"name": SORTING, "for": "project", "median_s": max(0.0, whole["median_s"] - kernels)}
    context.result["rows"].append(add_bound(row, sorting(facts), context.ceilings))
    context.result["look_s"] = whole["median_s"]


def add_bound(row: dict[str, Any], count: Count, rates: dict[str, float]) -> dict[str, Any]:
    """Into the row: what was counted, the time of each at its ceiling, the longest of these, and the gap to it."""
    row["count"] = {name: value for name, value in asdict(count).items() if value}
    tensor = ceilings.FP16 if count.tensor_kind == "fp16" else ceilings.TF32
    amounts = {
        ceilings.COPY: count.bytes,
        ceilings.FLOAT32: count.float32,
        ceilings.FLOAT64: count.float64,
        ceilings.POWERS: count.powers,
        tensor: count.tensor,
    }
    times = {name: amount / rates[name] for name, amount in amounts.items() if amount and name in rates}
    if not times:
        row["reason"] = "no ceiling was measured"
        return row
    row["bounds_s"] = times
    row["bound_by"], row["bound_s"] = max(times.items(), key=lambda item: item[1])
    row["share_of_bound"] = row["bound_s"] / row["median_s"] if row["median_s"] > 0 else None
    row["gap_s"] = row["median_s"] - row["bound_s"]
    return row
