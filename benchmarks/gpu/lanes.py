"""Lanes that a view has, counted on the CPU in float64: neither a GPU nor triton is needed, and no time is told.

    python -m benchmarks.gpu.lanes [--data DATA] [--n-gaussians 300000 1000000] [--tiles 600] [--json FILE]

A lane is one pixel and one Gaussian, seen by one thread. Views are of the synthetic room and, where --data names the
folder that holds it, of kitchen. A row for each way to go through the lists of the tiles:

  ours     a program takes a tile, and its list in chunks of 16 or 32 Gaussians until all pixels of the tile have
           stopped. A list is filled up to whole chunks. Tiles are 8 x 8 pixels; 16 x 16 is what they were before. Lists
           hold what passes the exact test of ellipse against tile.
  gsplat   (1.5.3) a block takes a tile of 16 x 16, a thread a pixel. A warp, two rows of the tile, takes one Gaussian
           at a time until its 32 pixels have stopped. That Gaussians come in batches of 256, and that a block ends when
           all of it has stopped, does not change these steps. Lists hold all tiles that the rectangle of the radius
           touches; there is no exact test. The radius is what the opacity leaves of 3.33 standard deviations, in whole
           pixels. Near plane, bounds of the Jacobian, largest alpha and stop are gsplat's. Left out are Gaussians
           outside the image that only the rounded radius brings to its border, and which paint nothing: of the views
           here they make one pair in a thousand.

A pixel stops before the Gaussian that would take its transmittance below 1e-4. Columns:

  pairs     of Gaussians and tiles, in the whole view
  lanes     a pixel of the image: evaluated, for pixels that have stopped or are outside the image too, as long as their
            program or warp goes on. For gsplat these are steps of warps, each counted for its 32 pixels.
  painting  of them, those with alpha of 1/255 and more at a pixel that goes on
  steps that paint, steps that skip
            gsplat's lanes by what their warp does: paint at one of its pixels or more, or at none

Lanes are counted in so many blocks of 16 x 16 pixels, the same ones for every row, and divided by their pixels.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import scoup
from benchmarks.gpu.tile_walks import (
    GSPLAT,
    GSPLAT_TILE,
    WARP,
    Walk,
    chunked,
    rectangles,
    walk,
    warp_steps,
)
from benchmarks.gpu.timing import Row
from scoup.base.errors import InputError, ScoupError
from scoup.bench import markdown, random_scene_cameras, random_scene_gaussians, write_json
from scoup.io import check_output
from scoup.raster.binning import Bins, bin_to_tiles
from scoup.raster.presets import RASTER_PRESETS, RasterPreset
from scoup.raster.projection import ProjectedGaussians, project_gaussians, tile_counts
from scoup.scene.cameras import Camera
from scoup.scene.gaussians import Gaussians

BLOCK = 16  # pixels along a block that is counted: a whole number of all tiles here
CHUNKS = (16, 32)
TILES = (8, 16)
FRAME = 12  # of kitchen: the view that benchmarks.raster takes
WHAT = "benchmarks.gpu.lanes: lanes of a view"


def parse_words(words: list[str] | None = None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.gpu.lanes",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    # fmt: off
    add = parser.add_argument
    add("--data", type=Path, metavar="DATA", help="folder that holds kitchen/; without it only the room is counted")
    add("--n-gaussians", type=int, nargs="*", default=[300_000, 1_000_000], metavar="N", help="sizes of the room")
    add("--width", type=int, default=988, help="of the room's view, in pixels")
    add("--height", type=int, default=731, help="of the room's view, in pixels")
    add("--tiles", type=int, default=600, metavar="N", help="blocks of 16 x 16 pixels to count in, drawn by chance; "
        "all if there are no more")
    add("--seed", type=int, default=0, help="of the draw")
    add("--json", type=Path, metavar="FILE", help="write the figures to this file, too: "
        "benchmarks.gpu.instructions takes them with --lanes")
    add("--overwrite", action="store_true", help="replace a file of an earlier run")
    # fmt: on
    return parser.parse_args(words)


def tiles_of(blocks: NDArray[np.int64], bins: Bins, across: int) -> list[int]:
    """Tiles in these blocks, which are ``across`` in a row."""
    times = BLOCK // bins.tile
    rows, columns = (part[:, None, None] * times for part in np.divmod(blocks, across))
    step = np.arange(times)
    rows, columns = np.broadcast_arrays(rows + step[None, :, None], columns + step[None, None, :])
    there = (rows < bins.down) & (columns < bins.across)
    return (rows * bins.across + columns)[there].tolist()


def count_view(gaussians: Gaussians, camera: Camera, n_blocks: int, seed: int = 0) -> dict[str, Any]:
    """Rows of a view, and in how many blocks of how many they were counted."""
    size = camera.width, camera.height
    across, down = tile_counts(*size, BLOCK)
    rng = np.random.default_rng(seed)
    blocks = np.sort(rng.choice(across * down, min(n_blocks, across * down), replace=False))
    rows, columns = np.divmod(blocks, across)
    wide, high = (
        np.minimum(edge - part * BLOCK, BLOCK) for part, edge in zip((columns, rows), size, strict=True)
    )
    pixels = int((wide * high).sum())

    def walk_all(projection: ProjectedGaussians, bins: Bins, preset: RasterPreset) -> list[Walk]:
        return [walk(projection, bins, tile, *size, preset) for tile in tiles_of(blocks, bins, across)]

    found: list[Row] = []
    preset = RASTER_PRESETS["inria"]
    projection = project_gaussians(gaussians, camera, preset)
    for tile in TILES:
        bins = bin_to_tiles(projection, *size, tile)
        walks = walk_all(projection, bins, preset)
        painting = sum(own.painting for own in walks) / pixels
        for chunk in CHUNKS:
            row = {
                "tile": tile,
                "chunk": chunk,
                "pairs": len(bins.ranks),
                "lanes": chunked(walks, chunk) / pixels,
            }
            found.append({"name": f"tile {tile}, chunk {chunk}", **row, "painting": painting})
    projection = project_gaussians(gaussians, camera, GSPLAT)
    bins = rectangles(projection, *size)
    walks = walk_all(projection, bins, GSPLAT)
    paint, skip = (WARP * steps / pixels for steps in warp_steps(walks))
    found.append(
        {
            "name": "gsplat",
            "tile": GSPLAT_TILE,
            "pairs": len(bins.ranks),
            "lanes": paint + skip,
            "painting": sum(own.painting for own in walks) / pixels,
            "painting_steps": paint,
            "skipping_steps": skip,
        }
    )
    return {"blocks": len(blocks), "of_blocks": across * down, "rows": found}


def views(arguments: argparse.Namespace) -> Iterator[tuple[str, Gaussians, Camera]]:
    """What is counted, one after the other, so that only one scene is in memory."""
    camera = random_scene_cameras(3, arguments.width, arguments.height)[1]
    for count in arguments.n_gaussians:
        yield f"room {count:,}", random_scene_gaussians(count), camera
    if arguments.data is not None:
        folder = arguments.data / "kitchen"
        yield (
            "kitchen",
            scoup.load_gaussians(folder / "scene" / "model.splat"),
            scoup.load_cameras(folder)[FRAME],
        )


def report(record: dict[str, Any]) -> str:
    """A table for each view."""
    parts = []
    for scene in record["scenes"]:
        head = [scene["name"], "pairs", "lanes", "painting", "steps that paint", "steps that skip"]
        keys = ("lanes", "painting", "painting_steps", "skipping_steps")
        cells = [
            [row["name"], f"{row['pairs']:,}", *(f"{row[key]:.1f}" if key in row else "" for key in keys)]
            for row in scene["rows"]
        ]
        where = (
            f"{scene['name']}, {scene['n_gaussians']:,} Gaussians, {scene['width']} x {scene['height']} pixels: "
            f"pairs of the view; the rest for each pixel, counted in {scene['blocks']:,} of {scene['of_blocks']:,} "
            "blocks of 16 x 16 pixels"
        )
        parts.append(f"{where}\n\n{markdown(head, cells)}")
    return "\n\n".join(parts)


def main(words: list[str] | None = None) -> str:
    """The tables; with ``--json``, written to a file as a record, too."""
    arguments = parse_words(words)
    if arguments.tiles < 1:
        raise InputError(f"--tiles must be 1 or more, not {arguments.tiles}")
    if not arguments.n_gaussians and arguments.data is None:
        raise InputError("there is nothing to count: give --n-gaussians or --data")
    if arguments.data is not None and not (arguments.data / "kitchen").is_dir():
        raise InputError(
            f"{arguments.data}: holds no folder kitchen/; leave --data out to count the room only"
        )
    if arguments.json is not None:
        check_output(arguments.json, arguments.overwrite)
    scenes = []
    for name, gaussians, camera in views(arguments):
        if sys.stderr.isatty():
            print(f"counting: {name}", file=sys.stderr)
        about = {"n_gaussians": len(gaussians), "width": camera.width, "height": camera.height}
        scenes.append(
            {"name": name, **about, **count_view(gaussians, camera, arguments.tiles, arguments.seed)}
        )
    record = {"what": WHAT, "seed": arguments.seed, "scenes": scenes}
    if arguments.json is not None:
        write_json(arguments.json, record, arguments.overwrite)
    return report(record)


if __name__ == "__main__":
    try:
        print(main())
    except ScoupError as error:
        print(error, file=sys.stderr)
        sys.exit(2)
