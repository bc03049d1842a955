"""Options of verbs that make a field: how embeddings are coded, how views vote, and what is written."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from scoup.base.counts import counted
from scoup.cli.console import Console
from scoup.cli.options import Flag, OptionalInteger, OptionalNumber, OptionalText, OptionGroups, WritesCommon

if TYPE_CHECKING:
    from scoup.field.language_field import LanguageField
    from scoup.uplift.build_settings import BuildSettings


@dataclass(frozen=True, kw_only=True)
class BuildOptions(WritesCommon):
    """What a field is made like."""

    option_groups: ClassVar[OptionGroups] = {
        "coding": "n_atoms k solver effort epochs tolerance",
        "vote": "keep rounds",
        "output": "weight_bits embed_geometry",
    }

    preset: Literal["default", "paper"] = "default"
    """default answers best (128 atoms, exact coding, two rounds of the vote); paper is the method as
    published (64 atoms, Adam, one round). Options of coding and vote, where given, override it."""
    n_atoms: OptionalInteger = None
    """Atoms in the codebook of each level (L). Default: the preset's."""
    k: OptionalInteger = None
    """Atoms in the code of a region (K). Default: the preset's."""
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
    weight_bits: Literal[8, 16] = 16
    """Bits of a stored code weight."""
    embed_geometry: Flag = False
    """Put the Gaussians into the field's file, so that it stands alone."""

    def settings(self, raster_preset: str) -> BuildSettings:
        """The preset with the options given."""
        from scoup.uplift.build_settings import build_settings

        names = ("n_atoms", "k", "keep", "rounds", "solver", "effort", "epochs", "tolerance", "seed")
        return build_settings(
            self.preset,
            **{name: getattr(self, name) for name in names},
            raster_preset=raster_preset,
        )

    def given(self) -> list[str]:
        """The options above that are not as by default, as they stand on the command line."""
        own = BuildOptions.__annotations__.keys() - {"option_groups"}
        return [
            "--" + field.name.replace("_", "-")
            for field in fields(self)
            if field.name in own and getattr(self, field.name) != field.default
        ]


def report_field(
    console: Console,
    field: LanguageField,
    out: Path,
    bytes_of_sums: int | None,
    device: str,
    seconds: float,
) -> None:
    """Say what was built; ``bytes_of_sums`` where they are kept."""
    from scoup.field.part_sizes import part_sizes
    from scoup.uplift.storage.paths import sums_path

    coding, views = field.info.provenance["coding"], len(field.info.provenance["views"])
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
