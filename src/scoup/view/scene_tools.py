"""Tools for language models as plain functions: arguments in, JSON values or a picture out."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from scoup.base import InputError, OutputExistsError, ScoupError, looked_up, rounded_vector
from scoup.io import save_gaussians
from scoup.models import LONGEST
from scoup.pictures import Picture, as_picture, mask_overlay
from scoup.query import (
    LanguageField,
    Thing,
    named_things,
    related_objects,
)
from scoup.scene import Cameras

MOST_LISTED = 200
"""Things in one reply."""
MOST_MARKED = 12
"""Things marked in one picture."""
WIDEST = 1024
"""Pixels of the longer side of a picture."""
_OF_TEXTS = ("score", "certainty", "count", "runner_up")
_COLORS = ((255, 92, 40), (64, 160, 255), (90, 200, 90), (240, 200, 40), (200, 90, 220), (40, 210, 210))


@dataclass(frozen=True, eq=False)
class SceneTools:
    """The tools over some fields.

    Everything a caller passes is checked; files are written into one folder only, and only new ones.
    """

    fields: Mapping[str, LanguageField]
    """By the names under which they are served."""
    export_folder: Path | None = None
    """Where selections are written; None: nowhere."""
    words: tuple[str, ...] = ()
    """That may be names of things; none: those that a page has."""

    def list_scenes(self) -> list[dict[str, Any]]:
        """List the scenes with their size, number of things, levels, cameras and frame in the world."""
        return [
            {
                "scene": name,
                "gaussians": len(field),
                "things": len(field.things()),
                "levels": list(field.levels),
                "cameras": len(field.cameras or ()),
                "frame": field.world.to_dict(),
            }
            for name, field in self.fields.items()
        ]

    def list_cameras(self, scene: str) -> list[dict[str, Any]]:
        """List the cameras of a scene: name, position and image size in pixels."""
        return [
            {
                "camera": camera.name,
                "position": rounded_vector(camera.position.tolist(), 5),
                "width": camera.width,
                "height": camera.height,
            }
            for camera in self._field(scene).cameras or ()
        ]

    def list_things(self, scene: str, level: str | None = None, limit: int = 50) -> dict[str, Any]:
        """List the things of a scene in short, the largest first; `level` keeps those of one level of detail.

        `text` is the name of a thing, if it has one; `named_by` says whether a detector gave it or embeddings alone
        did, which are wrong more often. `count` is how many there are, `more` how many are not listed;
        `describe_thing` tells the rest of one.
        """
        if level is not None:
            self._field(scene).level_index(level)
        metres = "" if self._field(scene).world.metres_per_unit is None else "_metres"

        def brief(thing: Thing) -> dict[str, Any]:
            record = thing.to_dict()
            return {
                **_name(thing),
                "level": thing.level,
                f"position{metres}": record[f"position{metres}"],
                f"extent{metres}": record["extent_metres"] if metres else record["box"]["extent"],
            }

        things = [thing for thing in self._named(scene).values() if level in (None, thing.level)]
        return _reply(things, limit, brief)

    def describe_scene(self, scene: str, thing: int | None = None, limit: int = 50) -> dict[str, Any]:
        """Describe a scene as a graph: its objects, the largest first, and the numbers of what each is on or inside.

        With `thing`, only that one, what it is on or inside, and what is on or inside it. Names: as in `list_things`.
        """
        field, every = self._field(scene), self._named(scene)
        asked = None if thing is None else _numbered_thing(every, thing)
        objects, pairs = related_objects(field, list(every.values()), asked)
        related: dict[int, dict[str, list[int]]] = {}
        shown = {thing}
        for one, what, other in pairs:
            if thing in (None, one, other):
                related.setdefault(one, {}).setdefault(what, []).append(other)
                shown |= {one, other}

        def node(entry: Thing) -> dict[str, Any]:
            return {**_name(entry), **related.get(entry.number or 0, {})}

        return _reply([entry for entry in objects if thing is None or entry.number in shown], limit, node)

    def find(self, scene: str, text: str, seen_from: str | None = None, limit: int = 50) -> dict[str, Any]:
        """Find every thing that a text or phrase names, the best first.

        `text` is a name ("mug"), or a phrase with a relation or an order: "mug left of the laptop", "what is on the
        shelf", "kettle nearest to the sink", "largest box", "second chair from the left", also with and, or, not. An
        unknown relation is an error that lists the known ones. Left, right, in front of and behind are meant as seen
        from the camera `seen_from`. A score is the share of everyday words that fit this scene less well than the text,
        0 to 1; null with too few everyday words.
        `texts` has one entry per text of the phrase: its score, the same in words (sure, likely, doubtful, not here),
        how many things it is, and the runner-up: the best thing elsewhere, if it fits nearly as well. `things` is empty
        where a text is not here, or where no thing has the relation; `remark` says which. `frame` says what positions
        are in: unit vectors right, up and away from the viewer in the same axes, and `metres_per_unit`; null: lengths
        are in scene units, and no key ends in `_metres`.
        """
        field = self._field(scene)
        frame = field.frame(seen_from)
        question = field.question(_bounded(text), frame=frame)
        things, answer = field.things(question), field.select(question)
        axes = "x, y, z of the splat that the field was built on"
        return {
            **_reply(things, limit, lambda thing: thing.to_dict()),
            "remark": answer.remark(),
            "texts": [
                {"text": single.text, **{key: record[key] for key in _OF_TEXTS}}
                for single in answer.parts
                for record in [single.to_dict()]
            ],
            "directions": frame.describe(),
            "frame": {"axes": axes, **frame.to_dict()},
        }

    def describe_thing(self, scene: str, thing: int) -> dict[str, Any]:
        """Describe one thing by its number: place, box, what it is a part of, and its own parts."""
        every = self._named(scene)
        one = _numbered_thing(every, thing)
        parts = [number for number, other in every.items() if other.parent == thing]
        return {**one.to_dict(), "parts": parts}

    def measure_distance(self, scene: str, thing: int, other: int) -> dict[str, Any]:
        """Measure the distance between the positions of two things."""
        every = self._things(scene)
        one, two = _numbered_thing(every, thing), _numbered_thing(every, other)
        distance = float((one.position - two.position).norm())
        # Metres are no arbitrary unit: a tenth of a millimetre is enough.
        unit = one.world.metres_per_unit
        metres = {} if unit is None else {"metres": round(distance * unit, 4)}
        return {"thing": thing, "other": other, "distance": float(f"{distance:.6g}"), **metres}

    def render_view(self, scene: str, camera: str | None = None, things: list[int] | None = None) -> Picture:
        """Render the scene as a camera sees it, with some things marked in colours and by their numbers."""
        field = self._field(scene)
        if things and len(things) > MOST_MARKED:
            raise InputError(f"things: at most {MOST_MARKED} in one picture, got {len(things)}")
        every = self._things(scene) if things else {}
        marked = [_numbered_thing(every, number) for number in things or ()]
        view = field.camera(0 if camera is None else camera)
        if max(view.width, view.height) > WIDEST:
            view = Cameras([view]).scaled(WIDEST / max(view.width, view.height))[0]
        seen = field.at(view)
        picture = as_picture(seen.renders.colors().cpu())
        for index, thing in enumerate(marked):
            mask = seen.mask_of(thing.gaussians)
            if bool(mask.any()):
                color = _COLORS[index % len(_COLORS)]
                drawn = mask_overlay(mask, picture, color=color)
                picture = np.where(mask.numpy()[..., None], drawn, picture)
                picture = _numbered(picture, mask.numpy(), str(thing.number), color)
        return picture

    def export_selection(
        self, scene: str, text: str, file_name: str, seen_from: str | None = None
    ) -> dict[str, Any]:
        """Write the Gaussians that answer an expression ("mug and not handle", "mug left of the laptop") as a new PLY.

        The file goes into the folder named when the server was started; `file_name` is a plain name without folders.
        """
        if self.export_folder is None:
            raise InputError("this server writes no files: it was started without a folder for exports")
        field, name = self._field(scene), file_name.removesuffix(".ply")
        if not re.fullmatch(r"[a-z0-9][a-z0-9_-]{0,63}", name):
            raise InputError(
                f"{file_name[:80]!r}: expected a plain name of lower-case letters, digits, - and _, such as mug.ply"
            )
        path = self.export_folder / f"{name}.ply"
        answer = field.select(field.question(_bounded(text), frame=field.frame(seen_from)))
        count = int(answer.mask.sum())
        if not count:
            raise InputError(f"{text[:80]!r}: nothing answers in this scene, so nothing was written")
        try:
            save_gaussians(field.gaussians.select(answer.mask.to(field.gaussians.device)).to("cpu"), path)
        except OutputExistsError:
            raise InputError(f"{path.name}: already exists; choose another name") from None
        return {"file": path.name, "gaussians": count}

    def _field(self, scene: str) -> LanguageField:
        return looked_up("scene", scene, self.fields)

    def _named(self, scene: str) -> dict[int | None, Thing]:
        """Return all things by number, the largest first, with their names."""
        field = self._field(scene)
        try:
            words = field.naming_question(self.words)
        except ScoupError:  # there is no encoder
            words = None
        things = sorted(named_things(field, words), key=lambda thing: -thing.n_gaussians)
        return {thing.number: thing for thing in things}

    def _things(self, scene: str) -> dict[int | None, Thing]:
        return {thing.number: thing for thing in self._field(scene).things()}


def _reply(
    things: Sequence[Thing], limit: int, describe: Callable[[Thing], dict[str, Any]]
) -> dict[str, Any]:
    if not 1 <= limit <= MOST_LISTED:
        raise InputError(f"limit: expected 1 to {MOST_LISTED}, got {limit}")
    listed = [describe(thing) for thing in things[:limit]]
    return {"count": len(things), "more": len(things) - len(listed), "things": listed}


def _name(thing: Thing) -> dict[str, Any]:
    named_by = {"named_by": thing.named_by} if thing.named_by else {}
    return {"thing": thing.number, "text": thing.text, **named_by}


def _numbered_thing(things: Mapping[int | None, Thing], number: int) -> Thing:
    if number not in things:
        raise InputError(f"there is no thing {number}; list_things names those of the scene")
    return things[number]


def _bounded(text: str) -> str:
    if not text.strip() or len(text) > LONGEST:
        raise InputError(f"text: expected 1 to {LONGEST} characters, got {len(text)}")
    return text


def _numbered(picture: Picture, mask: np.ndarray, text: str, color: tuple[int, int, int]) -> Picture:
    """Write a number in the middle of a mask [H, W]."""
    from PIL import Image, ImageDraw, ImageFont

    rows, columns = np.nonzero(mask)
    image = Image.fromarray(picture)
    draw, face = ImageDraw.Draw(image), ImageFont.load_default(max(12, math.ceil(picture.shape[1] / 50)))
    middle = (float(np.median(columns)), float(np.median(rows)))
    draw.text(
        middle,
        text,
        fill="white",
        font=face,
        anchor="mm",
        stroke_width=2,
        stroke_fill=tuple(c // 3 for c in color),
    )
    return np.asarray(image)
