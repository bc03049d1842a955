"""scoup build: from a splat, cameras and regions to a language field."""

from __future__ import annotations

import time
from contextlib import AbstractContextManager, closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import tyro

from scoup.base.counts import counted
from scoup.cli.console import Console, kept
from scoup.cli.options import Flag, OptionalInteger, OptionalNumber, OptionalPath, OptionalText, OptionGroups
from scoup.cli.scene_options import ViewOptions

if TYPE_CHECKING:
    from scoup.base.processes import Processes
    from scoup.field.language_field import LanguageField
    from scoup.scene.gaussians import Gaussians
    from scoup.scene.regions import Regions
    from scoup.uplift.build_settings import BuildSettings
    from scoup.uplift.region_sums import RegionSums

CLIP_MODEL = "laion/CLIP-ViT-B-16-laion2B-s34B-b88K"
CLIP_DIM = 512


@dataclass(frozen=True, kw_only=True)
class Build(ViewOptions):
    """Build a language field from a trained splat, its cameras, and region features.

    SCENE is a folder as COLMAP, nerfstudio or Inria's code leave it; every guess about it can be overridden.
    Interrupted, the same command continues where it stopped.
    """

    option_groups: ClassVar[OptionGroups] = {
        "scene": "gaussians raster_preset",
        "coding": "n_atoms k wide no_wide solver effort epochs tolerance",
        "vote": "keep rounds",
        "region sum": "keep_sums sums sums_weights least_weight",
        "output": "out weight_bits embed_geometry",
    }

    scene: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="SCENE", help_behavior_hint="")]
    """Folder with cameras (and usually the photographs), or a cameras file."""
    gaussians: OptionalPath = None
    """The trained splat: .ply, .splat, .spz, .glb and more, or a gsplat checkpoint. Default: the one in SCENE."""
    out: OptionalPath = None
    """The field to write, a .scoup file. Default: <name of SCENE>.scoup here."""
    model: OptionalText = None
    """What made the region embeddings: a CLIP model by id, or a table of words. Queries will use it too. Default: what
    the features say (those of scoup extract do), else, for embeddings of 512
    dimensions, laion/CLIP-ViT-B-16-laion2B-s34B-b88K."""
    preset: Literal["default", "paper"] = "default"
    """default answers best (128 atoms, exact coding, wide codes, two rounds of the vote); paper is the method as
    published (64 atoms, Adam, one round). Options of coding and vote, where given, override it."""
    n_atoms: OptionalInteger = None
    """Atoms in the codebook of each level (L). Default: the preset's."""
    k: OptionalInteger = None
    """Atoms in the code of a region (K). Default: the preset's."""
    wide: Flag = False
    """Let regions vote with the K largest of the weights that explain them by all atoms together. Default: the
    preset's."""
    no_wide: Flag = False
    """Let regions vote with the K atoms that explain them best by themselves, as in the paper. Default: the
    preset's."""
    keep: OptionalInteger = None
    """Atoms each Gaussian keeps after the vote; 0 keeps all. Default: the preset's."""
    rounds: OptionalInteger = None
    """Rounds of the vote; after the first, regions count by their cosine with the outcome of the round before.
    Default: the preset's."""
    solver: OptionalText = None
    """How codes are learned: exact, or adam as in the paper, which takes minutes where exact takes a second. Default:
    the preset's."""
    effort: OptionalText = None
    """How long the exact solver searches: best, or fast in half the time. Default: the preset's."""
    epochs: OptionalInteger = None
    """Epochs of the adam solver; fewer are faster and a little worse. Default: the preset's."""
    tolerance: OptionalNumber = None
    """Stop adam early once its loss falls by less than this in 100 epochs. Default: never."""
    seed: int = 0
    """Seed of the codebook's start; the same seed gives the same file (adam needs the same number of threads, too)."""
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
        from scoup.base.locks import locked_file
        from scoup.base.processes import device_of_process, process_group
        from scoup.io import load_gaussians
        from scoup.io.scene_parts import find_splat
        from scoup.uplift.build import build
        from scoup.uplift.provenance import embedding_model_of

        device, out = device_of_process(self.device), self._output()
        source = find_splat(self.scene, self.gaussians)
        settings = self._settings(source)
        gaussians = load_gaussians(source).to(device)
        cameras, regions, features = self.load_views(self.scene)
        model = embedding_model_of(features, regions, out, self.model) or _usual_model(regions)
        console.say(
            f"{counted(len(gaussians), 'Gaussian')}, {counted(len(regions), 'view')} with regions of "
            f"{counted(len(cameras), 'camera')}"
        )
        started = time.perf_counter()
        with (
            process_group(device) as processes,
            locked_file(out, self.overwrite, processes),
            self._region_sums(out, gaussians, regions, settings, processes) as sums,
        ):
            self._announce(console, sums, len(regions), processes)
            with console.progress() as progress:
                field = build(
                    gaussians, cameras, regions, settings, embedding_model=model, geometry_path=source, sums=sums,
                    check_fit=not self.no_check_fit, progress=progress,
                )  # fmt: skip
            # Nobody gives up its sums before the field is there.
            processes.of_first(lambda: field.save(out, self.overwrite, self.embed_geometry, self.weight_bits))
            bytes_of_sums = sums.bytes if self.keep_sums else None
        if processes.first:
            _report(console, field, out, len(regions), bytes_of_sums, device, time.perf_counter() - started)

    def _output(self) -> Path:
        """The file to write, after checking that it and what goes beside it may be written."""
        from scoup.base.errors import InputError
        from scoup.io import check_output
        from scoup.io.camera_sources import scene_folder
        from scoup.uplift.region_sums import sums_path

        out = self.out or Path(f"{scene_folder(self.scene).resolve().name}.scoup")
        if out.suffix.lower() != ".scoup":
            raise InputError(f"{out}: give a name that ends in .scoup")
        check_output(out, self.overwrite)
        if self.keep_sums:
            if self.sums is not None:
                raise InputError("--sums and --keep-sums do not go together: the sums are kept already")
            check_output(sums_path(out), self.overwrite)
        return out

    def _settings(self, source: Path) -> BuildSettings:
        """The preset with the options given, for a splat."""
        from scoup.base.errors import InputError
        from scoup.io import default_preset
        from scoup.uplift.build_settings import build_settings

        if self.wide and self.no_wide:
            raise InputError("--wide and --no-wide do not go together; give one of them")
        names = ("n_atoms", "k", "keep", "rounds", "solver", "effort", "epochs", "tolerance", "seed")
        return build_settings(
            self.preset,
            **{name: getattr(self, name) for name in names},
            wide=self.wide if self.wide or self.no_wide else None,
            raster_preset=default_preset(source) if self.raster_preset == "auto" else self.raster_preset,
        )

    def _region_sums(
        self,
        out: Path,
        gaussians: Gaussians,
        regions: Regions,
        settings: BuildSettings,
        processes: Processes,
    ) -> AbstractContextManager[RegionSums]:
        """The sums named, or those in the file beside the output in which a build keeps what it has done."""
        from scoup.uplift.checkpoint import checkpoint
        from scoup.uplift.region_sums import RegionSums

        if self.sums is not None:
            return closing(RegionSums.open(self.sums))
        how = {"weights": self.sums_weights, "least_weight": self.least_weight}
        return checkpoint(out, gaussians, regions, settings.raster_preset, self.keep_sums, processes, **how)

    def _announce(self, console: Console, sums: RegionSums, views: int, processes: Processes) -> None:
        """Say what is continued, now, and what is kept, should the build be interrupted."""
        from scoup.uplift.checkpoint import continued

        if self.sums is None:
            share = len(processes.share(range(views)))
            console.kept = lambda: kept(len(sums), share, "views", "codes" if sums.codes else "")
        message = continued(sums, views)
        if processes.first and message:
            console.say(message)


