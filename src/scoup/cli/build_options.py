"""Options of scoup build: how embeddings are coded, how views vote, what is written, and the views themselves."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from scoup.base import InputError, check_output, counted
from scoup.cli.console import Console
from scoup.cli.options import arg

if TYPE_CHECKING:
    from scoup.field import Field
    from scoup.scene import Cameras
    from scoup.uplift import RegionSums


@dataclass(frozen=True, kw_only=True)
class BuildOptions:
    """Settings of a field."""

    model: str | None = None
    """Model of the region embeddings, which queries use too, or a word table made with it, which queries then use.
    Default: the model that the features name, else, for embeddings of 512 dimensions,
    laion/CLIP-ViT-B-16-laion2B-s34B-b88K."""
    segmenter: str | None = None
    """Segmenter for a scene without regions, as for scoup extract."""
    embedder: str | None = None
    """Embedder for a scene without regions, as for scoup extract."""
    preset: Literal["default", "paper"] = "default"
    """default gives the best answers (128 atoms, exact coding, two rounds of the vote); paper is the method as
    published (64 atoms, Adam, one round)."""
    embed_geometry: bool = False
    """Embed the Gaussians in the field's file, so that it needs no other file."""


@dataclass(frozen=True, kw_only=True)
class CodingOptions:
    """Settings of the codes of embeddings."""

    n_atoms: int | None = None
    """Atoms in the codebook of each level (L). Default: 128; paper: 64."""
    k: int | None = None
    """Atoms in the code of a region (K). Default: 4."""
    codebook: Path | None = None
    """An earlier field of the scene, whose codebook codes the regions; only --k of the options of coding counts then.
    For photographs that came later. Default: a new codebook is learned."""


@dataclass(frozen=True, kw_only=True)
class SumOptions:
    """Settings and folder of region sums."""

    scale: Annotated[float | None, arg(metavar="NUMBER")] = None
    """Size of the images that region sums are made of, relative to the cameras', above 0 and up to 1. Default: the
    longer side has 500 pixels, or the camera's if it is shorter; paper: 1."""
    keep_sums: Path | None = None
    """Folder for the region sums, one file per view. Views that it contains unchanged are not rasterised again, so the
    same command resumes a build that was ended, and takes in new photographs. Default: a temporary folder."""
    sums: Path | None = None
    """Build from the region sums in this folder, written by --keep-sums, without rasterising."""
    part: str | None = None
    """I/N, such as 1/4: only rasterise every N-th view from the I-th on, into the folder of --keep-sums. Parts may be
    made in any order, on any machine; afterwards, build with --sums."""


@dataclass(frozen=True, kw_only=True)
class SceneOptions:
    """The parts of a scene."""

    gaussians: Path | None = None
    """The trained splat: .ply, .splat, .spz, .glb and more, or a gsplat checkpoint. Default: the one in SCENE."""
    raster_preset: str = "auto"
    """Rasteriser constants the splat was trained with: inria or gsplat; auto: gsplat for its checkpoints, else inria. A
    near plane that cuts what the cameras see is replaced, unless it is named (in units of the scene): inria:0.2."""
    features: Path | None = None
    """Folder of region features. Default: SCENE/language_features."""
    images: Path | None = None
    """Folder of the photographs. Default: images, images_2, images_4 or images_8 in SCENE."""
    undistort: bool = False
    """Accept cameras with lens distortion: their region maps are undistorted as they are read."""
    dataparser_transforms: Path | None = None
    """The dataparser_transforms.json of a nerfstudio training: brings the cameras to the frame of its splat."""
    no_check_fit: bool = False
    """Skip the check that small renders of the splat match the photographs."""

    def load_cameras(self, scene: Path) -> Cameras:
        from scoup.io import load_cameras

        distorted = "undistort" if self.undistort else "refuse"
        return load_cameras(
            scene, self.images, distorted=distorted, dataparser_transforms=self.dataparser_transforms
        )


def passed_options(options: Any) -> dict[str, Any]:
    """Return the options of a group that were passed, as written on the command line, with their values."""
    values = {field.name: (getattr(options, field.name), field.default) for field in fields(options)}
    return {
        f"--{name.replace('_', '-')}": value for name, (value, default) in values.items() if value != default
    }


def check_field_output(out: Path, overwrite: bool) -> None:
    """Refuse a name that no field may have, and one that is taken."""
    if out.suffix.lower() != ".scoup":
        raise InputError(f"{out}: expected a name that ends in .scoup, for it is a field; choose another")
    check_output(out, overwrite=overwrite)


def report_field(
    console: Console,
    field: Field,
    out: Path,
    sums: RegionSums | None,
    device: str,
    seconds: float,
    extraction: dict[str, Any],
) -> None:
    """Report what was built; the ``sums`` that are kept, and the extraction if there was one."""
    from scoup.field import part_sizes

    coding, views = field.info.provenance["coding"], len(field.info.provenance["views"])
    for level, report in coding.items():
        console.say(
            f"level {level}: {counted(report['regions'], 'region')}, their codes {report['mean_cosine']:.0%} alike"
        )
    if ":" in field.raster_preset:
        console.say(
            f"raster preset {field.raster_preset}: the number is the near plane, in units of the scene"
        )
    size, sizes, coded = out.stat().st_size, part_sizes(out), int(field.coded().sum())
    console.say(
        f"{out}: {size / 1e6:.1f} MB ({sizes}), "
        f"{coded:,} of {counted(len(field), 'Gaussian')} coded, built in {seconds:.0f} s"
    )
    record: dict[str, Any] = {"field": out, **({"extraction": extraction} if extraction else {})}
    if sums is not None:
        n_views, sums_bytes = sums.stored_size()
        console.say(f"{sums.path}: {sums_bytes / 1e6:.1f} MB of region sums, {counted(n_views, 'view')}")
        record |= {"sums": sums.path, "sums_bytes": sums_bytes}
    if device != "cpu":
        import torch

        peak = torch.cuda.max_memory_allocated(device)
        console.say(f"peak memory on {device}: {peak / 1e9:.2f} GB")
        record["peak_gpu_bytes"] = peak
    record |= {"bytes": size, "gaussians": len(field), "coded": coded, "views": views}
    console.result({**record, "seconds": round(seconds, 2), "coding": coding})


def with_frame_of(out: Path, field: Field) -> Field:
    """Return a field with the frame of the file that it replaces, if that is of the same Gaussians."""
    from scoup.base import WorldFrame
    from scoup.field import read_facts

    if out.is_file() and field.world == WorldFrame():
        with suppress(InputError):  # a damaged one
            facts = read_facts(out)
            if facts["fingerprint"] == field.fingerprint:
                return field.with_world(WorldFrame.of_header(facts))
    return field
