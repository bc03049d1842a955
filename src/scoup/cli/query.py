"""scoup query: where is it? Heat maps, masks and boxes in the views of a field."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from scoup.base.counts import counted
from scoup.base.staging import check_outputs, staged
from scoup.cli.console import Console
from scoup.cli.names import check_folder, unique_slugs
from scoup.cli.options import (
    Flag,
    OptionalNumber,
    OptionalPath,
    OptionalText,
    OptionGroups,
    Texts,
)
from scoup.cli.query_options import (
    CameraOptions,
    TextOptions,
    absence_message,
    check_texts,
)

if TYPE_CHECKING:
    from torch import Tensor

    from scoup.field.language_field import LanguageField
    from scoup.query.answer import Answer
    from scoup.query.answer_sheet import AnswerSheets
    from scoup.raster import Projection
    from scoup.scene.cameras import Camera

RECORD = "query.json"
PICTURES = ("heat", "mask", "overlay")


@dataclass(frozen=True, kw_only=True)
class Query(TextOptions, CameraOptions):
    """Find things in the views of a field's cameras.

    Writes a contact sheet of all answers: the relevancy as a heat map over the colour render, the outline of the mask,
    its box and the pixel that fits best. One query.json holds level, score, pixel, coverage and box of every answer.
    """

    option_groups: ClassVar[OptionGroups] = {
        "answer": "rule threshold level presence always",
        "output": "out pictures",
    }

    texts: Texts
    """What to look for, for example "kettle" "wooden table"."""
    out: OptionalPath = None
    """Folder for the pictures and query.json. Default: <name of FIELD>_queries here."""
    rule: Literal["default", "scoup", "langsplatv2", "langsplat"] = "default"
    """What turns relevancy into masks and points: sides of the boxes that smooth, threshold, choice of the level.
    scoup, langsplatv2 and langsplat are those systems' rules for LERF-OVS; default takes the boxes of scoup, the
    threshold at which the answer changes least and the level whose mask is relevant, stable and whole, and compares
    with everyday words, too."""
    threshold: OptionalNumber = None
    """A pixel is in the mask above this, 0 to 1, once relevancy is rescaled over the view. Default: the rule's; of
    the rule default, where the answer changes least."""
    level: OptionalText = None
    """The level that answers: s (fine), m or l (coarse). Default: as the rule chooses, for each text."""
    presence: OptionalNumber = None
    """A text is in a view if its z-score is at least this: how many standard deviations what was found lies nearer to
    it than to everyday words. Otherwise it gets an empty mask and no point there. Default: 1.5 with the rule default,
    where the table of --text has 16 words or more; the systems' rules find something always."""
    always: Flag = False
    """Find something in every view, for any text."""
    pictures: Literal["sheet", "all", "none"] = "sheet"
    """sheet: one contact sheet, sheet.png, with a row for each view and a column for each text (of one text, views
    beside each other); of more than 12 views those of the best answers, the texts choosing in turn; more than 6 texts
    take several sheets. all: also heat map, mask and overlay of each answer, as files of their own. none: query.json
    only."""

    def run(self, console: Console) -> None:
        """Answer every text in every view asked for."""
        import json

        from scoup.io import write_text
        from scoup.query.answer_sheet import AnswerSheets
        from scoup.query.answering import answer_view
        from scoup.query.presence import compared
        from scoup.query.presets import query_preset
        from scoup.raster import render_colors

        check_texts(self.texts)
        preset = query_preset(self.rule, threshold=self.threshold)
        out = self.out or Path(f"{self.field.stem}_queries")
        check_folder(out)
        check_outputs(out, [RECORD], self.overwrite)
        field = self.open_field()
        cameras = self.open_cameras(field)
        texts, present_from = compared(self.encode(field, self.texts), preset, self.presence, self.always)
        folders = unique_slugs(camera.stem for camera in cameras)
        sheets = AnswerSheets(self.texts, len(cameras))
        files = self._files(folders, len(sheets))
        records: list[dict[str, Any]] = []
        blind: list[Camera] = []
        with staged(out, files, self.overwrite) as hidden, console.progress() as progress:
            progress("query", 0, len(cameras))
            for done, (camera, folder) in enumerate(zip(cameras, folders, strict=True), start=1):
                projection = field.project(camera)
                answers = answer_view(field, camera, texts, preset, present_from, projection, self.level)
                if _sees_nothing(field, projection, answers):
                    blind.append(camera)
                if self.pictures != "none":
                    rgb = render_colors(field.gaussians, camera, projection).cpu()
                    self._draw(camera, answers, rgb, sheets, hidden / folder)
                records += self._records(camera, answers, out / folder)
                progress("query", done, len(cameras))
            self.check_seen(blind, len(cameras))
            result = {**self._write_sheets(sheets, hidden, out), "answers": records}
            write_text(hidden / RECORD, json.dumps({"field": str(self.field), **result}, indent=2))
        _report(console, out, result, present_from)

    def _files(self, folders: list[str], sheets: int) -> list[str]:
        """All that is written, within the output's folder."""
        names = [name for of_text in self._picture_names() for name in of_text.values()]
        singles = [f"{folder}/{name}" for folder in folders for name in names]
        return [RECORD, *([] if self.pictures == "none" else _sheet_names(sheets)), *singles]

    def _write_sheets(self, sheets: AnswerSheets, hidden: Path, out: Path) -> dict[str, Any]:
        """Write the sheets, if they are wanted; where they will be, for the record."""
        from scoup.io import save_png

        names = [] if self.pictures == "none" else _sheet_names(len(sheets))
        for name, sheet in zip(names, sheets.pictures() if names else [], strict=True):
            save_png(sheet, hidden / name)
        return {"sheets": [(out / name).as_posix() for name in names]}

    def _picture_names(self) -> list[dict[str, str]]:
        """File names of each text's pictures by their kind; none if only the sheet is wanted."""
        kinds = PICTURES if self.pictures == "all" else ()
        return [{kind: f"{name}_{kind}.png" for kind in kinds} for name in unique_slugs(self.texts)]

    def _records(self, camera: Camera, answers: list[Answer], folder: Path) -> list[dict[str, Any]]:
        """The answers of one view as JSON values."""
        records = []
        for text, answer, names in zip(self.texts, answers, self._picture_names(), strict=True):
            record = {"camera": camera.name, "text": text, **answer.record()}
            if names:
                record["files"] = {kind: (folder / name).as_posix() for kind, name in names.items()}
            records.append(record)
        return records

    def _draw(
        self, camera: Camera, answers: list[Answer], rgb: Tensor, sheets: AnswerSheets, folder: Path
    ) -> None:
        """Add a view to the sheets, and write its single pictures if they are wanted."""
        from scoup.io import save_png

        sheets.add(camera.name, answers, rgb)
        for answer, names in zip(answers, self._picture_names(), strict=True):
            drawn = answer.pictures(rgb) if names else {}
            for kind, name in names.items():
                save_png(drawn[kind], folder / name)