def _usual_model(regions: Regions) -> str:
    """LangSplat's CLIP model for features that do not name theirs; "" where it cannot have made them."""
    rows = regions.load_embeddings(regions.view_names[0], regions.levels[0])
    return CLIP_MODEL if rows.shape[1] == CLIP_DIM else ""


def _report(
    console: Console,
    field: LanguageField,
    out: Path,
    views: int,
    bytes_of_sums: int | None,
    device: str,
    seconds: float,
) -> None:
    """Say what was built; ``bytes_of_sums`` where they are kept."""
    from scoup.field.part_sizes import part_sizes
    from scoup.uplift.region_sums import sums_path

    coding = field.info.provenance["coding"]
    for level, report in coding.items():
        console.say(
            f"level {level}: {counted(report['regions'], 'region')}, mean cosine {report['mean_cosine']:.3f}, "
            f"5th percentile {report['low_cosine']:.3f}, dead atoms {report['dead_atoms']:.0%}"
        )
    size, sizes, coded = out.stat().st_size, part_sizes(out), int(field.coded().sum())
    console.say(
        f"{out}: {size / 1e6:.1f} MB ({sizes}), "
        f"{coded:,} of {counted(len(field), 'Gaussian')} coded, built in {seconds:.0f} s"
    )
    record: dict[str, Any] = {"field": out}
    if bytes_of_sums is not None:
        console.say(
            f"{sums_path(out)}: {bytes_of_sums / 1e6:.1f} MB of region sums, {counted(views, 'view')}"
        )
        record |= {"sums": sums_path(out), "sums_bytes": bytes_of_sums}
    peak = _peak_gpu_memory(device)
    if peak is not None:
        console.say(f"peak memory on {device}: {peak / 1e9:.2f} GB")
        record["peak_gpu_bytes"] = peak
    record |= {"bytes": size, "gaussians": len(field), "coded": coded, "views": views}
    console.result({**record, "seconds": round(seconds, 2), "coding": coding})


def _peak_gpu_memory(device: str) -> int | None:
    """Most bytes that tensors took on a GPU so far; None for the CPU."""
    if device == "cpu":
        return None
    import torch

    return torch.cuda.max_memory_allocated(device)
