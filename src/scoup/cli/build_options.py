"""Options of scoup build: how embeddings are coded, how views vote, what is written, and the views themselves."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from scoup.base.atomic import check_output
from scoup.base.counts import counted
from scoup.base.errors import InputError
from scoup.cli.console import Console
from scoup.cli.option_groups import borrow_options
from scoup.cli.options import Flag, OptionalPath, OptionalText, OptionGroups, WritesCommon, arg
from scoup.uplift.build_settings import BUILD_PRESETS, BuildSettings, build_settings

if TYPE_CHECKING:
    from scoup.field.language_field import LanguageField
    from scoup.scene.cameras import Cameras
    from scoup.scene.regions import Regions


_SETTINGS = "n_atoms k keep rounds solver effort epochs tolerance seed scale"


@dataclass(frozen=True, kw_only=True)
@borrow_options(BUILD_PRESETS["default"], _SETTINGS, paper=BUILD_PRESETS["paper"])
class BuildOptions(WritesCommon):
    """How a field is made."""

    option_groups: ClassVar[OptionGroups] = {
        "scene without regions": "segmenter embedder",
        "region sum": "scale",
        "coding": "n_atoms k solver effort epochs tolerance",
        "vote": "keep rounds",
        "output": "weight_bits embed_geometry",
    }

    model: OptionalText = None
    """Model of the region embeddings, which queries use too, or a word table made with it, which queries then use.
    Default: the model that the features name, else, for embeddings of 512 dimensions,
    laion/CLIP-ViT-B-16-laion2B-s34B-b88K."""
    segmenter: OptionalText = None
    """Segmenter for a scene without regions, as for scoup extract."""
    embedder: OptionalText = None
    """Embedder for a scene without regions, as for scoup extract."""
    preset: Literal["default", "paper"] = "default"
    """default gives the best answers (128 atoms, exact coding, two rounds of the vote); paper is the method as
    published (64 atoms, Adam, one round). Options of coding and vote override it."""
    weight_bits: Literal[8, 16] = 16
    """Bits of a stored code weight."""
    embed_geometry: Flag = False
    """Embed the Gaussians in the field's file, so that it needs no other file."""

    def settings(self, raster_preset: str) -> BuildSettings:
        """Return the preset with the options passed."""
        changes = {name: getattr(self, name) for name in _SETTINGS.split()}
        return build_settings(self.preset, **changes, raster_preset=raster_preset)

    def given(self) -> list[str]:
        """Return the options of this class that were passed, as written on the command line."""
        own = BuildOptions.__annotations__.keys() - {"option_groups"}
        return [
            "--" + field.name.replace("_", "-")
            for field in fields(self)
            if field.name in own and getattr(self, field.name) != field.default
        ]


@dataclass(frozen=True, kw_only=True)
class ViewOptions(WritesCommon):
    """Options for the views of a scene: their files and their size."""

    option_groups: ClassVar[OptionGroups] = {
        "scene": "features images downscale undistort dataparser_transforms no_check_fit"
    }

    features: OptionalPath = None
    """Folder of region features. Default: SCENE/language_features."""
    images: OptionalPath = None
    """Folder of the photographs. Default: images, images_2, images_4 or images_8 in SCENE."""
    downscale: Annotated[Literal[1, 2, 4, 8] | None, arg()] = None
    """Work at 1/N of the full image size: faster and coarser. Default: the size of the photographs found."""
    undistort: Flag = False
    """Accept cameras with lens distortion: their region maps are undistorted as they are read."""
    dataparser_transforms: OptionalPath = None
    """The dataparser_transforms.json of a nerfstudio training: brings the cameras to the frame of its splat."""
    no_check_fit: Flag = False
    """Skip the check that small renders of the splat match the photographs."""

    def load_cameras(self, scene: Path) -> Cameras:
        """Return the cameras of a scene."""
        from scoup.io import load_cameras

        return load_cameras(
            scene,
            self.images,
            self.downscale,
            "undistort" if self.undistort else "refuse",
            dataparser_transforms=self.dataparser_transforms,
        )

    def load_views(self, scene: Path) -> tuple[Cameras, Regions, Path]:
        """Return cameras and regions of a scene, and the folder of the regions."""
        from scoup.io import load_regions
        from scoup.io.scene_parts import find_features

        cameras = self.load_cameras(scene)
        features = find_features(scene, self.features)
        return cameras, load_regions(features, cameras), features


def check_field_output(out: Path, overwrite: bool) -> None:
    """Refuse a name that no field may have, and one that is taken."""
    if out.suffix.lower() != ".scoup":
        raise InputError(f"{out}: expected a name that ends in .scoup, for it is a field; choose another")
    check_output(out, overwrite)


def report_field(
    console: Console,
    field: LanguageField,
    out: Path,
    sums: Path | None,
    device: str,
    seconds: float,
    extraction: dict[str, Any],
) -> None:
    """Report what was built; the folder of ``sums`` that are kept, and the extraction if there was one."""
    from scoup.field.part_sizes import part_sizes
    from scoup.uplift.storage.array_file import stored_bytes, view_files

    coding, views = field.info.provenance["coding"], len(field.info.provenance["views"])
    for level, report in coding.items():
        console.say(
            f"level {level}: {counted(report['regions'], 'region')}, mean cosine {report['mean_cosine']:.3f}, "
            f"5th percentile {report['low_cosine']:.3f}, dead atoms {report['dead_atoms']:.0%}"
        )
    if strays := field.info.provenance.get("strays"):
        console.say(f"{counted(sum(strays.values()), 'stray')} cut from things")
    size, sizes, coded = out.stat().st_size, part_sizes(out), int(field.coded().sum())
    console.say(
        f"{out}: {size / 1e6:.1f} MB ({sizes}), "
        f"{coded:,} of {counted(len(field), 'Gaussian')} coded, built in {seconds:.0f} s"
    )
    record: dict[str, Any] = {"field": out, **({"extraction": extraction} if extraction else {})}
    if sums is not None:
        console.say(
            f"{sums}: {stored_bytes(sums) / 1e6:.1f} MB of region sums, {counted(len(view_files(sums)), 'view')}"
        )
        record |= {"sums": sums, "sums_bytes": stored_bytes(sums)}
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
