"""What the method's shortcuts save on the reference rasteriser: ratios on one view, interleaved in one run.

    python -m benchmarks.reference [--n-gaussians 160000] [--width 480] [--height 360] [--repeats 5] [--out FILE]

Uses the demo scene, so it needs no data. Compared: uplift through region sums against codes per pixel and against
dense 512-d uplift; cosines by the Gram shortcut against decoding a 512-d feature map.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch
import tyro
from torch import Tensor

from scoup import raster
from scoup.raster import reference
from scoup.scene.codes import SparseCodes
from scoup.scene.gaussians import Gaussians
from scoup.uplift.region_sums import RegionSums
from scoup.uplift.vote import vote
from scoup_lab.bench import Task, describe_environment, time_tasks, write_json
from scoup_lab.synthetic import make_demo_scene


@dataclass(frozen=True)
class Arguments:
    n_gaussians: int = 160_000
    """Of the demo scene."""
    width: int = 480
    """Of the view, in pixels."""
    height: int = 360
    """Of the view, in pixels."""
    repeats: int = 5
    """Interleaved repetitions; medians are printed."""
    out: Path | None = None
    """Where to write the figures as JSON."""


def main(arguments: Arguments) -> dict[str, float]:
    """Time every stage and print the table."""
    scene = make_demo_scene(0, arguments.n_gaussians, arguments.width, arguments.height, 2, 1)
    camera, gaussians = scene.building[0], scene.gaussians
    labels, embeddings = scene.regions.load_view(camera.name, camera.width, camera.height)
    generator = torch.Generator().manual_seed(0)
    codes = [SparseCodes.from_dense(torch.rand(len(rows), 64, generator=generator), 4) for rows in embeddings]
    count = len(gaussians)
    indices = torch.randint(64, (count, 3, 4), generator=generator, dtype=torch.uint8)
    weights = torch.rand(count, 3, 4, generator=generator)
    codebook = torch.randn(3, 64, 512, generator=generator)
    queries = torch.nn.functional.normalize(torch.randn(5, 512, generator=generator), dim=1)
    projection = reference.project(gaussians, camera, raster.RASTER_PRESETS["inria"])
    colors = raster.view_colors(gaussians, camera)

    stages: dict[str, Callable[[], object]] = {
        "project": lambda: reference.project(gaussians, camera, raster.RASTER_PRESETS["inria"]),
        "colour render": lambda: raster.render_channels(projection, colors),
        "uplift, region sums": lambda: vote_of_a_view(projection, gaussians, labels, codes, codebook),
        "uplift, codes per pixel": lambda: per_pixel_uplift(
            projection, labels, codes, torch.zeros(count, 192)
        ),
        "uplift, dense 512-d": lambda: dense_uplift(projection, labels, embeddings, count),
        "cosines, Gram shortcut": lambda: raster.render_cosines(
            projection, indices, weights, codebook, queries
        ),
        "cosines, decoded to 512-d": lambda: decoded_cosines(projection, indices, weights, codebook, queries),
    }
    tasks = {name: Task(stage, None, arguments.repeats) for name, stage in stages.items()}
    medians = {name: timing.median for name, timing in time_tasks(tasks).items()}
    print(
        f"{count:,} Gaussians, {camera.width} x {camera.height}, 3 levels, torch {torch.__version__}, "
        f"{torch.get_num_threads()} threads; medians of {arguments.repeats}"
    )
    print("| stage | ms | relative to the colour render |\n|---|---|---|")
    for name, value in medians.items():
        print(f"| {name} | {1e3 * value:.0f} | {value / medians['colour render']:.2f} |")
    for shortcut, others in (
        ("uplift, region sums", ("uplift, codes per pixel", "uplift, dense 512-d")),
        ("cosines, Gram shortcut", ("cosines, decoded to 512-d",)),
    ):
        for other in others:
            print(f"{shortcut}: {medians[other] / medians[shortcut]:.1f} x faster than {other}")
    if arguments.out is not None:
        ratios = {name: value / medians["colour render"] for name, value in medians.items()}
        found = {
            "environment": describe_environment(),
            "seconds": medians,
            "relative to the colour render": ratios,
        }
        write_json(arguments.out, found, overwrite=True)
    return medians


def vote_of_a_view(
    projection: raster.Projection,
    gaussians: Gaussians,
    labels: Tensor,
    codes: list[SparseCodes],
    codebook: Tensor,
) -> None:
    """Sums over regions first, then codes."""
    sums = RegionSums("", torch.arange(len(gaussians)), ["s", "m", "l"])
    sums.append("view", raster.region_sums(projection, labels))
    sums.rows = [{"view": slice(0, len(level))} for level in codes]
    vote(sums, codes, codebook, backend="reference")


def per_pixel_uplift(
    projection: reference.ReferenceProjection, labels: Tensor, codes: list[SparseCodes], out: Tensor
) -> None:
    """The plain form: the code of every pixel, times the weight of every Gaussian there."""
    dense = [
        torch.cat([item.to_dense(), torch.zeros(1, item.n_atoms)]) for item in codes
    ]  # last row: no region
    image = torch.cat([rows[level.long()] for rows, level in zip(dense, labels, strict=True)], 2)
    _add_image(projection, image, out)


def dense_uplift(
    projection: reference.ReferenceProjection, labels: Tensor, embeddings: list[Tensor], count: int
) -> None:
    """The same with full embeddings instead of codes, level by level."""
    for rows, level in zip(embeddings, labels, strict=True):
        image = torch.cat([rows, torch.zeros(1, rows.shape[1])])[level.long()]
        _add_image(projection, image, torch.zeros(count, rows.shape[1]))


def _add_image(projection: reference.ReferenceProjection, image: Tensor, out: Tensor) -> None:
    """out [N, C] += sum over pixels of e_i(p) * image [H, W, C]."""
    tiled = reference.to_tiles(image.permute(2, 0, 1), projection.bins, fill=0)  # [tiles, C, P]
    for tile, ids, weights in reference.tile_weights(projection):
        out.index_add_(0, ids, weights @ tiled[tile].T)


def decoded_cosines(
    projection: raster.Projection, indices: Tensor, weights: Tensor, codebook: Tensor, queries: Tensor
) -> list[Tensor]:
    """Coefficient maps written out, decoded to 512 channels, normalised, compared."""
    maps = raster.render_codes(projection, indices, weights, codebook.shape[1])
    return [
        torch.nn.functional.normalize(level @ atoms, dim=-1) @ queries.T
        for level, atoms in zip(maps, codebook, strict=True)
    ]


if __name__ == "__main__":
    sys.exit(0 if main(tyro.cli(Arguments, description=__doc__)) else 1)
