"""The numbers that the kernels were given without a GPU, beside others: how many Gaussians at a time, how many warps,
and how many registers a thread may have before more of them wait elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import Any

from benchmarks.gpu.context import Context, project
from benchmarks.gpu.region_sums import ours
from benchmarks.gpu.rendering import ask, at_hand, colors
from benchmarks.gpu.timing import Work
from scoup import raster
from scoup.bench import Workload

# With these a multiprocessor holds half as many warps again, or twice as many, as with 255.
REGISTERS = (168, 128)
AS_IT_IS = "as it is"


def tuning(context: Context) -> None:
    """A row for each choice; whoever finds a faster one changes the constants of ``scoup.raster.triton``."""
    sizes = context.sizes
    context.result["about"] = (
        f"{sizes.n_gaussians:,} Gaussians, a view of {sizes.width} x {sizes.height}, three levels; the view is at hand "
        "unless the row says look"
    )
    works: list[Work] = []
    for n_atoms in reversed(sizes.n_atoms):  # the first comes last: what follows uses it
        work = context.work(n_atoms)
        works += variants(f"relevancy, L = {n_atoms}", at_hand(work, ask), of_codes())
    work = context.work(sizes.n_atoms[0])
    works += variants("region sums", at_hand(work, ours), of_regions())
    works += variants("RGB", at_hand(work, rgb), of_channels())
    works += variants("look and RGB", partial(colors, work), {AS_IT_IS: {}})
    works += variants("project", partial(project, work.gaussians, work.camera), {AS_IT_IS: {}})
    context.rows(works, over={work.name: [work.name] for work in works if work.name.endswith(AS_IT_IS)})
    context.save(context.result)


def rgb(work: Workload, view: raster.Projection) -> object:
    return raster.render_channels(view, work.values)


def variants(what: str, run: Callable[[], object], changes: dict[str, dict[str, Any]]) -> list[Work]:
    """A row for each set of changes."""
    return [Work(f"{what}: {name}", partial(changed, run, change)) for name, change in changes.items()]


def of_codes() -> dict[str, dict[str, Any]]:
    from scoup.raster.triton import rendering as gpu

    before = gpu.code_blocks

    def fewer(*arguments: Any) -> Any:
        return replace(before(*arguments), chunk=16)

    found: dict[str, dict[str, Any]] = {AS_IT_IS: {}, "16 at a time": {"gpu.code_blocks": fewer}}
    for most in REGISTERS:
        found[f"maxnreg = {most}"] = {"maxnreg": most}
        found[f"16 at a time, maxnreg = {most}"] = {"gpu.code_blocks": fewer, "maxnreg": most}
    return found


def of_regions() -> dict[str, dict[str, Any]]:
    found: dict[str, dict[str, Any]] = {AS_IT_IS: {}}
    for chunk, warps in ((16, 2), (32, 4), (64, 4)):
        name = f"gpu_regions.CHUNK = {chunk}, WARPS = {warps}"
        found[name] = {"gpu_regions.CHUNK": chunk, "gpu_regions.WARPS": warps}
    return found


def of_channels() -> dict[str, dict[str, Any]]:
    from scoup.raster.triton.rendering import ChannelBlocks

    found: dict[str, dict[str, Any]] = {AS_IT_IS: {}}
    for blocks in (ChannelBlocks(16, 32, 2), ChannelBlocks(16, 16, 4)):
        found[str(blocks)] = {"gpu.channel_blocks": lambda _, blocks=blocks: blocks}
    return found


def changed(run: Callable[[], object], change: dict[str, Any]) -> object:
    with constants(change):
        return run()


@contextmanager
def constants(change: dict[str, Any]) -> Iterator[None]:
    """Constants of ``scoup.raster`` by the names of their modules; "maxnreg" is an option of every launch."""
    from scoup.raster.triton import projection as gpu_view
    from scoup.raster.triton import region_sums as gpu_regions
    from scoup.raster.triton import rendering as gpu

    modules = {"gpu": gpu, "gpu_regions": gpu_regions}
    before: list[tuple[Any, str, Any]] = []
    try:
        for name, value in change.items():
            if name == "maxnreg":
                gpu_view.FUSED["maxnreg"] = value
                continue
            module, constant = name.split(".")
            before.append((modules[module], constant, getattr(modules[module], constant)))
            setattr(modules[module], constant, value)
        yield
    finally:
        gpu_view.FUSED.pop("maxnreg", None)
        for module, constant, value in before:
            setattr(module, constant, value)
