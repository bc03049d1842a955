"""scoup select: the Gaussians that answer a text, as a splat."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import tyro

from scoup.cli.asking import AsksText
from scoup.cli.console import Console

if TYPE_CHECKING:
    from torch import Tensor

    from scoup.field import LanguageField
    from scoup.io import PlyTable


@dataclass(frozen=True, kw_only=True)
class Select(AsksText):
    """Write the Gaussians that answer a text as a 3DGS PLY: those chosen, the rest, or all with an id column.

    Gaussians are judged by their own codes, without rendering. Where the field's geometry is a PLY, its rows are
    copied byte for byte.
    """

    texts: tyro.conf.Positional[tuple[str, ...]]
    """What to look for; of several, a Gaussian that answers any is chosen."""
    out: Path
    """The PLY to write."""
    write: Literal["chosen", "rest", "ids"] = "chosen"
    """chosen: only the Gaussians found. rest: all others. ids: every Gaussian, with a property `selected` that is
    0, or the number of the last text (from 1) that it answers."""
    threshold: float = 0.6
    """A Gaussian is chosen above this, after relevancy is rescaled to 0..1 over the scene."""
    absolute: bool = False
    """Put the threshold on the relevancy itself (0.5 is a draw with the canonical phrases)."""
    neighbours: int = 0
    """Blend each Gaussian half and half with the mean of so many nearest neighbours (10 is usual; 0: do not)."""

    def run(self, console: Console) -> None:
        """Choose and write."""
        import torch

        from scoup.errors import InputError
        from scoup.io import check_output, write_ply_table
        from scoup.query import select

        check_output(self.out, self.overwrite)
        if self.out.suffix.lower() != ".ply":
            raise InputError(f"{self.out}: give a name that ends in .ply")
        if not self.texts:
            raise InputError("name at least one text to look for")
        field = self.open_field()
        queries, canonical = self.encode(field, self.texts)
        found = select(field, queries, canonical, self.threshold, self.neighbours or None, not self.absolute)
        chosen = found.any(0)
        counts = {text: int(row.sum()) for text, row in zip(self.texts, found, strict=True)}

        table, kept = self._table(field)
        ids = torch.zeros(len(kept), dtype=torch.int32)
        for number, row in enumerate(found, start=1):
            ids[kept] = torch.where(row, number, ids[kept])
        if self.write == "ids":
            table = table.with_column("selected", ids.numpy())
        else:
            wanted = torch.zeros(len(kept), dtype=torch.bool)
            wanted[kept] = chosen if self.write == "chosen" else ~chosen
            if not wanted.any():
                raise InputError(f"nothing to write: {int(chosen.sum())} of {len(chosen)} Gaussians were chosen")
            table = table.select(wanted.numpy())
        write_ply_table(table, self.out, self.overwrite)
        for text, count in counts.items():
            console.say(f"{text}: {count:,} of {len(field):,} Gaussians")
        console.say(f"{self.out}: {len(table):,} Gaussians written")
        console.result({"out": self.out, "written": len(table), "chosen": counts, "gaussians": len(field)})

    def _table(self, field: LanguageField) -> tuple[PlyTable, Tensor]:
        """Rows to write from, and which of them [M] are the field's Gaussians, in order."""
        import torch

        from scoup.errors import InputError
        from scoup.io import gaussians_from_table, read_ply_table
        from scoup.io.ply import table_from_gaussians

        path = self.gaussians or field.geometry_path
        if path is not None and path.suffix.lower() == ".ply" and path.is_file():
            table = read_ply_table(path)
            try:
                gaussians, kept = gaussians_from_table(table)
            except InputError:  # compressed: its rows do not stand alone
                gaussians, kept = None, None
            if kept is not None and gaussians.fingerprint() == field.info.fingerprint:
                return table, torch.from_numpy(kept)
        return table_from_gaussians(field.gaussians.to("cpu")), torch.ones(len(field), dtype=torch.bool)
