"""A catalogue of a scene: every thing with a name, place and box, and the relations between things."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from scoup.base import InputError, rounded_vector
from scoup.field import Field
from scoup.query.frame import Frame, scene_frame
from scoup.query.question import Question
from scoup.query.relations import overlaps, related_pairs, relations
from scoup.query.thing_names import find_objects, named_things, thing_names
from scoup.query.things import Thing

SCHEMA = "scoup scene graph"


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
