"""scoup merge: from shards to a language field."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import tyro

from scoup.base.counts import counted
from scoup.cli.build_options import BuildOptions, check_field_name, check_field_output, report_field
from scoup.cli.console import Console
from scoup.cli.options import Flag, OptionalPath, OptionGroups

if TYPE_CHECKING:
    from scoup.base.locks import Output
    from scoup.field.language_field import LanguageField
    from scoup.uplift.region_sums import RegionSums


@dataclass(frozen=True, kw_only=True)
class Merge(BuildOptions):
    """Make a language field from shards written by scoup build --shard.

    All shards of a scene give the field that scoup build makes in one process, byte for byte; some of them, the field
    of their views. Nothing is rasterised; photographs and region features are not needed.
    """

    option_groups: ClassVar[OptionGroups] = {"scene": "gaussians", "output": "out keep_sums"}

    shards: Annotated[
        tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="SHARD ...", help_behavior_hint="")
    ]
    """The shards, in any order: kitchen.scoup.*-of-4.sums."""
    gaussians: OptionalPath = None
    """The splat, if it has moved. Default: its path when the shards were made."""
    out: OptionalPath = None
    """The field to write, a .scoup file. Default: named after the shards, beside the first."""
    keep_sums: Flag = False
    """Also write the region sums of all shards to <out>.sums, as scoup build does."""

    def run(self, console: Console) -> None:
        """Merge, save and report."""
        from scoup.base.errors import InputError
        from scoup.base.locks import locked_output
        from scoup.base.shares import Share

        if not Share.of_environment().is_everything:
            raise InputError("scoup merge works in one process; run it without torchrun")
        out = self._output()
        self.settings("inria")  # a mistake shows now; the rasteriser preset is that of the shards
        started = time.perf_counter()
        with locked_output(out, self.overwrite) as output:
            found = save_merged(
                console, self, output, self.shards, self.device, self.keep_sums, self.gaussians
            )
        console.say(f"{counted(len(self.shards), 'shard')} merged")
        seconds = time.perf_counter() - started
        report_field(console, found.field, out, found.bytes_of_sums, self.device, seconds)

    def _output(self) -> Path:
        """The file to write, after checking that it and what goes beside it may be written."""
        from scoup.base.errors import InputError

        if not self.shards:
            raise InputError("name the shards to merge, as scoup build --shard writes them")
        out = self.out
        if out is None:
            found = re.fullmatch(r"(.+\.scoup)\.\d+-of-\d+\.sums", self.shards[0].name)
            if found is None:
                raise InputError(f"{self.shards[0]}: its name does not say which field it is of; pass --out")
            out = self.shards[0].with_name(found[1])
        check_field_name(out)
        check_field_output(out, self.overwrite, self.keep_sums)
        return out


@dataclass(frozen=True, eq=False)
class Merged:
    """A field of shards, and the bytes of its region sums where they are kept."""

    field: LanguageField
    bytes_of_sums: int | None


def save_merged(
    console: Console,
    options: BuildOptions,
    output: Output,
    paths: Sequence[Path],
    device: str,
    keep_sums: bool,
    geometry: Path | None,
) -> Merged:
    """Merge shards and write the field of an output, and its region sums if they are to be kept."""
    from scoup.uplift.checkpoint import save_field
    from scoup.uplift.region_sums import RegionSums
    from scoup.uplift.shards import merge

    shards = [RegionSums.open(path) for path in paths]
    with _kept(output.path, shards, keep_sums) as keep, console.progress() as progress:
        field = merge(
            shards, options.settings("inria"), keep=keep, geometry_path=geometry, device=device,
            progress=progress,
        )  # fmt: skip
        bytes_of_sums = None if keep is None else keep.bytes
        save_field(output, field, keep, True, options.embed_geometry, options.weight_bits)
    return Merged(field, bytes_of_sums)


@contextmanager
def _kept(out: Path, shards: list[RegionSums], wanted: bool) -> Iterator[RegionSums | None]:
    """New region sums in a folder beside the field; None where none are to be kept."""
    from scoup.uplift.checkpoint import new_sums
    from scoup.uplift.region_sums import RegionSums

    if not wanted:
        yield None
        return
    with new_sums(out) as path:
        yield RegionSums.empty_like(shards[0], path)
