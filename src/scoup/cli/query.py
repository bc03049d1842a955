"""scoup query: where is it? Heat maps, masks and boxes in the views of a field."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from scoup.cli.asking import AsksText, AsksViews, not_there, sees_nothing
from scoup.cli.console import Console
from scoup.cli.names import unique_slugs
from scoup.cli.options import Flag, OptionalNumber, OptionalPath, Texts, common_last
from scoup.cli.staging import check_folder, check_outputs, staged

if TYPE_CHECKING:
    from torch import Tensor

    from scoup.query.answers import QueryPreset
    from scoup.scene.cameras import Camera

RECORD = "query.json"
PICTURES = ("heat", "mask", "overlay")


@common_last
@dataclass(frozen=True, kw_only=True)
class Query(AsksText, AsksViews):
    """Ask a field where things are, in the views of its cameras.

    For each view and text it writes three pictures: the relevancy as a heat map over the colour render, the mask,
    and the mask drawn over the render with its box and point. One query.json holds level, score, pixel, coverage
    and box of every answer.
    """

    texts: Texts
    """What to look for, for example "kettle" "wooden table"."""
    out: OptionalPath = None
    """Folder for the pictures and query.json. Default: <name of FIELD>_queries here."""
    rule: Literal["default", "scoup", "langsplatv2", "langsplat"] = "default"
    """What turns relevancy into masks and points: sides of the boxes that smooth, threshold, choice of the level.
    scoup, langsplatv2 and langsplat are those systems' rules for LERF-OVS; default takes the constants of scoup and
    the level whose mask is the most relevant on average, and compares with everyday words, too."""
    threshold: OptionalNumber = None
    """A pixel is in the mask above this, 0 to 1, once relevancy is rescaled over the view. Default: the rule's."""
    presence: OptionalNumber = None
    """A text is in a view if what was found lies this many standard deviations nearer to it than to everyday words;
    otherwise it gets an empty mask and no point there. Default: 2 with the rule default, where
    the table of --text has 16 words or more; the systems' rules find something always."""
    always: Flag = False
    """Find something in every view, whatever is asked."""
    pictures: Literal["all", "none"] = "all"
    """none: write query.json only."""

    def run(self, console: Console) -> None:
        """Answer every text in every view asked for."""
        import json

        from scoup.base.errors import InputError
        from scoup.io import write_text
        from scoup.models.words import with_everyday
        from scoup.query.answers import query_preset
        from scoup.query.presence import PRESENT_FROM, view_standing

        if not self.texts:
            raise InputError('name at least one text to look for, for example "kettle"')
        preset = query_preset(self.rule, threshold=self.threshold)
        judged = not self.always and (self.presence is not None or self.rule == "default")
        bound = PRESENT_FROM if self.presence is None else self.presence
        out = self.out or Path(f"{self.field.stem}_queries")
        check_folder(out)
        check_outputs(out, [RECORD], self.overwrite)
        field = self.open_field()
        cameras = self.open_cameras(field)
        vectors = self.encode(field, self.texts)
        queries, canonical = vectors.queries, vectors.canonical
        if self.rule == "default":
            canonical = with_everyday(canonical, vectors.everyday)
        words = vectors.standing_words(self.presence is not None) if judged else None

        names = unique_slugs(self.texts)
        folders = unique_slugs(camera.stem for camera in cameras)
        files = [RECORD]
        if self.pictures == "all":
            files += [
                f"{folder}/{name}_{kind}.png" for folder in folders for name in names for kind in PICTURES
            ]
        records: list[dict[str, Any]] = []
        blind: list[Camera] = []
        with staged(out, files, self.overwrite) as hidden, console.progress() as progress:
            progress("query", 0, len(cameras))
            for done, (camera, folder) in enumerate(zip(cameras, folders, strict=True), start=1):
                view = field.project(camera)
                relevancy = field.relevancy(camera, queries, canonical, view)
                if bool((relevancy == 0.5).all()) and sees_nothing(field, view):
                    blind.append(camera)
                rgb = None
                if self.pictures == "all":
                    from scoup.raster import render_colors

                    rgb = render_colors(field.gaussians, camera, view).cpu()
                standings: list[float | None] = [None] * len(self.texts)
                if words is not None:
                    standings = view_standing(field, view, relevancy, queries, words, preset).tolist()
                asked = zip(self.texts, names, relevancy.unbind(1), standings, strict=True)
                for text, name, maps, standing in asked:
                    answer = _answer(maps, field.levels, preset, standing, bound)
                    record = {"camera": camera.name, "text": text, **answer}
                    mask = record.pop("mask")
                    if rgb is not None:
                        level = field.levels.index(record["level"])
                        drawn = _draw(hidden / folder, name, maps[level].cpu(), mask, rgb, record)
                        record["files"] = {
                            kind: (out / folder / file).as_posix() for kind, file in drawn.items()
                        }
                    records.append(record)
                progress("query", done, len(cameras))
            self.tell_blind(blind, len(cameras))
            write_text(hidden / RECORD, json.dumps({"field": str(self.field), "answers": records}, indent=2))
        for record in records:
            if not record.get("present", True):
                told = not_there("view", record["standing"], bound)
                console.say(f"{record['camera']}  {record['text']}: {told}")
                continue
            box = "no pixel" if record["box"] is None else f"box {record['box']}"
            console.say(
                f"{record['camera']}  {record['text']}: score {record['score']:.2f} at level {record['level']}, "
                f"pixel {record['pixel']}, {box}, {record['coverage']:.1%} of the view"
            )
        console.say(f"{out / RECORD}: {len(records)} answers")
        console.result({"out": out, "answers": records})


def _draw(
    folder: Path, name: str, relevancy: Tensor, mask: Tensor, rgb: Tensor, record: dict[str, Any]
) -> dict[str, str]:
    """Write the pictures of one answer; the file name of each kind."""
    from scoup.io import save_png
    from scoup.pictures import heat_map, mask_overlay

    level, score = record["level"], record["score"]
    is_there = record.get("present", True)
    remark = f"level {level}, {record['coverage']:.1%} of the view" if is_there else "not in this view"
    made = {
        "heat": heat_map(relevancy, rgb, record["text"], level, score),
        "mask": mask,
        "overlay": mask_overlay(mask, rgb, record["box"], record["pixel"], record["text"], remark),
    }
    files = {kind: f"{name}_{kind}.png" for kind in PICTURES}
    for kind, file in files.items():
        save_png(made[kind], folder / file)
    return files


def _answer(
    maps: Tensor, levels: tuple[str, ...], preset: QueryPreset, standing: float | None, bound: float
) -> dict[str, Any]:
    """What one text gets in one view: relevancy maps [S, H, W] to a record, and the mask. ``standing`` is None where
    presence is not judged."""
    from scoup.query.answers import localize_and_segment

    place, shape = localize_and_segment(maps, preset)
    record = {
        "level": levels[shape.level],
        "score": round(shape.score, 4),
        "pixel": list(place.pixel),
        "pixel_level": levels[place.level],
        "pixel_score": round(place.score, 4),
        "coverage": round(shape.coverage, 6),
        "box": None if shape.box is None else list(shape.box),
        "mask": shape.mask.cpu(),
    }
    if standing is None:
        return record
    told = round(standing, 3) if math.isfinite(standing) else None  # JSON knows no infinity
    record |= {"standing": told, "present": standing >= bound}
    if not record["present"]:
        record |= {"pixel": None, "coverage": 0.0, "box": None, "mask": shape.mask.cpu() & False}
    return record
