"""scoup transfer: the codes of a field on an edited splat."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import tyro

from scoup.base.counts import counted
from scoup.base.errors import InputError
from scoup.cli.build_options import check_field_output
from scoup.cli.console import Console
from scoup.cli.options import OptionalPath, OptionGroups, arg
from scoup.cli.query_options import FieldOptions


@dataclass(frozen=True, kw_only=True)
class Transfer(FieldOptions):
    """Carry the codes of a field over to its splat after an edit: Gaussians deleted, added, reordered or rounded.

    Each Gaussian of the edited splat gets the codes of the nearest Gaussian of the field that it lies in. No view is
    rasterised. To let all views vote again, build a field of the edited splat.
    """

    option_groups: ClassVar[OptionGroups] = {"output": "out weight_bits"}

    splat: Annotated[tyro.conf.Positional[Path], arg(metavar="SPLAT")]
    """The edited splat, in the frame of the field's own."""
    out: OptionalPath = None
    """The field to write. Default: <name of SPLAT>.scoup here."""
    weight_bits: Literal[8, 16] = 16
    """Bits of a stored code weight."""

    def run(self, console: Console) -> None:
        """Transfer, save and report."""
        from scoup.io import load_gaussians
        from scoup.uplift.transfer import transfer

        out = self.out or Path(f"{self.splat.stem}.scoup")
        check_field_output(out, self.overwrite)
        field, gaussians = self.open_field(), load_gaussians(self.splat)
        if gaussians.fingerprint() == field.fingerprint:
            raise InputError(f"nothing to do: {self.splat} is the splat of {self.field} already")
        embed = field.geometry_path is None
        made = transfer(field, gaussians, geometry_path=None if embed else self.splat)
        made.save(out, self.overwrite, embed, self.weight_bits)
        record = made.info.provenance["transferred"]
        console.say(
            f"{out}: {counted(record['coded'], 'Gaussian')} got codes, {record['not_coded']:,} lie in no Gaussian of "
            f"{self.field} and have none"
        )
        console.result({"field": out, "coded": record["coded"], "not_coded": record["not_coded"]})
