"""scoup build: from a splat, cameras and regions to a language field."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from scoup.cli.console import Console
from scoup.cli.options import (
    Flag,
    OptionalInteger,
    OptionalNumber,
    OptionalPath,
    OptionalText,
    WritesCommon,
    common_last,
)

if TYPE_CHECKING:
    from scoup.base.processes import Processes
    from scoup.scene.gaussians import Gaussians
    from scoup.scene.regions import Regions
    from scoup.uplift.region_sums import RegionSums

CLIP_MODEL = "laion/CLIP-ViT-B-16-laion2B-s34B-b88K"


@common_last
@dataclass(frozen=True, kw_only=True)
class Build(WritesCommon):
    """Build a language field from a trained splat, its cameras, and region features.

    SCENE is a folder as COLMAP, nerfstudio or Inria's code leave it; every guess about it can be overridden.
    Interrupted, the same command goes on where it stopped.
    """

    scene: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="SCENE", help_behavior_hint="")]
    """Folder with cameras (and usually the photographs), or a cameras file."""
    gaussians: OptionalPath = None
    """The trained splat: .ply, .splat, or a gsplat checkpoint. Default: the one in SCENE."""
    features: OptionalPath = None
    """Folder of region features. Default: SCENE/language_features."""
    out: OptionalPath = None
    """The field to write, a .scoup file. Default: <name of SCENE>.scoup here."""
    images: OptionalPath = None
    """Folder of the photographs. Default: images, images_2, images_4 or images_8 in SCENE."""
    downscale: Annotated[
        Literal[1, 2, 4, 8] | None, tyro.conf.arg(metavar="{1,2,4,8}", help_behavior_hint="")
    ] = None
    """Work at 1/N of the full image size: faster and coarser. Default: the size of the photographs found."""
    undistort: Flag = False
    """Accept cameras with lens distortion: their region maps are undistorted as they are read."""
    model: OptionalText = None
    """What made the region embeddings: a CLIP model by id, or a table of words. Queries will use it too. Default: what
    the features say (those of scoup extract do), else laion/CLIP-ViT-B-16-laion2B-s34B-b88K."""
    preset: Literal["default", "paper"] = "default"
    """default answers best (128 atoms, exact coding, two rounds of the vote); paper is the method as published (64
    atoms, Adam, one round). The settings below, where given, override it."""
    n_atoms: OptionalInteger = None
    """Atoms in the codebook of each level (L)."""
    k: OptionalInteger = None
    """Atoms in the code of a region (K)."""
    keep: OptionalInteger = None
    """Atoms each Gaussian keeps after the vote; 0 keeps all. Default: as many as K."""
    rounds: OptionalInteger = None
    """Rounds of the vote; in each after the first, regions count by their agreement with the outcome so far."""
    consensus: Flag = False
    """Bring regions that the same Gaussians see closer together before coding."""
    solver: OptionalText = None
    """How codes are learned: adam is the paper's; exact takes a second where that takes minutes."""
    effort: OptionalText = None
    """Of the exact solver: fast takes half the time of best."""
    epochs: OptionalInteger = None
    """Epochs of the adam solver; fewer are faster and a little worse."""
    tolerance: OptionalNumber = None
    """Stop adam early once its loss falls by less than this in 100 epochs. Default: never."""
    seed: int = 0
    """Seed of the codebook's start; the same seed gives the same file (with adam: and number of threads)."""
    raster_preset: Literal["auto", "inria", "gsplat"] = "auto"
    """Rasteriser constants the splat was trained with; auto: gsplat for its checkpoints, else inria."""
    weight_bits: Literal[8, 16] = 16
    """Bits of a stored code weight."""
    embed_geometry: Flag = False
    """Put the Gaussians into the field's file, so that it stands alone."""
    keep_sums: Flag = False
    """Also keep the region sums, in <out>.sums: with them scoup update adds and removes views, and --sums builds again
    (other embeddings, codes or rounds) without rasterising."""
    sums: OptionalPath = None
    """Take the region sums from this file, as --keep-sums has left it; nothing is rasterised. It is not changed."""
    sums_weights: Literal["float32", "float16"] = "float32"
    """How region sums are kept: float16 takes 5 bytes an entry instead of 7."""
    least_weight: float = 0.0
    """Leave out entries of the region sums below this, for less space. 0.01 leaves out a quarter to a half of them;
    Gaussians that paint hardly anything lose their codes with them."""

    def run(self, console: Console) -> None:
        """Build, save and report."""
        from scoup.base.errors import InputError
        from scoup.base.processes import device_of_process, process_group
        from scoup.io import (
            check_output,
            default_preset,
            load_cameras,
            load_gaussians,
            load_regions,
        )
        from scoup.uplift.build import build
        from scoup.uplift.build_settings import build_settings
        from scoup.uplift.region_sums import sums_path

        device = device_of_process(self.device)
        out = self.out or Path(f"{self.scene.resolve().name}.scoup")
        if out.suffix.lower() != ".scoup":
            raise InputError(f"{out}: give a name that ends in .scoup")
        check_output(out, self.overwrite)
        if self.keep_sums:
            if self.sums is not None:
                raise InputError("--sums and --keep-sums do not go together: the sums are kept already")
            check_output(sums_path(out), self.overwrite)
        source = self._splat()
        settings = build_settings(
            self.preset,
            n_atoms=self.n_atoms,
            k=self.k,
            keep=self.keep,
            rounds=self.rounds,
            consensus=self.consensus or None,
            solver=self.solver,
            effort=self.effort,
            epochs=self.epochs,
            tolerance=self.tolerance,
            seed=self.seed,
            raster_preset=default_preset(source) if self.raster_preset == "auto" else self.raster_preset,
        )
        gaussians = load_gaussians(source).to(device)
        distorted = "undistort" if self.undistort else "refuse"
        cameras = load_cameras(self.scene, self.images, self.downscale, distorted)
        regions = load_regions(self._features(), cameras)
        model = self._model(regions, out)
        console.say(
            f"{len(gaussians):,} Gaussians, {len(regions)} views with regions of {len(cameras)} cameras"
        )

        started = time.perf_counter()
        with process_group(device) as processes:
            sums = self._region_sums(out, gaussians, regions, settings.raster_preset, processes, console)
            try:
                with console.progress() as progress:
                    field = build(
                        gaussians,
                        cameras,
                        regions,
                        settings=settings,
                        embedding_model=model,
                        geometry_path=source,
                        sums=sums,
                        progress=progress,
                    )
            except InputError:
                if self.sums is None and sums.path is not None and sums.is_empty:
                    sums.path.unlink(missing_ok=True)  # there is nothing to go on from
                raise
        if processes.first:
            field.save(out, self.overwrite, self.embed_geometry, self.weight_bits)
        bytes_of_sums = sums.bytes
        sums.close()
        if self.sums is None and sums.path is not None:
            if self.keep_sums:
                sums.path.replace(sums_path(out))
            else:
                sums.path.unlink(missing_ok=True)
        if not processes.first:
            return
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
        if self.keep_sums:
            console.say(
                f"{sums_path(out)}: {bytes_of_sums / 1e6:.1f} MB of region sums, {len(regions)} views"
            )
        peak = _peak_gpu_memory(device)
        if peak is not None:
            console.say(f"peak memory on {device}: {peak / 1e9:.2f} GB")
        console.result(
            {
                "field": out,
                **({"sums": sums_path(out), "sums_bytes": bytes_of_sums} if self.keep_sums else {}),
                **({} if peak is None else {"peak_gpu_bytes": peak}),
                "bytes": size,
                "gaussians": len(field),
                "coded": coded,
                "views": len(regions),
                "seconds": round(seconds, 2),
                "coding": field.info.provenance["coding"],
            }
        )

    def _region_sums(
        self,
        out: Path,
        gaussians: Gaussians,
        regions: Regions,
        raster_preset: str,
        processes: Processes,
        console: Console,
    ) -> RegionSums:
        """The sums named, or those in the file beside the output in which a build keeps what it has done."""
        from scoup.base.errors import InputError
        from scoup.uplift.rasterise import resumed
        from scoup.uplift.region_sums import RegionSums

        if self.sums is not None:
            return RegionSums.open(self.sums)
        if self.keep_sums and processes.world > 1:
            raise InputError("--keep-sums works in one process; run without torchrun")
        name = out.name + ".partial" + (f".{processes.rank}" if processes.world > 1 else "")
        more = {"weights": self.sums_weights, "least_weight": self.least_weight}
        sums = resumed(out.with_name(name), gaussians, regions, raster_preset, **more)
        if processes.first and (len(sums) or sums.codes is not None):
            known = "the codes are kept" if sums.codes is not None else "codes are learned anew"
            console.say(
                f"{sums.path}: goes on from an interrupted build: {len(sums)} of {len(regions)} views are taken "
                f"in, {known}"
            )
        return sums

    def _splat(self) -> Path:
        from scoup.base.errors import FileFormatError
        from scoup.io import find_gaussians

        if self.gaussians is not None:
            return find_gaussians(self.gaussians)
        try:
            return find_gaussians(self.scene)
        except FileFormatError as error:
            if not self.scene.exists():
                raise FileFormatError(self.scene, "there is no such scene", "check the path") from error
            problem = error.problem if self.scene.is_dir() else "is no splat, and none is named"
            raise FileFormatError(error.path, problem, "name the trained splat with --gaussians") from error

    def _features(self) -> Path:
        from scoup.base.errors import MissingFileError
        from scoup.io.regions.views import FOLDER_NAME

        if self.features is not None:
            return self.features
        folder = (self.scene if self.scene.is_dir() else self.scene.parent) / FOLDER_NAME
        if not folder.is_dir():
            problem = "there is no such folder (the region features were expected here)"
            raise MissingFileError(folder, problem, "say where they are with --features")
        return folder

    def _model(self, regions: Regions, out: Path) -> str:
        """The name of the embedding model for the field; a table is checked, and named relative to the field."""
        import os

        from scoup.base.errors import InputError
        from scoup.io.regions.manifest import read_manifest
        from scoup.models.word_table import is_table, load_table

        if self.model is None:
            manifest = read_manifest(self._features())
            return manifest.embedding_model if manifest and manifest.embedding_model else CLIP_MODEL
        if not is_table(self.model):
            return self.model
        dim = load_table(self.model).vectors.shape[1]
        wanted = regions.load_embeddings(regions.view_names[0], regions.levels[0]).shape[1]
        if dim != wanted:
            raise InputError(
                f"{self.model}: holds vectors of {dim} dimensions, but {self._features()} holds embeddings of "
                f"{wanted}; give the table that was made with the same model"
            )
        return Path(os.path.relpath(self.model, out.absolute().parent)).as_posix()


def _peak_gpu_memory(device: str) -> int | None:
    """Most bytes that tensors took on a GPU so far; None for the CPU."""
    if device == "cpu":
        return None
    import torch

    return torch.cuda.max_memory_allocated(device)
