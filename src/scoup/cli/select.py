"""scoup select: the Gaussians that answer a text, as a splat."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from scoup.cli.asking import AsksText, not_there
from scoup.cli.console import Console
from scoup.cli.options import Flag, OptionalNumber, Texts, common_last

if TYPE_CHECKING:
    from torch import Tensor

    from scoup.field.language_field import LanguageField
    from scoup.io import PlyTable


@common_last
@dataclass(frozen=True, kw_only=True)
class Select(AsksText):
    """Write the Gaussians that answer a text as a 3DGS PLY: those chosen, the rest, or all with an id column.

    Gaussians are judged by their own codes, without rendering. Where the field's geometry is a PLY, its rows are
    copied byte for byte.
    """

    texts: Texts
    """What to look for, for example "kettle"; of several texts, a Gaussian that answers any is chosen."""
    out: Path
    """The PLY to write."""
    write: Literal["chosen", "rest", "ids"] = "chosen"
    """chosen: those found. rest: all others. ids: all, with a property `selected`: number of text, or 0."""
    threshold: float = 0.6
    """A Gaussian is chosen above this, 0 to 1, once relevancy is rescaled over the scene."""
    absolute: Flag = False
    """Put the threshold on the relevancy itself, where 0.5 is a draw with the canonical phrases and everyday words."""
    presence: OptionalNumber = None
    """A text is in the scene if what was found lies this many standard deviations nearer to it than to everyday words;
    otherwise nothing is chosen for it. Default: 2, where the table of --text has 16 words or more."""
    always: Flag = False
    """Choose something whatever is asked, unless the threshold is absolute."""
    neighbours: int = 0
    """Blend each half and half with the mean of so many nearest neighbours: 10 is usual, 0 is off."""

    def run(self, console: Console) -> None:
        """Choose and write."""
        import torch

        from scoup.base.errors import InputError
        from scoup.io import check_output, write_ply_table
        from scoup.models.words import with_everyday
        from scoup.query.answers import select_with_level
        from scoup.query.presence import PRESENT_FROM, scene_standing

        if not self.texts:
            raise InputError('name at least one text to look for, for example "kettle"')
        if not 0 <= self.threshold <= 1:
            raise InputError(f"--threshold must be 0 to 1, got {self.threshold}")
        if self.neighbours < 0:
            raise InputError(f"--neighbours must be 0 or more, got {self.neighbours}")
        if self.out.suffix.lower() != ".ply":
            raise InputError(f"{self.out}: selections are written as PLY; give a name that ends in .ply")
        check_output(self.out, self.overwrite)
        field = self.open_field()
        for geometry in (self.gaussians, field.geometry_path):
            if (
                geometry is not None
                and self.out.exists()
                and geometry.exists()
                and self.out.samefile(geometry)
            ):
                raise InputError(
                    f"{self.out}: is the splat the field was built on; give another name with --out"
                )
        vectors = self.encode(field, self.texts)
        canonical = with_everyday(vectors.canonical, vectors.everyday)
        selections = list(
            select_with_level(
                field, vectors.queries, canonical, self.threshold, self.neighbours or None, not self.absolute
            )
        )
        found = torch.stack([chosen for chosen, _, _ in selections])
        absent: list[str] = []
        words = None if self.always else vectors.standing_words(self.presence is not None)
        if words is not None:
            standings = scene_standing(field, selections, vectors.queries, words)
            bound = PRESENT_FROM if self.presence is None else self.presence
            found = found & (standings >= bound).to(found.device)[:, None]
            absent = [
                f"{text}: {not_there('scene', standing, bound)}"
                for text, standing in zip(self.texts, standings.tolist(), strict=True)
                if standing < bound
            ]
            for told in absent:
                console.say(told)
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
                advice = "try a lower --threshold" if self.write == "chosen" else "try a higher --threshold"
                if absent and self.write == "chosen":
                    advice = f"{'; '.join(absent)}; --always chooses something all the same"
                raise InputError(
                    f"{self.out}: nothing to write, {int(chosen.sum())} of {len(chosen)} Gaussians answer; {advice}"
                )
            table = table.select(wanted.numpy())
        write_ply_table(table, self.out, self.overwrite)
        for text, count in counts.items():
            console.say(f"{text}: {count:,} of {len(field):,} Gaussians")
        console.say(f"{self.out}: {len(table):,} Gaussians written")
        console.result({"out": self.out, "written": len(table), "chosen": counts, "gaussians": len(field)})

    def _table(self, field: LanguageField) -> tuple[PlyTable, Tensor]:
        """Rows to write from, and which of them [M] are the field's Gaussians, in order."""
        import torch

        from scoup.base.errors import InputError
        from scoup.io import find_gaussians, gaussians_from_table, read_ply_table
        from scoup.io.splats.ply import table_from_gaussians

        path = self.gaussians or field.geometry_path
        try:
            path = None if path is None else find_gaussians(path)
            if path is not None and path.suffix.lower() == ".ply":
                table = read_ply_table(path)
                gaussians, kept = gaussians_from_table(table)
                if gaussians.fingerprint() == field.info.fingerprint:
                    return table, torch.from_numpy(kept)
        except InputError:
            pass  # compressed, so its rows do not stand alone; or gone, and the field has its geometry embedded
        return table_from_gaussians(field.gaussians.to("cpu")), torch.ones(len(field), dtype=torch.bool)
