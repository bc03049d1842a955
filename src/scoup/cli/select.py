"""scoup select: the Gaussians that answer a text, kept, removed or changed."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from scoup.base import InputError, counted
from scoup.cli.console import Console
from scoup.cli.options import AllCommon, FieldFile, Names, Texts, arg, check_number
from scoup.cli.query_options import CameraOptions, FrameOptions, LevelOptions, TextOptions, check_texts

if TYPE_CHECKING:
    from scoup.query import ExpressionAnswer, LanguageField, Place


@dataclass(frozen=True, kw_only=True)
class ShapeOptions:
    """Changes to the selection before it is used."""

    largest: bool = False
    """Keep only the largest connected component of the selection."""
    shrink: int = 0
    """Remove Gaussians with a neighbour outside the selection, this many times."""
    grow: int = 0
    """Add the neighbours of the selection, this many times."""
    within: float = 0.0
    """Add Gaussians within this distance of the selection, in metres (scene units, while the field has no metre)."""


@dataclass(frozen=True, kw_only=True)
class PictureViews(CameraOptions):
    """The view of the picture."""

    camera: Names = ()
    """Of --picture: name of a camera. Default: the one that sees most of the selection."""


@dataclass(frozen=True, kw_only=True)
class Select:
    """Edit a splat by words: keep, remove, recolour or fade the Gaussians that answer, and write the scene that is
    left.

    From PLY to PLY, rows are copied byte for byte except
    for the change. A .scoup contains its Gaussians and can be queried again.
    """

    field: FieldFile
    """The .scoup file."""
    texts: Texts
    """What to look for: "kettle", "mug and not handle", mug + cup - handle. Texts without and, or, not, + or - between
    them are combined with or. "mug left of the laptop", "largest box" and "second chair from the left" select things by
    relation or order (docs/things.md). A text in inner double quotes is taken literally."""
    out: Path
    """The splat (.ply, .splat, .spz, .glb, .gltf, .ksplat, .sog, .usd, .usdz) or field (.scoup) to write."""
    edit: Literal["keep", "remove", "recolor", "fade", "state"] = "keep"
    """keep: write the selection. remove: all others. recolor, fade: all, with the selection changed. state: all, with
    the selection live in SuperSplat (PLY only; `scoup label` writes a class for each Gaussian)."""
    color: str = "#ff5c28"
    """Colour for --edit recolor, #rrggbb. Light and shade stay."""
    opacity: float = 0.15
    """Factor of the opacities for --edit fade, 0 to 1."""
    picture: Path | None = None
    """Write a .png of the scene before, the selection, and the scene after."""
    answer: LevelOptions = LevelOptions()
    shape: ShapeOptions = ShapeOptions()
    directions: FrameOptions = FrameOptions()
    view: PictureViews = PictureViews()
    opening: Annotated[TextOptions, arg(name="field")] = TextOptions()
    common: AllCommon = AllCommon()

    def run(self, console: Console) -> None:
        from scoup.query import Reshaping, parse_expression

        check_texts(self.texts)
        shape = self.shape
        reshaping = Reshaping(shape.largest, shape.shrink, shape.grow, shape.within)
        self._check_options()
        field = self.opening.open(self.field, self.common.device)
        reshaping = replace(reshaping, within=shape.within / (field.world.metres_per_unit or 1.0))
        expression = parse_expression(self.texts, field.encoder.names)
        self._check_out(field)
        question = self.opening.question(
            field, expression, frame=self.directions.frame(field), **self.answer.rules()
        )
        whole = field.select(question, reshaping)
        self._check_found(whole, int(field.select(question).mask.sum()))
        written = self._write(field, whole)
        self._report(console, whole, written, field.location(whole), field.world.to_dict())

    def _check_options(self) -> None:
        from scoup.base import check_output
        from scoup.io import written_format
        from scoup.query import SceneEdit

        check_number("--opacity", self.opacity, 0, 1)
        self._rgb()
        is_field = self.out.suffix.lower() == ".scoup"
        if not is_field:
            written_format(self.out, "a field (.scoup)")
        if self.edit == "state" and not SceneEdit.copies_rows(self.out):
            what = "a field" if is_field else "this format"
            raise InputError(f"{self.out}: {what} has no column of states; use a name that ends in .ply")
        if self.picture is not None and self.picture.suffix.lower() != ".png":
            raise InputError(f"{self.picture}: the picture is a PNG; use a name that ends in .png")
        for path in (self.out, self.picture):
            if path is not None:
                check_output(path, overwrite=self.common.overwrite)

    def _rgb(self) -> tuple[float, float, float]:
        """Return the colour of --color, 0 to 1."""
        if not re.fullmatch("#?[0-9a-fA-F]{6}", self.color):
            raise InputError(f"--color {self.color}: is not a colour; expected #rrggbb, for example #ff5c28")
        red, green, blue = bytes.fromhex(self.color[-6:])
        return red / 255, green / 255, blue / 255

    def _check_out(self, field: LanguageField) -> None:
        """Refuse to replace the field itself, or its own splat."""
        for what, source in (
            ("splat the field was built on", self.opening.gaussians),
            ("splat the field was built on", field.geometry_path),
            ("field that is queried", self.field),
        ):
            if source and self.out.exists() and source.exists() and self.out.samefile(source):
                raise InputError(f"{self.out}: is the {what}; use another name with --out")

    def _check_found(self, answer: ExpressionAnswer, before: int) -> None:
        """Refuse to write nothing, or the scene as it was; ``before`` Gaussians answer without the options of shape.

        Raises:
            InputError: nothing answers, or all would be removed.
        """
        selected, count = int(answer.mask.sum()), len(answer.mask)
        if selected and not (self.edit == "remove" and selected == count):
            return
        advice = "try a higher --threshold" if selected else "try a lower --threshold"
        if not selected and not answer.presence:
            advice = f"{answer.text}: {answer.remark()}"
            if not all(term.presence for term in answer.parts):
                advice += "; --always chooses something anyway"
        if not selected and before:
            advice = f"{before:,} do before --shrink {self.shape.shrink}, which leaves none; shrink less"
        raise InputError(
            f"{self.out}: nothing to write, {selected:,} of {counted(count, 'Gaussian')} answer; {advice}"
        )

    def _write(self, field: LanguageField, whole: ExpressionAnswer) -> int:
        """Write the scene that is left, and the picture; returns the number of Gaussians written."""
        from scoup.io import save_png
        from scoup.query import SceneEdit

        edit = SceneEdit(field, whole.mask, self.edit, self._rgb(), self.opacity)
        if self.picture is not None:
            cameras = self.view.open_cameras(field, self.field, "all")
            save_png(edit.picture(cameras, whole.text), self.picture, self.common.overwrite)
        return edit.save(self.out, self.opening.gaussians, self.common.overwrite)

    def _report(
        self, console: Console, whole: ExpressionAnswer, written: int, place: Place, frame: dict[str, Any]
    ) -> None:
        counts = {term.text: int(term.mask.sum()) for term in whole.parts}
        for term in whole.parts:
            things = f"{term.counted()}, " if term.things else ""
            share = f"{things}{counts[term.text]:,} of {counted(len(whole.mask), 'Gaussian')}"
            console.say(f"{term.text}: {share if term.presence else term.remark()}")
        selected = int(whole.mask.sum())
        if list(counts) != [whole.text]:
            console.say(f"{whole.text}: {selected:,}")
        elif selected != counts[whole.text]:
            console.say(f"{whole.text}, reshaped: {selected:,}")
        if place.position is not None:
            console.say(place.describe())
        console.say(f"{self.out}: {counted(written, 'Gaussian')} written")
        if self.edit == "remove":
            console.say("nothing was photographed behind it: expect a hole or haze in its place")
        if self.picture is not None:
            console.say(f"{self.picture}: before, selection, after")
        console.result(
            {
                "out": self.out,
                "written": written,
                "chosen": counts,
                "texts": {term.text: term.to_dict() for term in whole.parts},
                "gaussians": len(whole.mask),
                "expression": whole.text,
                "selected": selected,
                "place": place.to_dict(),
                "frame": frame,
            }
        )
