"""scoup query: where is it? Heat maps, masks and boxes in the views of a field, and places in the world."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from scoup.base import as_json, check_output, counted, reported, staged
from scoup.cli.console import Console, detector_command
from scoup.cli.options import (
    AllCommon,
    FieldFile,
    Texts,
    arg,
)
from scoup.cli.query_options import (
    CameraOptions,
    FrameOptions,
    LevelOptions,
    TextOptions,
    check_texts,
    output_folder,
)

if TYPE_CHECKING:
    from scoup.query import (
        AnswerFiles,
        LanguageField,
        Place,
        Question,
    )
    from scoup.scene import Camera

RECORD = "query.json"


@dataclass(frozen=True, kw_only=True)
class DetectorOptions:
    """A model that looks for the texts."""

    refine: str | None = None
    """Look for the texts in photographs with a model, too: owlv2, owlv2-large, grounding-dino, grounding-dino-base,
    sam3, or a folder or hub id of such a model. The photographs are those of --scene, else those beside the splat;
    cameras without one are rendered."""


@dataclass(frozen=True, kw_only=True)
class Query:
    """Find things in the views of a field's cameras, and in the world.

    A text is answered once, in the scene; each view shows that answer. Writes a contact sheet: the relevancy as a heat
    map over the colour render, the outline of the mask, its box and its most relevant pixel. query.json contains pixel,
    coverage, box and position in every view, and level, score and place in the world of each text.
    """

    field: FieldFile
    """The .scoup file."""
    texts: Texts
    """What to look for, for example "kettle" "mug left of the laptop" "what is on the table" (docs/things.md)."""
    out: Path | None = None
    """Folder for the pictures and query.json. Default: <name of FIELD>_queries here."""
    pictures: Literal["sheet", "all", "masks", "none"] = "sheet"
    """sheet: one contact sheet, sheet.png, with a row per view and a column per text; of more than 12 views those of
    the best answers; several sheets for more than 6 texts. all: also heat map, mask and overlay of each answer, as
    single files. masks: masks/STEM.png of each view instead, white where a text is found, as LichtFeld Studio and Brush
    read them. none: query.json only."""
    npz: bool = False
    """Write relevancies and masks of each view as arrays, VIEW/relevancy.npz."""
    coco: bool = False
    """Write the masks of all views as coco.json: run lengths, boxes and scores."""
    video: Literal["path", "turntable", "none"] = "none"
    """path: an mp4 of each text's heat map on a way through the field's cameras, TEXT_path.mp4. turntable: on a circle
    around the thing. Needs scoup[video]."""
    answer: LevelOptions = LevelOptions()
    detector: Annotated[DetectorOptions, arg(name="model with words")] = DetectorOptions()
    directions: FrameOptions = FrameOptions()
    view: CameraOptions = CameraOptions()
    opening: Annotated[TextOptions, arg(name="field")] = TextOptions()
    common: AllCommon = AllCommon()

    def run(self, console: Console) -> None:
        from scoup.base import write_text
        from scoup.pictures import check_video_writer
        from scoup.query import AnswerFiles

        check_texts(self.texts)
        if self.video != "none":
            check_video_writer()
        out = self._out()
        check_output(out / RECORD, overwrite=self.common.overwrite)
        field = self.opening.open(self.field, self.common.device)
        cameras = self.view.open_cameras(field, self.field)
        field, refined = self._refine(console, field)
        question = self.opening.question(
            field, self.texts, frame=self.directions.frame(field), **self.answer.rules()
        )
        classes = [field.encoder.word_of(text) for text in self.texts] if self.coco else []
        files = AnswerFiles(self.texts, cameras, self.pictures, self.npz, classes, self.video)
        names = [RECORD, *files.names]
        with staged(out, names, self.common.overwrite) as hidden, console.progress() as progress:
            views = reported(cameras, "query", len(cameras), progress)
            records = self._write_views(field, question, views, files, hidden)
            files.finish(hidden)
            places = field.location(question)
            result: dict[str, Any] = {
                "sheets": [(out / name).as_posix() for name in files.sheet_names],
                "answers": records,
                "places": [{"text": place.answer.text, **place.to_dict()} for place in places],
                "frame": field.world.to_dict(),
            }
            if refined is not None:
                result["refined"] = refined
            if self.video != "none":
                everywhere = self.view.all_cameras(field, self.field)
                videos = files.add_videos(field, places, everywhere, hidden, progress)
                result["videos"] = [(out / name).as_posix() for name in videos]
            write_text(hidden / RECORD, as_json({"field": self.field, **result}))
        self._report(console, result, places)

    def _refine(self, console: Console, field: LanguageField) -> tuple[LanguageField, dict[str, Any] | None]:
        """Name things with a model, where one is given; return the field, and what was done as JSON values."""
        from scoup.io import load_cameras
        from scoup.query import refine

        if self.detector.refine is None:
            return field, None
        cameras = None
        if self.view.scene is not None:
            cameras = load_cameras(self.view.scene, distorted="undistort", missing_images="keep")
        refined = refine(field, self.texts, self.detector.refine, cameras)
        console.say(refined.describe())
        return refined.field, refined.to_dict()

    def _out(self) -> Path:
        return output_folder(self.out, self.field, "queries")

    def _write_views(
        self,
        field: LanguageField,
        question: Question[tuple[str, ...]],
        cameras: Iterable[Camera],
        files: AnswerFiles,
        hidden: Path,
    ) -> list[dict[str, Any]]:
        """Answer in each view and write what belongs to it; the answers as JSON values."""
        records: list[dict[str, Any]] = []
        blind: list[Camera] = []
        for camera in cameras:
            view = field.at(camera)
            answers = view.answer(question)
            # Relevancy is 0.5 wherever nothing is rendered: render only then to find out.
            if all((answer.heat == 0.5).all() for answer in answers) and not view.is_visible():
                blind.append(camera)
            rgb = view.renders.colors().cpu() if self.pictures != "none" else None
            files.add(camera, answers, rgb, hidden)
            for answer, places in zip(answers, files.of_view(camera, self._out()), strict=True):
                record = {"camera": camera.name, "text": answer.text, **answer.to_dict()}
                records.append({**record, "files": places} if places else record)
        self.view.check_seen(self.field, blind, len({record["camera"] for record in records}))
        return records

    def _report(self, console: Console, result: dict[str, Any], places: list[Place]) -> None:
        for record in result["answers"]:
            if record["present"]:
                console.say(_sentence(record))
        for place in places:
            console.say(f"in the scene  {place.answer.text}: {place.describe()}")
        doubtful = [place.answer.text for place in places if place.answer.certainty == "doubtful"]
        if doubtful and self.detector.refine is None:
            console.say(f"a detector may decide what is doubtful: {detector_command(self.field, *doubtful)}")
        for path in (*result["sheets"], *result.get("videos", ())):
            console.say(f"{path}: the answers as {'a video' if path.endswith('.mp4') else 'pictures'}")
        console.say(f"{self._out() / RECORD}: {counted(len(result['answers']), 'answer')}")
        console.result({"out": self._out(), **result})


def _sentence(record: dict[str, Any]) -> str:
    """Return an answer that is in the scene, in words."""
    start = f"{record['camera']}  {record['text']}:"
    if not record["visible"]:
        return f"{start} not visible from here"
    return f"{start} pixel {record['pixel']}, box {record['box']}, {record['coverage']:.1%} of the view"
