"""scoup transfer: the codes of a field on an edited splat."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from scoup.base import InputError, counted
from scoup.cli.build_options import check_field_output
from scoup.cli.console import Console
from scoup.cli.options import AllCommon, FieldFile, arg
from scoup.cli.query_options import FieldOptions


@dataclass(frozen=True, kw_only=True)
class Transfer:
    """Carry the codes of a field over to its splat after an edit: Gaussians deleted, added, reordered or rounded.

    Each Gaussian of the edited splat gets the codes of the nearest Gaussian of the field that it lies in. No view is
    rasterised. To let all views vote again, build a field of the edited splat.
    """

    field: FieldFile
    """The .scoup file."""
    splat: Annotated[tyro.conf.Positional[Path], arg(metavar="SPLAT")]
    """The edited splat, in the frame of the field's own."""
    out: Path | None = None
    """The field to write. Default: <name of SPLAT>.scoup here."""
    opening: Annotated[FieldOptions, arg(name="field")] = FieldOptions()
    common: AllCommon = AllCommon()

    def run(self, console: Console) -> None:
        from scoup.io import load_gaussians
        from scoup.uplift import transfer

        out = self.out or Path(f"{self.splat.stem}.scoup")
        check_field_output(out, self.common.overwrite)
        field, gaussians = self.opening.open(self.field, self.common.device), load_gaussians(self.splat)
        if gaussians.fingerprint() == field.fingerprint:
            raise InputError(f"nothing to do: {self.splat} is the splat of {self.field} already")
        embed = field.geometry_path is None
        made = transfer(field, gaussians, geometry_path=None if embed else self.splat)
        made.save(out, self.common.overwrite, embed)
        record = made.info.provenance["transferred"]
        console.say(
            f"{out}: {counted(record['coded'], 'Gaussian')} got codes, {record['not_coded']:,} lie in no Gaussian of "
            f"{self.field} and have none"
        )
        console.result({"field": out, "coded": record["coded"], "not_coded": record["not_coded"]})
