"""scoup label: one of several words for every Gaussian, in files for other programs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from scoup.base import counted, staged
from scoup.cli.console import Console
from scoup.cli.options import AllCommon, FieldFile, Names, arg
from scoup.cli.query_options import (
    AnswerOptions,
    CameraOptions,
    FrameOptions,
    TextOptions,
    check_texts,
    output_folder,
)

if TYPE_CHECKING:
    from scoup.query import GaussianLabels, LanguageField
    from scoup.scene import Camera

Output = Literal["sidecar", "ids", "colors", "glb", "usd", "clouds", "maps", "masks", "sheet"]
USUAL: tuple[Output, ...] = ("sidecar", "ids", "colors", "sheet")


@dataclass(frozen=True, kw_only=True)
class LabelViews(CameraOptions):
    """The views of maps and the sheet."""

    camera: Names = ()
    """Of maps and the sheet: name of a camera (with or without extension); repeat it for several. Default: all."""


@dataclass(frozen=True, kw_only=True)
class Label:
    """Label every Gaussian with the best of a list of words, or none, for other programs.

    A word applies to the Gaussians that `scoup select` finds, if it is in the scene. Of several words for one Gaussian,
    the finer level wins, then the larger score.
    """

    field: FieldFile
    """The .scoup file."""
    texts: Annotated[tyro.conf.Positional[tuple[str, ...]], arg(metavar="WORD [WORD ...]")] = ()
    """Things, for example "kettle" "mug left of the laptop" (docs/things.md), numbered from 0 in this order."""
    words: Path | None = None
    """File of further words, one per line, each taken as it is."""
    out: Path | None = None
    """Folder to write. Default: <name of FIELD>_labels here."""
    outputs: tuple[Output, ...] = USUAL
    """What is written. sidecar: labels.npy, a number per Gaussian, -1 for none, and labels.json, what the numbers mean.
    ids: labels.ply, the splat with integer properties `label` and `thing`. colors: colored.ply, the splat in the
    colours of the words. sheet: labels.png, some views with a legend. glb: labels.glb with EXT_mesh_features. usd:
    labels.usdc, a prim with label and box per thing. clouds: a point cloud per word. maps: a PNG with palette for each
    camera, and coco.json. masks: masks/STEM.png for each camera, white where a word applies, as LichtFeld Studio and
    Brush read them."""
    answer: AnswerOptions = AnswerOptions()
    directions: FrameOptions = FrameOptions()
    view: LabelViews = LabelViews()
    opening: Annotated[TextOptions, arg(name="field")] = TextOptions()
    common: AllCommon = AllCommon()

    def run(self, console: Console) -> None:
        from scoup.query import Expression, LabelFiles

        words = self._words()
        out = output_folder(self.out, self.field, "labels")
        field = self.opening.open(self.field, self.common.device)
        cameras = self._cameras(field)
        outputs = self.outputs if cameras or self.outputs != USUAL else USUAL[:-1]
        asked: list[Any] = [*dict.fromkeys(self.texts), *map(Expression, words[len(set(self.texts)) :])]
        frame = self.directions.frame(field)
        question = self.opening.question(field, asked, frame=frame, **self.answer.rules())
        # Only the words decide the names of files, so that what cannot be written is known before the work.
        files = LabelFiles([*dict.fromkeys(map(field.encoder.word_of, words))], outputs, cameras)
        with staged(out, files.names, self.common.overwrite) as hidden, console.progress() as progress:
            labels = field.label(question)
            blind = files.write(field, labels, hidden, self.opening.gaussians, progress)
            if cameras:
                self.view.check_seen(self.field, blind, len(cameras))
        _report(console, labels, out, [name for name in files.names if (out / name).exists()])

    def _words(self) -> tuple[str, ...]:
        """Return the words of the command line and of the list, each once."""
        from scoup.io import read_words

        words = tuple(dict.fromkeys((*self.texts, *read_words(self.words))))
        check_texts(words)
        return words

    def _cameras(self, field: LanguageField) -> list[Camera]:
        """Return the cameras named; by default all, or none if the field has none and no output needs them."""
        wanted = set(self.outputs) & {"maps", "masks", "sheet"}
        if not wanted or (
            self.outputs == USUAL and not self.view.camera and self.view.scene is None and not field.cameras
        ):
            return []
        return self.view.open_cameras(field, self.field, "all")


def _report(console: Console, labels: GaussianLabels, out: Path, files: list[str]) -> None:
    from scoup.query import ExpressionAnswer

    record = labels.to_dict()
    for one, answer in zip(record["classes"], labels.answers, strict=True):
        seen_from = answer.seen_from if isinstance(answer, ExpressionAnswer) else ""
        seen = f", as seen from {seen_from}" if seen_from else ""
        things = f"{answer.counted()}, " if answer.things else ""
        summary = f"{things}{counted(one['gaussians'], 'Gaussian')}{seen}"
        console.say(f"{one['name']}: {summary if one['present'] else answer.remark()}")
    console.say(f"none of these: {counted(record['none']['gaussians'], 'Gaussian')}")
    for name in files:
        console.say(f"{out / name}")
    console.result({"out": out, "files": files, **record})
