"""scoup select: the Gaussians that answer a text, as a splat."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Literal

from scoup.base.counts import counted
from scoup.cli.console import Console
from scoup.cli.options import Flag, OptionalNumber, OptionalText, OptionGroups, Texts
from scoup.cli.query_options import TextOptions, absence_message, check_texts

if TYPE_CHECKING:
    from scoup.field.language_field import LanguageField
    from scoup.query.answer import SceneAnswer


@dataclass(frozen=True, kw_only=True)
class Select(TextOptions):
    """Write the Gaussians that answer a text, or all others: as a 3DGS PLY, or as a field that can be queried again.

    Gaussians are judged by their own codes, without rendering. Where the field's geometry is a PLY, its rows are
    copied byte for byte. A field has its Gaussians in its file: `--write rest --out without.scoup` removes a thing.
    """

    option_groups: ClassVar[OptionGroups] = {
        "choice": "threshold absolute level presence always neighbours",
        "output": "out write",
    }

    texts: Texts
    """What to look for, for example "kettle"; of several texts, a Gaussian that answers any is chosen."""
    out: Path
    """The PLY or .scoup to write."""
    write: Literal["chosen", "rest", "ids"] = "chosen"
    """chosen: those found. rest: all others. ids: all, with a property `selected`: number of text, or 0 (PLY only)."""
    threshold: OptionalNumber = None
    """A Gaussian is chosen above this, 0 to 1, once relevancy is rescaled over the scene. Default: where the answer
    changes least; 0.6 with --absolute."""
    absolute: Flag = False
    """Put the threshold on the relevancy itself, where 0.5 is a draw with the canonical phrases and everyday words."""
    level: OptionalText = None
    """The level that answers: s (fine), m or l (coarse). Default: the one that fits best, for each text."""
    presence: OptionalNumber = None
    """A text is in the scene if its z-score is at least this: how many standard deviations what was found lies nearer
    to it than to everyday words. Otherwise nothing is chosen for it. Default: 1.5, where the table of --text has 16
    words or more."""
    always: Flag = False
    """Choose something for any text, unless the threshold is absolute."""
    neighbours: int = 0
    """Blend the relevancy of each Gaussian half and half with the mean of so many nearest neighbours: 10 is usual, 0 is
    off."""

    def run(self, console: Console) -> None:
        """Choose and write."""
        from scoup.query.answering import answer_scene
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
            self.level,
        )
        absent = [
            f"{text}: {absence_message('scene', answer.z_score, present_from)}"
            for text, answer in zip(self.texts, answers, strict=True)
            if not answer.presence
        ]
        for message in absent:
            console.say(message)
        written = self._write(field, answers, absent)
        counts = {text: int(answer.mask.sum()) for text, answer in zip(self.texts, answers, strict=True)}
        thresholds = {
            text: answer.record()["threshold"] for text, answer in zip(self.texts, answers, strict=True)
        }
        for text, count in counts.items():
            console.say(f"{text}: {count:,} of {counted(len(field), 'Gaussian')}")
        console.say(f"{self.out}: {counted(written, 'Gaussian')} written")
        result = {"out": self.out, "written": written, "chosen": counts, "thresholds": thresholds}
        console.result({**result, "gaussians": len(field)})

    def _check_options(self) -> None:
        from scoup.base.errors import InputError
        from scoup.io import check_output

        check_texts(self.texts)
        if self.threshold is not None and not 0 <= self.threshold <= 1:
            raise InputError(f"--threshold must be 0 to 1, got {self.threshold}")
        if self.neighbours < 0:
            raise InputError(f"--neighbours must be 0 or more, got {self.neighbours}")
        suffix = self.out.suffix.lower()
        if suffix not in (".ply", ".scoup"):
            raise InputError(f"{self.out}: give a name that ends in .ply (a splat) or .scoup (a field)")
        if suffix == ".scoup" and self.write == "ids":
            raise InputError(f"{self.out}: a field has no column of ids; give a name that ends in .ply")
        check_output(self.out, self.overwrite)

    def _check_out(self, field: LanguageField) -> None:
        """Refuse to replace the field itself, or its own splat."""
        from scoup.base.errors import InputError

        for what, source in (
            ("splat the field was built on", self.gaussians),
            ("splat the field was built on", field.geometry_path),
            ("field that is queried", self.field),
        ):
            if source and self.out.exists() and source.exists() and self.out.samefile(source):
                raise InputError(f"{self.out}: is the {what}; give another name with --out")

    def _write(self, field: LanguageField, answers: list[SceneAnswer], absent: list[str]) -> int:
        """Write the file; returns the number of Gaussians in it.

        Raises:
            InputError: there would be none.
        """
        import torch

        from scoup.base.errors import InputError
        from scoup.io import write_ply_table
        from scoup.query.splat_table import SplatTable

        masks = [answer.mask for answer in answers]
        if self.write == "ids":
            table = SplatTable.of(field, self.gaussians).with_ids(masks)
            write_ply_table(table, self.out, self.overwrite)
            return len(table)
        chosen = torch.stack(masks).any(0)
        wanted = chosen if self.write == "chosen" else ~chosen
        if not wanted.any():
            advice = "try a lower --threshold" if self.write == "chosen" else "try a higher --threshold"
            if absent and self.write == "chosen":
                advice = f"{'; '.join(absent)}; --always chooses something all the same"
            raise InputError(
                f"{self.out}: nothing to write, {int(chosen.sum()):,} of {counted(len(chosen), 'Gaussian')} answer; "
                f"{advice}"
            )
        if self.out.suffix.lower() == ".scoup":
            field.select(wanted).save(self.out, self.overwrite)
        else:
            write_ply_table(SplatTable.of(field, self.gaussians).select(wanted), self.out, self.overwrite)
        return int(wanted.sum())
