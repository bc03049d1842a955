"""Small files of our own formats as they will be released, with the answers that the code which wrote them gave.

    PYTHONPATH=. python tests/frozen_formats.py FOLDER    # writes them

``tests/frozen/formats`` was written so. Write it again only with a new version of a format, and keep the files of a
released version beside it. Nothing here is random, but processors may differ in the last bits.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path

import numpy as np
import torch

from cli_support import run
from io_samples import save_langsplat
from scoup.archive import Archive
from scoup.io import convert_regions, load_gaussians, save_gaussians, save_png
from scoup.models import CANONICAL_PHRASES, WordTable
from scoup.query import LanguageField
from scoup.scene import Gaussians
from scoup_lab.data.colmap_model import write_colmap
from support import random_gaussians, small_scene, unit

FORMATS = Path(__file__).parent / "frozen" / "formats"
CODES = ("--n-atoms", 8)


def write_scene(folder: Path) -> None:
    """420 Gaussians, more than 256 of them behind the three cameras, so that a bucket of region sums has no entries."""
    _, cameras, regions = small_scene(10, views=3, width=32, height=24, seed=7)
    save_gaussians(random_gaussians(420, 7, ("plain", "behind", "behind")), folder / "point_cloud.ply")
    write_colmap(cameras, folder / "sparse" / "0")
    for camera in cameras:
        black = torch.zeros(camera.height, camera.width, 3, dtype=torch.uint8)
        save_png(black, folder / "images" / camera.name)
    with tempfile.TemporaryDirectory() as plain:
        save_langsplat(regions, Path(plain))
        convert_regions(plain, folder / "language_features")
    names = ["kettle", "mug", "wooden table", *CANONICAL_PHRASES]
    vectors = torch.randn(len(names), 16, generator=torch.Generator().manual_seed(7))
    WordTable.save(folder / "words.npz", names, unit(vectors).numpy())


def gaussians_of_formats() -> Gaussians:
    """Those that all kept files belong to."""
    return load_gaussians(FORMATS / "scene" / "point_cloud.ply")


def answers(field: LanguageField) -> dict[str, np.ndarray]:
    """Relevancy of every fourth pixel of a view and of every Gaussian to two vectors that nobody trained."""
    camera = small_scene(1, views=1, width=32, height=24, seed=7)[1][0]
    vectors = unit(torch.randn(5, field.dim, generator=torch.Generator().manual_seed(5)))
    seen = field.relevancy(camera, vectors[:2], vectors[2:])
    own = field.gaussian_relevancy(vectors[:2], vectors[2:])
    return {
        "vectors": vectors.numpy(),
        "relevancy": seen[..., ::4, ::4].numpy(),
        "gaussian_relevancy": own.numpy(),
    }


def verb(*arguments: object) -> None:
    """A verb that has to succeed."""
    code, _, error = run(*arguments)
    if code:
        raise RuntimeError(error)


def main(out: Path) -> None:
    """Write a scene with its regions, a field with its Gaussians, one of 8-bit weights, region sums, an archive."""
    scene = out / "scene"
    write_scene(scene)
    build = ("build", scene, "--model", scene / "words.npz", *CODES, "--out")
    verb(*build, out / "field.scoup", "--embed-geometry", "--keep-sums", out / "sums")
    verb(*build, out / "field_8_bits.scoup")
    LanguageField.load(out / "field_8_bits.scoup").save(out / "field_8_bits.scoup", True, weight_bits=8)
    for name in ("field", "field_8_bits"):
        found = answers(LanguageField.load(out / f"{name}.scoup"))
        np.savez_compressed(out / f"{name}.npz", **found)  # pyright: ignore[reportArgumentType]
    Archive(out / "archive").add(out / "field.scoup", floor=2)


if __name__ == "__main__":
    target = Path(sys.argv[1])
    shutil.rmtree(target, ignore_errors=True)
    main(target)
