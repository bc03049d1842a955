"""Options of verbs that make a field: how embeddings are coded, how views vote, and what is written."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from scoup.base.counts import counted
from scoup.cli.console import Console
from scoup.cli.option_groups import borrow_options
from scoup.cli.options import Flag, OptionGroups, WritesCommon
from scoup.uplift.build_settings import BUILD_PRESETS, BuildSettings, build_settings

if TYPE_CHECKING:
    from scoup.field.language_field import LanguageField
    from scoup.uplift.region_sums import RegionSums


_SETTINGS = "n_atoms k keep rounds solver effort epochs tolerance seed scale"


@dataclass(frozen=True, kw_only=True)
@borrow_options(BUILD_PRESETS["default"], _SETTINGS, paper=BUILD_PRESETS["paper"])
class BuildOptions(WritesCommon):
    """Options of verbs that make a field."""

    option_groups: ClassVar[OptionGroups] = {
        "region sum": "scale",
        "coding": "n_atoms k solver effort epochs tolerance",
        "vote": "keep rounds",
        "output": "weight_bits embed_geometry",
    }

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


def check_field_name(out: Path) -> None:
    """Refuse a name that no field may have."""
    from scoup.base.errors import InputError

    if out.suffix.lower() != ".scoup":
        raise InputError(f"{out}: expected a name that ends in .scoup; choose another")


def report_field(
    console: Console,
    field: LanguageField,
    out: Path,
    sums: RegionSums | None,
    device: str,
    seconds: float,
    extraction: dict[str, Any] | None = None,
) -> None:
    """Report what was built; ``sums`` if they are kept, and the extraction if there was one."""
    from scoup.field.part_sizes import part_sizes

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
    if sums is not None and sums.path is not None:
        console.say(f"{sums.path}: {sums.bytes / 1e6:.1f} MB of region sums, {counted(len(sums), 'view')}")
        record |= {"sums": sums.path, "sums_bytes": sums.bytes}
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
