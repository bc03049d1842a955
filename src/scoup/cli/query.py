"""scoup query: where is it? Heat maps, masks and boxes in the views of a field."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import tyro

from scoup.cli.asking import AsksText, AsksViews
from scoup.cli.console import Console, unique_slugs

if TYPE_CHECKING:
    from torch import Tensor


@dataclass(frozen=True, kw_only=True)
class Query(AsksText, AsksViews):
    """Ask a field where things are, in the views of its cameras.

    For each view and text it writes a heat map over the colour render, the mask, the mask drawn with its box and
    point, and one query.json with level, score, pixel, coverage and box.
    """

    texts: tyro.conf.Positional[tuple[str, ...]]
    """What to look for, for example "kettle" "wooden table"."""
    out: Path | None = None
    """Folder for the pictures and query.json. Default: <name of FIELD>_queries here."""
    rule: Literal["scoup", "langsplatv2", "langsplat"] = "scoup"
    """Whose rules turn relevancy into masks and points."""
    threshold: float | None = None
    """Of the mask, 0..1. Default: the rule's own."""
    pictures: Literal["all", "none"] = "all"
    """none: write query.json only."""

    def run(self, console: Console) -> None:
        """Answer every text in every view asked for."""
        import json

        from scoup.errors import InputError
        from scoup.io import check_output, write_text
        from scoup.query import query_preset

        if not self.texts:
            raise InputError("name at least one text to look for")
        preset = query_preset(self.rule, threshold=self.threshold)
        out = self.out or Path(f"{self.field.stem}_queries")
        check_output(out / "query.json", self.overwrite)
        field = self.open_field()
        cameras = self.open_cameras(field)
        queries, canonical = self.encode(field, self.texts)
        names = unique_slugs(list(self.texts))
        folders = unique_slugs([camera.stem for camera in cameras])
        records: list[dict[str, Any]] = []
        with console.progress() as progress:
            progress("query", 0, len(cameras))
            for done, (camera, folder) in enumerate(zip(cameras, folders, strict=True), start=1):
                view = field.look(camera)
                relevancy = field.relevancy(camera, queries, canonical, view)
                rgb = None
                if self.pictures == "all":
                    from scoup.raster import render_colors

                    rgb = render_colors(field.gaussians, camera, view).cpu()
                for text, name, maps in zip(self.texts, names, relevancy.unbind(1), strict=True):
                    record = {"camera": camera.name, "text": text, **_answer(maps, field.levels, preset)}
                    mask = record.pop("mask")
                    if rgb is not None:
                        level = field.levels.index(record["level"])
                        record["files"] = self._draw(out / folder, name, maps[level].cpu(), mask, rgb, record)
                    records.append(record)
                progress("query", done, len(cameras))
        write_text(out / "query.json", json.dumps({"field": str(self.field), "answers": records}, indent=2), self.overwrite)
        for record in records:
            box = "no pixel" if record["box"] is None else f"box {record['box']}"
            console.say(
                f"{record['camera']}  {record['text']}: score {record['score']:.2f} at level {record['level']}, "
                f"pixel {record['pixel']}, {box}, {record['coverage']:.1%} of the view"
            )
        console.say(f"{out}/query.json: {len(records)} answers")
        console.result({"out": out, "answers": records})

    def _draw(
        self, folder: Path, name: str, relevancy: Tensor, mask: Tensor, rgb: Tensor, record: dict[str, Any]
    ) -> dict[str, str]:
        from scoup.io import save_png
        from scoup.pictures import heat_map, mask_overlay

        level, score = record["level"], record["score"]
        remark = f"level {level}, {record['coverage']:.1%} of the view"
        made = {
            "heat": heat_map(relevancy, rgb, record["text"], level, score),
            "mask": mask,
            "overlay": mask_overlay(mask, rgb, record["box"], record["pixel"], record["text"], remark),
        }
        files = {kind: folder / f"{name}_{kind}.png" for kind in made}
        for kind, image in made.items():
            save_png(image, files[kind], self.overwrite)
        return {kind: path.as_posix() for kind, path in files.items()}


def _answer(maps: Tensor, levels: tuple[str, ...], preset: Any) -> dict[str, Any]:
    """What one text gets in one view: relevancy maps [S, H, W] to a record, and the mask."""
    from scoup.query import localize, segment

    place, shape = localize(maps, preset), segment(maps, preset)
    return {
        "level": levels[shape.level],
        "score": round(shape.score, 4),
        "pixel": list(place.pixel),
        "pixel_level": levels[place.level],
        "pixel_score": round(place.score, 4),
        "coverage": round(shape.coverage, 6),
        "box": None if shape.box is None else list(shape.box),
        "mask": shape.mask.cpu(),
    }
