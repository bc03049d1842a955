"""A catalogue of a scene: every thing with a name, place and box, and the relations between things. Its files are the
scene graph, a table, pictures and a page."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from PIL import Image

from scoup.base import InputError, Progress, as_json, html, no_progress, rounded_vector, staged, write_text
from scoup.field import Field
from scoup.pictures import Picture, as_picture, mask_overlay
from scoup.query.field_view import FieldView
from scoup.query.frame import Frame, scene_frame
from scoup.query.question import Question
from scoup.query.relations import overlaps, related_pairs, relations
from scoup.query.thing_names import find_objects, named_things, thing_names
from scoup.query.things import Thing
from scoup.query.view_answer import mask_box
from scoup.scene import Camera

SCHEMA = "scoup scene graph"
GRAPH, TABLE, PAGE, PICTURES = "catalog.json", "catalog.csv", "index.html", "pictures"
MARGIN = 0.35  # around a thing in its picture, in units of its size
_FORMULAS = (*"=+-@\t\r\n", *"＝＋－＠")
SIDE = 240  # pixels of the longer side of a picture


@dataclass(frozen=True, eq=False, repr=False)
class Catalog:
    """The named things of a scene.

    Example:
        >>> catalog = field.catalog(["kettle", "wooden table"])
        >>> sorted({thing.text for thing in catalog.things} - {"kettle", "wooden table"})
        []
    """

    things: tuple[Thing, ...]
    """Every thing with its best name as ``text``, or ""; finer levels first."""
    names: tuple[tuple[str, ...], ...]
    """Up to three names per thing, best first."""
    objects: tuple[int, ...]
    """Numbers of the things that are one object each (``scoup.query.thing_names``); others are their parts, groups of
    them, or fragments."""
    relations: tuple[tuple[int, str, int], ...]
    """(number of a thing, "on" or "inside", number of another of its level)."""
    frame: Frame
    """What up means."""

    def __repr__(self) -> str:
        return f"Catalog({len(self.objects)} objects, {len(self.things)} things, {len(self.relations)} relations)"

    def to_dict(self) -> dict[str, Any]:
        """Return the scene graph as plain JSON values (docs/formats.md, "Scene graph")."""
        things = [
            {**thing.to_dict(), "names": list(names)}
            for thing, names in zip(self.things, self.names, strict=True)
        ]
        relations = [{"thing": one, "relation": what, "to": other} for one, what, other in self.relations]
        return {
            "format": SCHEMA,
            "version": 1,
            "frame": self.frame.to_dict(),
            "things": things,
            "objects": list(self.objects),
            "relations": relations,
        }


def make_catalog(field: Field, question: Question[Any], frame: Frame | None = None) -> Catalog:
    """Return every thing of a field, named by several words; ``LanguageField.catalog`` documents it."""
    if field.thing_table is None:
        raise InputError(
            f"{field.path or 'this field'}: contains no things; build it again with things, from its photographs"
        )
    frame = scene_frame(field) if frame is None else frame
    names, named = thing_names(field, question), named_things(field, question)
    texts = tuple(names[number].texts if (number := thing.number or 0) in names else () for thing in named)
    objects = tuple(thing.number or 0 for thing in find_objects(field, named))
    return Catalog(tuple(named), texts, objects, tuple(relations(field, frame)), frame)


def related_objects(
    field: Field, things: Sequence[Thing], one: Thing | None = None
) -> tuple[list[Thing], list[tuple[int, str, int]]]:
    """Return the objects among all things, named, and which are on or inside others (``related_pairs``); ``one`` is an
    object in place of those that overlap it."""
    objects = find_objects(field, things)
    if one is not None:
        objects = [one, *(thing for thing in objects if not overlaps(thing, one))]
    return objects, [*related_pairs(field, objects, scene_frame(field))]


def catalog_rows(catalog: Catalog) -> list[list[Any]]:
    """Return the things as rows of a table, the first with the names of the columns."""
    head = ["thing", "name", "other names", "named by", "level", "parent"]
    rows: list[list[Any]] = [[*head, "x", "y", "z", "length", "width", "height", "gaussians", "regions"]]
    for thing, names in zip(catalog.things, catalog.names, strict=True):
        unit = thing.world.metres_per_unit or 1.0
        numbers = [*(thing.position * unit).tolist(), *(thing.box.extent * unit).tolist()]
        parent = "" if thing.parent is None else thing.parent
        facts = [thing.number, thing.text, "; ".join(names[1:]), thing.named_by, thing.level, parent]
        rows.append([*facts, *rounded_vector(numbers, 6), thing.n_gaussians, thing.n_regions])
    return rows


def save_catalog(
    field: Field,
    catalog: Catalog,
    folder: Path,
    cameras: Sequence[Camera] = (),
    overwrite: bool = False,
    progress: Progress = no_progress,
) -> list[str]:
    """Write the files of a field's catalogue into a folder, made if it is missing; return their names, with those of
    pictures (``draw_things``) if there are cameras."""
    pictures = [_picture_name(thing) for thing in catalog.things] if cameras else []
    files = [GRAPH, TABLE, PAGE, *pictures]
    with staged(folder, files, overwrite) as hidden:
        graph = as_json(catalog.to_dict(), indent=1)
        write_text(hidden / GRAPH, graph + "\n")
        rows = [[_disarmed(cell) for cell in row] for row in catalog_rows(catalog)]
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows(rows)
        write_text(hidden / TABLE, text.getvalue())
        drawn = set[int | None]()
        if cameras:
            (hidden / PICTURES).mkdir()
            progress("pictures", 0, len(catalog.things))
        for thing, picture, *_ in draw_things(field, catalog.things, cameras):
            Image.fromarray(picture).save(hidden / _picture_name(thing), quality=85)
            drawn.add(thing.number)
            progress("pictures", len(drawn), len(catalog.things))
        if cameras:
            progress("pictures", len(catalog.things), len(catalog.things))
        title = field.path.name if field.path else "scene"
        write_text(hidden / PAGE, _page(catalog, drawn, title))
    return files


def _disarmed(cell: Any) -> Any:
    """Return a cell that no spreadsheet reads as a formula; only texts are changed, as numbers may be negative."""
    return f"'{cell}" if isinstance(cell, str) and cell.startswith(_FORMULAS) else cell


def _picture_name(thing: Thing) -> str:
    return f"{PICTURES}/{thing.number:05d}.jpg"


def draw_things(
    field: Field, things: Sequence[Thing], cameras: Sequence[Camera]
) -> Iterator[tuple[Thing, Picture, Camera, tuple[slice, slice]]]:
    """Yield each thing that can be seen, with its picture, and the camera and the window of its view that this shows:
    the camera that sees it largest, else one of its own."""
    seen = [(thing, viewing_cameras(thing, cameras)) for thing in things if cameras]
    seen.sort(key=lambda pair: pair[1][0].name if pair[1] else "")  # so that each camera is rendered once
    view, colors = None, np.zeros((0, 0, 3), np.uint8)
    for thing, viewers in seen:
        for camera in viewers:
            if view is None or view.camera is not camera:
                view = FieldView(field, camera)
                colors = as_picture(view.renders.colors().cpu())
            mask = view.mask_of(thing.gaussians)
            if (window := crop_window(mask)) is not None:
                yield thing, cropped(colors, window, mask), camera, window
                break


def viewing_cameras(thing: Thing, cameras: Sequence[Camera]) -> list[Camera]:
    """Return the camera that sees a thing largest, if any sees it, and one of its own, which looks at it from the side
    of the nearest camera, and from so near that it fills half; none of its own for a thing around that camera."""
    chosen = _best_view(thing, cameras)
    near = min(cameras, key=lambda camera: float((camera.position - thing.position).norm()))
    away = thing.position - near.position
    ahead, size = torch.nn.functional.normalize(away, dim=0), max(thing.size, 1e-3 * float(away.norm()))
    eye = thing.position - ahead * size * near.fx / min(near.width, near.height)
    with suppress(InputError):
        size = (near.width, near.height)
        chosen.append(Camera.look_at(eye, thing.position, "", *size, near.fx, up=-near.viewmat[1, :3]))
    return chosen


def _best_view(thing: Thing, cameras: Sequence[Camera]) -> list[Camera]:
    """Return the camera whose image the thing's box fills most, if any sees its middle."""
    corners = torch.cat([thing.position[None], thing.box.corners()])

    def share(camera: Camera) -> float:
        pixels, depths = camera.pixels(corners)
        if float(depths.min()) <= 0 or not bool(camera.shows(corners[:1])):
            return 0.0
        low, high = pixels.aminmax(dim=0)
        size = pixels.new_tensor([camera.width, camera.height])
        return float(((high / size).clamp(max=1) - low.clamp(min=0) / size).clamp(min=0).prod())

    shares = [share(camera) for camera in cameras]
    return [cameras[shares.index(max(shares))]] if max(shares) > 0 else []


