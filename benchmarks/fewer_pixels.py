"""What looking at fewer pixels or fewer views saves, and what it costs in agreement, on the `kitchen` scene.

    python -m benchmarks.fewer_pixels [--data DATA] [--repeats 5] [--threads 2] [--out FILE.json]

What all views at full size say is the truth. Agreement: share of the Gaussians, weighted by how much they
paint, whose strongest atom is the same. Codes come from the "exact" solver, once for all variants.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median

import torch
import tyro
from torch import Tensor

import scoup
from benchmarks.data import data_folder, make_features
from scoup.scene.cameras import Camera, Cameras
from scoup.scene.gaussians import Gaussians
from scoup.scene.regions import Regions
from scoup.uplift.rasterise import region_sums
from scoup.uplift.vote import GaussianCodes, vote
from scoup_lab.bench import Stopwatch, describe_environment, markdown, write_json


@dataclass(frozen=True)
class Arguments:
    data: Path = field(default_factory=data_folder)
    """Folder that holds kitchen/."""
    repeats: int = 5
    """Interleaved repetitions; medians are printed."""
    threads: int = 2
    """Threads."""
    out: Path | None = None
    """Where to write the figures as JSON."""


VARIANTS = {
    "all views, full size": (1, 1.0),
    "every second pixel each way": (1, 0.5),
    "every third pixel each way": (1, 1 / 3),
    "every fourth pixel each way": (1, 0.25),
    "every second view": (2, 1.0),
    "every fourth view": (4, 1.0),
}
"""Step through the views, and scale of the images."""


def main(arguments: Arguments) -> dict[str, dict[str, float]]:
    """Time every variant and compare what it finds with the truth."""
    torch.set_num_threads(arguments.threads)
    kitchen = arguments.data / "kitchen"
    with tempfile.TemporaryDirectory() as folder:
        features = make_features(kitchen, Path(folder))
        gaussians = scoup.load_gaussians(kitchen / "scene" / "model.splat")
        cameras = scoup.load_cameras(kitchen)
        regions = scoup.load_regions(features, cameras)
        found = measure(arguments, gaussians, list(cameras), regions)
    print(table(found))
    if arguments.out is not None:
        write_json(arguments.out, {"environment": describe_environment(), **found}, overwrite=True)
    return found


def table(found: dict[str, dict[str, float]]) -> str:
    """Time and agreement by variant."""
    agreements = [key for key in next(iter(found.values())) if key.startswith("agreement")]
    body = [
        [name, f"{row['relative time']:.2f}", *(f"{row[key]:.3f}" for key in agreements)]
        for name, row in found.items()
    ]
    return markdown(["variant", "time relative to all", *agreements], body)


def measure(
    arguments: Arguments, gaussians: Gaussians, cameras: list[Camera], regions: Regions
) -> dict[str, dict[str, float]]:
    """By variant: time relative to the first, and agreement with it at each level."""
    books, rows = [], []
    for level in regions.levels:
        embeddings, of_views = regions.embeddings(level)
        books.append(scoup.fit_codes(embeddings, solver="exact"))
        rows.append(of_views)
    codes, codebook = [book.codes for book in books], torch.stack([book.atoms for book in books])
    timed = Stopwatch()
    strongest: dict[str, GaussianCodes] = {}
    painted: list[Tensor] = []
    for _ in range(arguments.repeats):
        for name, (step, scale) in VARIANTS.items():
            views = Cameras(
                camera.resized(round(camera.width * scale), round(camera.height * scale))
                for camera in cameras[::step]
            )
            sums = timed(name, region_sums, gaussians, views, regions)
            sums.rows = [{name: places[name] for name in views.names} for places in rows]
            strongest[name] = timed(f"{name}: vote", vote, sums, codes, codebook, keep=1)
            if not painted:
                painted = [torch.from_numpy(sums.matrix(level).sum(1)) for level in range(len(books))]
    first = next(iter(VARIANTS))
    truth = strongest[first]
    seconds = {
        name: median(map(sum, zip(timed.seconds[name], timed.seconds[f"{name}: vote"], strict=True)))
        for name in VARIANTS
    }
    found = {}
    for name, codes_found in strongest.items():
        row = {"relative time": seconds[name] / seconds[first]}
        for s, level in enumerate(regions.levels):
            same = (codes_found.indices[:, s, 0] == truth.indices[:, s, 0]) & (
                codes_found.weights[:, s, 0] > 0
            )
            row[f"agreement {level}"] = float((painted[s] * same).sum() / painted[s].sum())
        found[name] = row
    return found


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
