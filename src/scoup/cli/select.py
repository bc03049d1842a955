"""scoup select: the Gaussians that answer a text, as a splat."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from scoup.cli.console import Console
from scoup.cli.options import Flag, OptionalNumber, Texts, common_last
from scoup.cli.query_options import TextOptions, absence_message, check_texts

if TYPE_CHECKING:
    from scoup.field.language_field import LanguageField
    from scoup.io import PlyTable
    from scoup.query.answer import SceneAnswer


@common_last
@dataclass(frozen=True, kw_only=True)
class Select(TextOptions):
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
    """A text is in the scene if its z-score is at least this: how many standard deviations what was found lies nearer
    to it than to everyday words. Otherwise nothing is chosen for it. Default: 2, where the table of --text has 16 words
    or more."""
    always: Flag = False
    """Choose something for any text, unless the threshold is absolute."""
    neighbours: int = 0
    """Blend each half and half with the mean of so many nearest neighbours: 10 is usual, 0 is off."""

    def run(self, console: Console) -> None:
        """Choose and write."""
        from scoup.io import write_ply_table
        from scoup.query.answer import answer_scene
        from scoup.query.presence import presence_threshold

        self._check_options()
        field = self.open_field()
        self._check_out(field)
        texts = self.encode(field, self.texts)
        present_from = None if self.always else presence_threshold(texts, self.presence)
        answers = answer_scene(
            field,
            texts.with_everyday(),
            self.threshold,
            self.neighbours or None,
            not self.absolute,
            present_from,
        )
        absent = [
            f"{text}: {absence_message('scene', answer.z_score, present_from)}"
            for text, answer in zip(self.texts, answers, strict=True)
            if not answer.presence
        ]
        for message in absent:
            console.say(message)
        table = self._table(field, answers, absent)
        write_ply_table(table, self.out, self.overwrite)
        counts = {text: int(answer.mask.sum()) for text, answer in zip(self.texts, answers, strict=True)}
        for text, count in counts.items():
            console.say(f"{text}: {count:,} of {len(field):,} Gaussians")
        console.say(f"{self.out}: {len(table):,} Gaussians written")
        console.result({"out": self.out, "written": len(table), "chosen": counts, "gaussians": len(field)})

    def _check_options(self) -> None:
        from scoup.base.errors import InputError
        from scoup.io import check_output

        check_texts(self.texts)
        if not 0 <= self.threshold <= 1:
            raise InputError(f"--threshold must be 0 to 1, got {self.threshold}")
        if self.neighbours < 0:
            raise InputError(f"--neighbours must be 0 or more, got {self.neighbours}")
        if self.out.suffix.lower() != ".ply":
            raise InputError(f"{self.out}: selections are written as PLY; give a name that ends in .ply")
        check_output(self.out, self.overwrite)

    def _check_out(self, field: LanguageField) -> None:
        """Refuse to replace the field's own splat."""
        from scoup.base.errors import InputError

        for geometry in (self.gaussians, field.geometry_path):
            if geometry and self.out.exists() and geometry.exists() and self.out.samefile(geometry):
                raise InputError(
                    f"{self.out}: is the splat the field was built on; give another name with --out"
                )

    def _table(self, field: LanguageField, answers: list[SceneAnswer], absent: list[str]) -> PlyTable:
        """The rows to write.

        Raises:
            InputError: there are none.
        """
        import torch

        from scoup.base.errors import InputError
        from scoup.query.splat_table import SplatTable

        masks = [answer.mask for answer in answers]
        rows = SplatTable.of(field, self.gaussians)
        if self.write == "ids":
            return rows.with_ids(masks)
        chosen = torch.stack(masks).any(0)
        table = rows.select(chosen if self.write == "chosen" else ~chosen)
        if not len(table):
            advice = "try a lower --threshold" if self.write == "chosen" else "try a higher --threshold"
            if absent and self.write == "chosen":
                advice = f"{'; '.join(absent)}; --always chooses something all the same"
            raise InputError(
                f"{self.out}: nothing to write, {int(chosen.sum())} of {len(chosen)} Gaussians answer; {advice}"
            )
        return table
