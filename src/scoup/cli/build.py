"""scoup build: from a splat, cameras and regions to a language field."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro

from scoup.cli.console import Console, WritesCommon

CLIP_MODEL = "laion/CLIP-ViT-B-16-laion2B-s34B-b88K"


@dataclass(frozen=True, kw_only=True)
class Build(WritesCommon):
    """Build a language field from a trained splat, its cameras, and region features.

    SCENE is a folder as COLMAP, nerfstudio or Inria's code leave it; every guess about it can be overridden.
    Interrupted, the same command goes on where it stopped.
    """

    scene: tyro.conf.Positional[Path]
    """Folder with cameras (and usually the photographs), or a cameras file."""
    gaussians: Path | None = None
    """The trained splat: .ply, .splat, gsplat checkpoint. Default: the one in SCENE."""
    features: Path | None = None
    """Folder of region features in LangSplat's layout. Default: SCENE/language_features."""
    out: Path | None = None
    """The field to write. Default: <name of SCENE>.scoup here."""
    images: Path | None = None
    """Folder of the photographs. Default: images, images_2, images_4 or images_8 in SCENE."""
    downscale: Literal[1, 2, 4, 8] | None = None
    """Work at 1/N of the full image size."""
    undistort: bool = False
    """Accept cameras with lens distortion: their region maps are undistorted as they are read."""
    model: str = CLIP_MODEL
    """Model (or table of words) the region embeddings belong to; queries use it by default."""
    n_atoms: int = 64
    """Atoms in the codebook of each level (L)."""
    k: int = 4
    """Atoms in the code of a region (K)."""
    keep: int = 4
    """Atoms each Gaussian keeps after the vote; 0 keeps all."""
    solver: str = "adam"
    """How codes are learned: adam (the paper's)."""
    epochs: int = 4000
    """Epochs of the adam solver."""
    tolerance: float | None = None
    """Stop coding early once its loss falls by less than this in 100 epochs."""
    seed: int = 0
    """Seed of the codebook's start; the same seed gives the same file."""
    preset: Literal["auto", "inria", "gsplat"] = "auto"
    """Rasteriser constants the splat was trained with; auto: gsplat for its checkpoints, else inria."""
    weight_bits: Literal[8, 16] = 16
    """Bits of a stored code weight."""
    embed_geometry: bool = False
    """Put the Gaussians into the field's file, so that it stands alone."""
    keep_accumulators: bool = False
    """Also write the sums before the vote, needed to add views later."""

    def run(self, console: Console) -> None:
        """Build, save and report."""
        from scoup.artefact import accumulators_path
        from scoup.io import check_output, default_preset, find_gaussians, load_cameras, load_gaussians, load_regions
        from scoup.pipeline import BuildSettings, build

        out = self.out or Path(f"{self.scene.resolve().name}.scoup")
        check_output(out, self.overwrite)
        if self.keep_accumulators:
            check_output(accumulators_path(out), self.overwrite)
        source = find_gaussians(self.gaussians or self.scene)
        settings = BuildSettings(
            n_atoms=self.n_atoms,
            k=self.k,
            keep=self.keep,
            solver=self.solver,
            epochs=self.epochs,
            tolerance=self.tolerance,
            seed=self.seed,
            raster_preset=default_preset(source) if self.preset == "auto" else self.preset,
        )
        gaussians = load_gaussians(source).to(self.device)
        distorted = "undistort" if self.undistort else "refuse"
        cameras = load_cameras(self.scene, self.images, self.downscale, distorted)
        folder = self.features or (self.scene if self.scene.is_dir() else self.scene.parent)
        regions = load_regions(folder, cameras)
        console.say(f"{len(gaussians):,} Gaussians, {len(regions)} views with regions of {len(cameras)} cameras")

        started = time.perf_counter()
        with console.progress() as progress:
            field = build(
                gaussians,
                cameras,
                regions,
                settings=settings,
                embedding_model=self.model,
                geometry_path=source,
                keep_accumulators=self.keep_accumulators,
                checkpoint=out.with_name(out.name + ".partial"),
                progress=progress,
            )
        field.save(out, self.overwrite, self.embed_geometry, self.weight_bits)
        seconds = time.perf_counter() - started
        coded = int(field.coded().sum())
        for level, report in field.info.provenance["coding"].items():
            console.say(
                f"level {level}: {report['regions']} regions, mean cosine {report['mean_cosine']:.3f}, "
                f"5th percentile {report['low_cosine']:.3f}, dead atoms {report['dead_atoms']:.0%}"
            )
        size = out.stat().st_size
        console.say(
            f"{out}: {size / 1e6:.1f} MB ({size / max(1, len(field)):.0f} bytes a Gaussian), "
            f"{coded:,} of {len(field):,} Gaussians have a code, built in {seconds:.0f} s"
        )
        console.result(
            {
                "field": out,
                "bytes": size,
                "gaussians": len(field),
                "coded": coded,
                "views": len(regions),
                "seconds": round(seconds, 2),
                "coding": field.info.provenance["coding"],
            }
        )