def crop_window(mask: torch.Tensor) -> tuple[slice, slice] | None:
    """Return the rows and columns around a mask [H, W] with a margin; None if it is empty."""
    if (box := mask_box(mask)) is None:
        return None
    x0, y0, x1, y1 = box
    margin = int(MARGIN * (max(x1 - x0, y1 - y0) - 1)) + 8
    return slice(max(0, y0 - margin), y1 + margin), slice(max(0, x0 - margin), x1 + margin)


def cropped(colors: Picture, window: tuple[slice, slice], mask: torch.Tensor | None = None) -> Picture:
    """Return a window of a picture, small, with the mask [H, W] drawn over it."""
    crop = colors[window] if mask is None else mask_overlay(mask.numpy()[window], colors[window])
    picture = Image.fromarray(np.ascontiguousarray(crop))
    picture.thumbnail((SIDE, SIDE))
    return np.asarray(picture)


_CARDS = """{% extends "page" %}{% block body %}
<p><input type="search" placeholder="Filter by name" aria-label="Filter by name"> <select aria-label="Sort by">
<option value="size">sort by size<option value="name">by name</select>
<output>{{ count }}</output></p>
{% for heading, cards in sections.items() %}
{% if loop.last %}<details><summary>{{ heading }}</summary>{% elif heading %}<h2>{{ heading }}</h2>{% endif %}
<ul{% if pairs %} class="pairs"{% endif %}>
{% for card in cards %}
<li data-name="{{ card.thing.text }}" data-size="{{ '%.4g' % card.thing.size }}">
<div>{% for caption, file in card.pictures.items() %}
<figure><img loading="lazy" alt="" src="{{ file }}"><figcaption>{{ caption }}</figcaption></figure>
{% endfor %}</div>
<b>{{ card.thing.title }}</b>
<small>{% for fact in card.facts %}{{ fact }}{{ "" if loop.last else "<br>" | safe }}{% endfor %}</small></li>
{% endfor %}
</ul>{% if loop.last %}</details>{% endif %}
{% endfor %}
<script>const box=document.querySelector("input"),sort=document.querySelector("select");
const lists=[...document.querySelectorAll("ul")],items=[...document.querySelectorAll("li")];
box.addEventListener("input",()=>{const wanted=box.value.toLowerCase();let count=0;
for(const item of items){item.hidden=!item.textContent.toLowerCase().includes(wanted);count+=!item.hidden}
if(wanted)document.querySelector("details").open=true;
document.querySelector("output").textContent=`${count} of ${items.length}`});
sort.addEventListener("change",()=>{for(const list of lists)list.append(...[...list.children].sort((a,b)=>
sort.value==="name"?(a.dataset.name||"\\uffff").localeCompare(b.dataset.name||"\\uffff"):
b.dataset.size-a.dataset.size))});</script>{% endblock %}"""


