"""One view: what is asked of a field, beside the peer's RGB render of the same scene and view."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from typing import Any

import torch

from benchmarks.gpu.context import Context, project
from benchmarks.gpu.peers import decoded_cosines
from benchmarks.gpu.timing import Work, reason
from scoup import raster
from scoup.bench import Workload
from scoup.field.relevancy import relevancy

RGB = "gsplat: RGB"
DECODED = "coefficient maps, decoded to D channels, then cosines (LangSplatV2's way)"


def relevancy_name(n_atoms: int) -> str:
    return f"ours: relevancy of a query, L = {n_atoms}"


def features_name(n_atoms: int) -> str:
    return f"ours: features of all levels, L = {n_atoms}"


def peer_name(channels: int, at_once: int) -> str:
    return f"gsplat: {channels} channels, {at_once} at a time"


def main_view(context: Context) -> None:
    """Everything at the size of a LERF view."""
    rendering(context, (context.sizes.width, context.sizes.height), everything=True)


def large_view(context: Context) -> None:
    """The same at 1920 x 1080, without the slowest."""
    rendering(context, context.sizes.large, everything=False)


def rendering(context: Context, size: tuple[int, int], everything: bool) -> None:
    """Rows for one view; each of ours includes ``look``, as each of the peer's includes its projection and sort."""
    sizes = context.sizes
    context.result["about"] = (
        f"{sizes.n_gaussians:,} Gaussians, a view of {size[0]} x {size[1]}, three levels"
    )
    works: list[Work] = []
    for n_atoms in sizes.n_atoms:
        work = context.work(n_atoms, size=size)
        works.append(Work(relevancy_name(n_atoms), partial(ask, work)))
        if everything:
            works.append(
                Work(
                    f"{relevancy_name(n_atoms)}, view at hand",
                    at_hand(work, ask),
                )
            )
        works.append(Work(f"ours: coefficient maps, L = {n_atoms}", partial(coefficients, work)))
        works.append(Work(features_name(n_atoms), partial(features, work)))
    work = context.work(sizes.n_atoms[0], size=size)
    works.append(Work("ours: look (project, bin, sort)", partial(project, work.gaussians, work.camera)))
    works.append(Work("ours: RGB", partial(colors, work)))
    works.append(
        Work(DECODED, partial(decoded, work), note=f"with our coefficient maps, L = {sizes.n_atoms[0]}")
    )
    works += peer_works(context, work, everything)
    channels = sizes.channels[-1]
    context.rows(
        works,
        over={
            RGB: [RGB, f"{RGB}, packed"],
            DECODED: [DECODED],
            f"gsplat: {channels} channels": [peer_name(channels, n) for n in (32, 128)],
        },
    )
    if context.about_to("pictures") is None and not context.time_is_up():
        context.result["pictures"] = compare_pictures(context, work)
    context.save(context.result)


def peer_works(context: Context, work: Workload, everything: bool) -> list[Work]:
    """gsplat's renders, in the ways it can be told to take: whichever is faster counts."""

    def render(channels: int, packed: bool, at_once: int) -> object:
        peer = context.gsplat()
        values = work.values if channels == 3 else made(channels)
        with torch.no_grad():
            return peer.render(work.gaussians, work.camera, values, packed, at_once)

    @cache
    def made(channels: int) -> torch.Tensor:  # not before they are needed: they are large
        return torch.rand(len(work.gaussians), channels, device=context.device)

    wanted = context.sizes.channels if everything else context.sizes.channels[-1:]
    works = [Work(RGB, partial(render, 3, False, 32)), Work(f"{RGB}, packed", partial(render, 3, True, 32))]
    for channels in wanted:
        for at_once in (32, 128):
            works.append(Work(peer_name(channels, at_once), partial(render, channels, False, at_once)))
    return works


def at_hand(work: Workload, run: Callable[[Workload, raster.Projection], object]) -> Callable[[], object]:
    """``run`` with one view of the work, looked at when it is first run: that may fail, too."""
    view = cache(partial(project, work.gaussians, work.camera))
    return lambda: run(work, view())


def ask(work: Workload, view: raster.Projection | None = None) -> torch.Tensor:
    """[S, 1, H, W]: relevancy of one query against the four canonical phrases."""
    view = view or project(work.gaussians, work.camera)
    cosines = raster.render_cosines(view, work.indices, work.weights, work.codebook, work.queries)
    return relevancy(cosines[:, :1], cosines[:, 1:])


def coefficients(work: Workload) -> torch.Tensor:
    return raster.render_codes(
        project(work.gaussians, work.camera), work.indices, work.weights, work.codebook.shape[1]
    )


def features(work: Workload) -> torch.Tensor:
    return raster.render_features(
        project(work.gaussians, work.camera), work.indices, work.weights, work.codebook
    )


def colors(work: Workload) -> object:
    return raster.render_channels(project(work.gaussians, work.camera), work.values)


def decoded(work: Workload) -> torch.Tensor:
    cosines = decoded_cosines(coefficients(work), work.codebook, work.queries)
    return relevancy(cosines[:, :1], cosines[:, 1:])


def compare_pictures(context: Context, work: Workload) -> dict[str, Any]:
    """How far the two rasterisers' RGB renders are from each other, and our relevancy from the long way's."""
    found: dict[str, Any] = {}
    difference = (ask(work) - decoded(work)).abs()
    found["relevancy, ours against decoded, greatest difference"] = float(difference.max())
    try:
        with torch.no_grad():
            theirs = context.gsplat().render(work.gaussians, work.camera, work.values)
        image, _ = raster.render_channels(project(work.gaussians, work.camera), work.values)
        off = (image - theirs).abs().amax(2)
        found["RGB, ours against gsplat, mean difference"] = float(off.mean())
        found["RGB, share of pixels that differ by more than 1/255"] = float((off > 1 / 255).float().mean())
    except Exception as error:
        found["RGB, ours against gsplat"] = reason(error)
    return found
