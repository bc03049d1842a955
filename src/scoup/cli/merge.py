"""scoup merge: from shards to a language field."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import tyro

from scoup.base.counts import counted
from scoup.cli.build_options import BuildOptions, report_field
from scoup.cli.console import Console
from scoup.cli.options import Flag, OptionalPath, OptionGroups

if TYPE_CHECKING:
    from scoup.base.processes import Processes
    from scoup.uplift.region_sums import RegionSums


@dataclass(frozen=True, kw_only=True)
class Merge(BuildOptions):
    """Make a language field from shards, as scoup build --shard has left them.

    Of all shards of a scene this is the field that scoup build makes in one process, byte for byte; of some of them,
    the field of their views. Nothing is rasterised, and neither photographs nor region features are needed.
    """

    option_groups: ClassVar[OptionGroups] = {"scene": "gaussians", "output": "out keep_sums"}

    shards: Annotated[
        tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="SHARD ...", help_behavior_hint="")
    ]
    """The shards, in any order: kitchen.scoup.*-of-4.sums."""
    gaussians: OptionalPath = None
    """Where the splat is now. Default: where it was when the shards were made."""
    out: OptionalPath = None
    """The field to write, a .scoup file. Default: that of the shards, beside the first of them."""
    keep_sums: Flag = False
    """Also keep the region sums of all shards together, in <out>.sums, as scoup build does."""

    def run(self, console: Console) -> None:
        """Merge, save and report."""
        from scoup.base.locks import locked_file
        from scoup.base.processes import device_of_process, process_group
        from scoup.uplift.checkpoint import moved_with_sums
        from scoup.uplift.shards import merge

        device, out = device_of_process(self.device), self._output()
        settings = self.settings("inria")  # a mistake shows now; the rasteriser preset is that of the shards
        started = time.perf_counter()
        with (
            process_group(device) as processes,
            locked_file(out, self.overwrite, processes) as lock,
            _opened(self.shards) as shards,
            self._kept(out, shards, processes) as keep,
            console.progress() as progress,
        ):
            field = merge(
                shards, settings, keep=keep, geometry_path=self.gaussians, field_path=out,
                device=device, progress=progress,
            )  # fmt: skip
            bytes_of_sums = None if keep is None else keep.bytes
            # Field and sums appear together.
            move = os.replace if keep is None else moved_with_sums(lock, keep, keep=True)
            how = (self.overwrite, self.embed_geometry, self.weight_bits, move)
            processes.of_first(lambda: field.save(out, *how))
        if processes.first:
            console.say(f"{counted(len(self.shards), 'shard')} merged")
            report_field(console, field, out, bytes_of_sums, device, time.perf_counter() - started)

    def _output(self) -> Path:
        """The file to write, after checking that it and what goes beside it may be written."""
        from scoup.base.errors import InputError
        from scoup.base.locks import complete
        from scoup.io import check_output
        from scoup.uplift.region_sums import sums_path

        if not self.shards:
            raise InputError("name the shards to merge, as scoup build --shard has left them")
        out = self.out
        if out is None:
            found = re.fullmatch(r"(.+\.scoup)\.\d+-of-\d+\.sums", self.shards[0].name)
            if found is None:
                raise InputError(f"{self.shards[0]}: its name does not say which field it is of; give --out")
            out = self.shards[0].with_name(found[1])
        if out.suffix.lower() != ".scoup":
            raise InputError(f"{out}: give a name that ends in .scoup")
        complete(out)
        check_output(out, self.overwrite)
        if self.keep_sums:
            check_output(sums_path(out), self.overwrite)
        return out

    @contextmanager
    def _kept(self, out: Path, shards: list[RegionSums], processes: Processes) -> Iterator[RegionSums | None]:
        """New region sums in a file beside the field; None where none are to be kept."""
        from scoup.base.errors import InputError
        from scoup.uplift.checkpoint import new_sums
        from scoup.uplift.region_sums import RegionSums

        if not self.keep_sums:
            yield None
            return
        if processes.world > 1:
            raise InputError("--keep-sums works in one process; run without torchrun")
        with new_sums(out, "merge") as path, closing(RegionSums.like(shards[0], path)) as keep:
            yield keep


@contextmanager
def _opened(paths: tuple[Path, ...]) -> Iterator[list[RegionSums]]:
    from scoup.uplift.region_sums import RegionSums

    with ExitStack() as stack:
        yield [stack.enter_context(closing(RegionSums.open(path))) for path in paths]