def _report(console: Console, out: Path, result: dict[str, Any], present_from: float | None) -> None:
    """Say what was found, and where it is written."""
    for record in result["answers"]:
        console.say(_sentence(record, present_from))
    for sheet in result["sheets"]:
        console.say(f"{sheet}: the answers as pictures")
    console.say(f"{out / RECORD}: {counted(len(result['answers']), 'answer')}")
    console.result({"out": out, **result})


def _sheet_names(count: int) -> list[str]:
    return ["sheet.png"] if count == 1 else [f"sheet_{number}.png" for number in range(1, count + 1)]


def _sees_nothing(field: LanguageField, projection: Projection, answers: list[Answer]) -> bool:
    """Whether nothing of the field is visible."""
    # Relevancy is 0.5 wherever nothing is rendered; only then is it worth a render to find out.
    return all((each.heat == 0.5).all() for each in answers) and not field.is_visible(projection)


def _sentence(record: dict[str, Any], present_from: float | None) -> str:
    """An answer in words."""
    start = f"{record['camera']}  {record['text']}:"
    if not record.get("present", True):
        return f"{start} {absence_message('view', record['z_score'], present_from)}"
    box = "no pixel" if record["box"] is None else f"box {record['box']}"
    return (
        f"{start} score {record['score']:.2f} at level {record['level']}, pixel {record['pixel']}, {box}, "
        f"{record['coverage']:.1%} of the view"
    )
