"""Times of one view: queries, renders and region sums beside gsplat, dense uplift and the paper's scatter."""

from __future__ import annotations

from functools import cache, partial

import torch
from torch import Tensor

from benchmarks.gpu.gsplat import compile_gsplat, dense_uplift, load_gsplat, render
from benchmarks.gpu.stage import Row, Runs, Stage, project
from scoup import raster
from scoup.query.relevancy import relevancy
from scoup_lab.bench import Workload
from scoup_lab.bench.stages import region_sums_of_a_view, vote_of_a_view
from scoup_lab.synthetic.random_scene import clip_like

RGB = "gsplat: RGB"
DECODED = "coefficient maps, decoded to D channels, then cosines (LangSplatV2's way)"
SUMS = "ours: region sums of all levels"
DENSE = "dense uplift of all levels, D channels, by gsplat's backward"
SCATTER = "per-pixel scatter, level after level (the paper's)"


def relevancy_name(n_atoms: int) -> str:
    return f"ours: relevancy of a query, L = {n_atoms}"


def timing(stage: Stage) -> None:
    """Time one view. Rows include projection and sort, as gsplat's do, unless they say "projected before"."""
    sizes = stage.sizes
    stage.result["about"] = (
        f"{sizes.n_gaussians:,} Gaussians, a view of {sizes.width} x {sizes.height}, three levels of "
        f"{'/'.join(map(str, sizes.regions))} regions, K = {sizes.k}, L = {sizes.n_atoms[0]} unless the row says it"
    )
    compile_gsplat(stage)
    work = stage.work(sizes.n_atoms[0])
    runs = {**renders(stage, work), **sums(stage, work)}
    for n_atoms in sizes.n_atoms[1:]:
        runs |= of_codes(stage.work(n_atoms))
    peers = (RGB, f"gsplat: {sizes.channels[-1]} channels", DECODED, SCATTER, DENSE)
    stage.rows(runs, {peer: [name for name in runs if name.startswith(peer)] for peer in peers})

    @torch.no_grad()
    def off() -> Row:
        view = work.gaussians, work.camera
        theirs = render(load_gsplat(stage), *view, work.values)
        return {
            "value": float((raster.render_channels(project(*view), work.values)[0] - theirs).abs().mean())
        }

    stage.row("RGB, ours against gsplat: mean difference", off)
    of_large = renders(stage, stage.work(sizes.n_atoms[0], sizes.large))
    size = f"{sizes.large[0]} x {sizes.large[1]}"
    runs = {f"{name}, {size}": run for name, run in of_large.items() if "channels" not in name}
    stage.rows(runs, {RGB: [name for name in runs if name.startswith(RGB)]})


def of_codes(work: Workload) -> Runs:
    """Return what depends on the size of the codebook."""
    n_atoms, codes = work.codebook.shape[1], (work.indices, work.weights)
    new = partial(project, work.gaussians, work.camera)
    projection = cache(new)  # made when it is first needed: that may fail, too
    kept = cache(lambda: region_sums_of_a_view(work, projection()))
    of_features = f"ours: features of all levels, L = {n_atoms}"
    of_vote = f"ours: vote on the sums of one view, one round, L = {n_atoms}"
    return {
        relevancy_name(n_atoms): lambda: query(work, new()),
        f"{relevancy_name(n_atoms)}, projected before": lambda: query(work, projection()),
        f"ours: coefficient maps, L = {n_atoms}": lambda: raster.render_codes(new(), *codes, n_atoms),
        of_features: lambda: raster.render_features(new(), *codes, work.codebook),
        of_vote: lambda: vote_of_a_view(work, kept(), "triton"),
    }


def renders(stage: Stage, work: Workload) -> Runs:
    """Return our renders, decoding, and gsplat's in the ways it can be called: whichever is faster counts."""
    new = partial(project, work.gaussians, work.camera)

    @cache
    def made(channels: int) -> Tensor:  # not before they are needed: they are large
        return torch.rand(len(work.gaussians), channels, device=stage.device)

    @torch.no_grad()
    def rendered(channels: int, packed: bool = False, at_once: int = 32) -> Tensor:
        module, values = load_gsplat(stage), work.values if channels == 3 else made(channels)
        return render(module, work.gaussians, work.camera, values, packed, at_once)

    found: Runs = {
        **of_codes(work),
        "ours: project, bin and sort": new,
        "ours: RGB": lambda: raster.render_channels(new(), work.values),
        DECODED: partial(decoded, work),
        RGB: partial(rendered, 3),
        f"{RGB}, packed": partial(rendered, 3, True),
    }
    for channels in stage.sizes.channels:
        for at_once in (32, 128):
            found[f"gsplat: {channels} channels, {at_once} at a time"] = partial(
                rendered, channels, False, at_once
            )
    return found


def sums(stage: Stage, work: Workload) -> Runs:
    """Return region sums, and what they replace."""
    from benchmarks.scatter_kernel import scatter_view

    embeddings = [clip_like(len(codes), stage.sizes.dim).to(stage.device) for codes in work.codes]
    view = work.gaussians, work.camera
    projection = cache(partial(project, *view))

    def dense(channels: int) -> None:
        module = load_gsplat(stage)
        out = torch.zeros(len(work.labels), len(work.gaussians), stage.sizes.dim, device=stage.device)
        dense_uplift(module, work, embeddings, out, channels)

    def by_level() -> None:
        for level, codes in enumerate(work.codes):
            scatter_view(project(*view), work.labels[level : level + 1], [codes])

    return {
        SUMS: lambda: raster.region_sums(project(*view), work.labels),
        f"{SUMS}, projected before": lambda: raster.region_sums(projection(), work.labels),
        "per-pixel scatter, all levels in one pass": lambda: scatter_view(
            project(*view), work.labels, work.codes
        ),
        SCATTER: by_level,
        DENSE: partial(dense, stage.sizes.dim),
        f"{DENSE}, 32 channels a call": partial(dense, 32),
    }


def query(work: Workload, projection: raster.Projection) -> Tensor:
    """Return [S, 1, H, W]: relevancy of one query against the four canonical phrases."""
    cosines = raster.render_cosines(projection, work.indices, work.weights, work.codebook, work.queries)
    return relevancy(cosines[:, :1], cosines[:, 1:])


def decoded(work: Workload) -> Tensor:
    """Run ``query`` as LangSplatV2 does: coefficient maps are written out, decoded to D channels, and normalised."""
    projection, n_atoms = project(work.gaussians, work.camera), work.codebook.shape[1]
    maps = raster.render_codes(projection, work.indices, work.weights, n_atoms)
    features = [
        torch.nn.functional.normalize(own @ atoms, dim=-1)
        for own, atoms in zip(maps, work.codebook, strict=True)
    ]
    cosines = torch.stack([(own @ work.queries.T).permute(2, 0, 1) for own in features])
    return relevancy(cosines[:, :1], cosines[:, 1:])