class Card(NamedTuple):
    """A thing on a page: facts below its name, and files of its pictures by their captions."""

    thing: Thing
    facts: Sequence[str]
    pictures: Mapping[str, str]


def _page(catalog: Catalog, drawn: set[int | None], title: str) -> str:
    text_of: dict[int | None, str] = {thing.number: thing.text for thing in catalog.things}
    parts: dict[int | None, set[str]] = {}
    for thing in catalog.things:
        parts.setdefault(thing.parent, set()).add(thing.text)
    objects = frozenset(catalog.objects)
    cards: tuple[list[Card], list[Card]] = [], []
    ordered = sorted(zip(catalog.things, catalog.names, strict=True), key=lambda pair: -pair[0].size)
    for thing, names in ordered:
        related = [f"thing {thing.number}"] if thing.text else []
        if inside := parts.get(thing.number, set()) - {"", thing.text}:
            related.append(f"with {', '.join(sorted(inside))}")
        if (whole := text_of.get(thing.parent, "")) not in ("", thing.text):
            related.append(f"in {whole}")
        alternatives = [f"perhaps {' or '.join(names[1:])}"] if names[1:] else []
        detected = ["named by a detector"] if thing.named_by == "detector" else []
        size = thing.world.lengths(thing.box.extent.tolist())
        facts = [*detected, *alternatives, size, *([", ".join(related)] if related else [])]
        pictures = {"": _picture_name(thing)} if thing.number in drawn else {}
        cards[thing.number not in objects].append(Card(thing, facts, pictures))
    sections = {"": cards[0], f"Parts, groups and fragments ({len(cards[1])})": cards[1]}
    return cards_page(f"Things of {title}", f"{len(catalog.things)} things", sections)


def cards_page(title: str, count: str, sections: Mapping[str, Sequence[Card]], pairs: bool = False) -> str:
    """Return a page of lists of cards by heading, the last folded, with a box that filters them; it loads nothing but
    its pictures. ``pairs`` is of pictures."""
    return html(_CARDS, title=title, count=count, sections=sections, pairs=pairs)
