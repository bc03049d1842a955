"""scoup convert: splats, region features, and fields of other systems."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from scoup.base import FileFormatError, InputError, counted
from scoup.cli.build_options import check_field_output, with_frame_of
from scoup.cli.console import Console
from scoup.cli.options import WritesCommon, arg

if TYPE_CHECKING:
    from scoup.field import Field
    from scoup.io import Decoder

_ARRAYS = (".npy", ".pt")  # of features
_CHECKPOINTS = (".pth", ".ckpt")  # of LangSplat


@dataclass(frozen=True, kw_only=True)
class RegionOptions:
    """Options for region features."""

    bits: Literal[16, 32] = 16
    """Bits of a stored embedding number."""
    autoencoder: Path | None = None
    """LangSplat's best_ckpt.pth, which decodes language_features_dim3 and its checkpoints."""


@dataclass(frozen=True, kw_only=True)
class FeatureOptions:
    """Options for features of Gaussians."""

    gaussians: Path | None = None
    """The splat that the features belong to, in its order."""
    n_atoms: int = 128
    """Atoms of each codebook that features are coded by."""
    k: int = 4
    """Atoms of a Gaussian's code."""


@dataclass(frozen=True, kw_only=True)
class Convert:
    """Convert splats, region features or fields of other systems; the kinds of SOURCE and TARGET decide.

    A splat (a file, or a folder with one) becomes another, of the format that the ending of TARGET means, such as .ply,
    .compressed.ply, .spz, .glb or .usdz; docs/formats.md lists all.

    A folder of region features (or a scene), such as LangSplat's _s.npy and _f.npy, becomes one compact file per view.
    Labels are kept exactly; embeddings, too, with --bits 32. With --autoencoder, LangSplat's three numbers per region
    (language_features_dim3) become embeddings again. An array of features, one row per Gaussian (.npy or .pt, [N, D] or
    [N, levels, D]), becomes a field by sparse coding. A checkpoint of LangSplat (chkpnt30000.pth, with --autoencoder),
    LangSplatV2 or Occam's LGS becomes a field; for a folder NAME_1, those of NAME_2 and NAME_3 are read, too.
    """

    source: Annotated[tyro.conf.Positional[Path], arg(metavar="SOURCE")]
    """Splat, folder of region features, array of features, or checkpoint."""
    target: Annotated[tyro.conf.Positional[Path], arg(metavar="TARGET")]
    """Splat, folder or .scoup to write."""
    keep_axes: bool = False
    """Do not convert the axes of .spz, glTF and OpenUSD: for files of programs that keep the numbers of the PLY."""
    activated: bool = False
    """Read scales and opacities of a PLY or checkpoint as they are, not as logarithms and logits."""
    model: str | None = None
    """Id of the model that made the embeddings, or a word table. Default: the one that SOURCE names, if any."""
    regions: RegionOptions = RegionOptions()
    features: Annotated[FeatureOptions, arg(name="field")] = FeatureOptions()
    common: WritesCommon = WritesCommon()

    def run(self, console: Console) -> None:
        from scoup.io import is_splat_name

        suffix = self.source.suffix.lower()
        if is_splat_name(self.target, written=True):
            self._convert_splat(console)
        elif self.source.is_dir() or not self.source.exists():
            self._convert_regions(console)
        elif suffix in _ARRAYS + _CHECKPOINTS:
            self._convert_field(console)
        else:
            raise FileFormatError(
                self.source,
                "cannot be converted",
                "use a splat and the name of another, a folder of region features, features (.npy, .pt) or "
                "LangSplat's checkpoint (.pth)",
            )

    def _convert_splat(self, console: Console) -> None:
        from scoup.base import check_output
        from scoup.io import load_gaussians, save_gaussians

        check_output(self.target, overwrite=self.common.overwrite)
        if self.target.exists() and self.source.exists() and self.target.samefile(self.source):
            raise InputError(f"{self.target}: is the source; use another name")
        gaussians = load_gaussians(self.source, self.keep_axes, self.activated)
        save_gaussians(gaussians, self.target, self.common.overwrite, self.keep_axes)
        size = self.target.stat().st_size
        console.say(
            f"{self.target}: {counted(len(gaussians), 'Gaussian')}, SH degree {gaussians.sh_degree}, "
            f"{size / len(gaussians):.1f} bytes each"
        )
        console.result({"out": self.target, "gaussians": len(gaussians), "bytes": size})

    def _convert_regions(self, console: Console) -> None:
        from scoup.io import convert_regions

        decode = self._decoder()
        with console.progress() as progress:
            report = convert_regions(
                self.source,
                self.target,
                self.regions.bits,
                self.model,
                self.common.overwrite,
                progress,
                decode,
            )
        before, after = (size / report.views / 1e3 for size in (report.bytes_before, report.bytes_after))
        console.say(
            f"{report.target}: {counted(report.views, 'view')}, {after:,.0f} kB a view (they took {before:,.0f})"
        )
        console.result(
            {
                "out": report.target,
                "views": report.views,
                "bytes_before": report.bytes_before,
                "bytes_after": report.bytes_after,
            }
        )

    def _convert_field(self, console: Console) -> None:
        from scoup.uplift import foreign_field

        check_field_output(self.target, self.common.overwrite)
        options, is_array = self.features, self.source.suffix.lower() in _ARRAYS
        if is_array and options.gaussians is None:
            raise InputError(f"{self.source}: name the splat that the features belong to with --gaussians")
        with console.progress() as progress:
            field = foreign_field(
                self.source, options.gaussians, None if is_array else self._decoder(),
                read=lambda path: console.say(f"{path}: read"),
                n_atoms=options.n_atoms, k=options.k, **self._encoder(), progress=progress,
            )  # fmt: skip
        with_frame_of(self.target, field).save(self.target, self.common.overwrite)
        self._report(console, field)

    def _decoder(self) -> Decoder | None:
        from scoup.io import read_autoencoder

        return None if self.regions.autoencoder is None else read_autoencoder(self.regions.autoencoder)

    def _encoder(self) -> dict[str, Any]:
        """Return the model and the word table that the field will name."""
        from scoup.models import WordTable, check_model

        if self.model is None:
            return {}
        if not WordTable.is_meant(self.model):
            check_model(self.model)
            return {"embedding_model": self.model}
        return {"words": self.model}

    def _report(self, console: Console, field: Field) -> None:
        cosines = field.info.provenance.get("mean_cosine", {})
        levels = [
            f"{level} (mean cosine {cosines[level]:.3f})" if level in cosines else level
            for level in field.levels
        ]
        console.say(
            f"{self.target}: {counted(len(field), 'Gaussian')}, {counted(field.n_atoms, 'atom')}, "
            f"levels {', '.join(levels)}"
        )
        console.result({
            "out": self.target, "gaussians": len(field), "coded": int(field.coded().sum()),
            "levels": list(field.levels), "atoms": field.n_atoms, "mean_cosine": cosines,
        })  # fmt: skip
