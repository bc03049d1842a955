"""A catalogue of a scene: every thing with a name, place and box, and how things stand to each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from torch import Tensor

from scoup.base.errors import InputError
from scoup.base.html import card
from scoup.query.coded_scene import CodedScene
from scoup.query.frame import Frame, scene_frame
from scoup.query.question import Question
from scoup.query.relations import related_pairs
from scoup.query.relevancy import relevancy
from scoup.query.scene_things import Thing, all_things

NAMES = 3
"""Names kept per thing: the best and the next best ones."""
HUB_THINGS, HUB_SHARE = 10, 0.5
"""Some words are near to many things: this share of the mean of a word's so many largest cosines is subtracted from all
of them (cross-domain similarity local scaling, Conneau et al. 2018)."""
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
    """Every thing with its best name as ``text``, finer levels first; ``confidence`` is the relevancy of the name to
    the mean embedding of its regions."""
    names: tuple[tuple[str, ...], ...]
    """Up to three names per thing, best first."""
    relations: tuple[tuple[int, str, int], ...]
    """(number of a thing, "on" or "inside", number of another of its level)."""
    frame: Frame
    """What up means."""

    def __repr__(self) -> str:
        return f"Catalog({len(self.things)} things, {len(self.relations)} relations)"

    def _repr_html_(self) -> str:
        return card(f"{len(self.things)} things", {str(thing.number): thing.text for thing in self.things})

    def record(self, metres_per_unit: float | None = None) -> dict[str, Any]:
        """Return the scene graph as plain JSON values (docs/formats.md, "Scene graph")."""
        things = [
            {**thing.record(metres_per_unit), "names": list(names)}
            for thing, names in zip(self.things, self.names, strict=True)
        ]
        relations = [{"thing": one, "relation": what, "to": other} for one, what, other in self.relations]
        return {
            "format": SCHEMA,
            "version": 1,
            "frame": self.frame.record(),
            "things": things,
            "relations": relations,
        }


def make_catalog(field: CodedScene, question: Question, frame: Frame | None = None) -> Catalog:
    """Return every thing of a field with the best of several words; ``field.catalog`` calls this.

    Args:
        field: with a table of things.
        question: the words, from ``field.question``.
        frame: what up means; by default ``scene_frame``.
    """
    table = field.thing_table
    if table is None:
        raise InputError(
            f"{field.path or 'this field'}: contains no things; build it again with things, from its photographs"
        )
    frame = scene_frame(field) if frame is None else frame
    things = all_things(field)
    embeddings = table.embeddings.float().cpu()[[thing.number or 0 for thing in things]]
    cosines, canonical = embeddings @ question.queries.cpu().T, embeddings @ question.canonical.cpu().T
    best = best_words(cosines)
    sure = relevancy(cosines, canonical).gather(1, best)[:, 0]
    names = tuple(tuple(question.texts[word] for word in row) for row in best.tolist())
    named = tuple(
        replace(thing, text=own[0], confidence=confidence)
        for thing, own, confidence in zip(things, names, sure.tolist(), strict=True)
    )
    return Catalog(named, names, tuple(related_pairs(field, named, frame)), frame)


def best_words(cosines: Tensor) -> Tensor:
    """Return the up to ``NAMES`` words that name each thing best, [T, n] int64, from cosines [T, Q] of both."""
    hubs = cosines.topk(min(HUB_THINGS, len(cosines)), dim=0).values.sum(0) / max(
        1, min(HUB_THINGS, len(cosines))
    )
    return (cosines - HUB_SHARE * hubs).topk(min(NAMES, cosines.shape[1]), dim=1).indices


def catalog_rows(catalog: Catalog, metres_per_unit: float | None = None) -> list[list[Any]]:
    """Return the things as rows of a table, the first with the names of the columns."""
    unit = 1.0 if metres_per_unit is None else metres_per_unit
    head = ["thing", "name", "other names", "level", "parent", "confidence"]
    rows: list[list[Any]] = [[*head, "x", "y", "z", "length", "width", "height", "gaussians", "regions"]]
    for thing, names in zip(catalog.things, catalog.names, strict=True):
        numbers: Sequence[float] = [
            *(thing.position * unit).tolist(),
            *(thing.box.extent * unit).tolist(),
        ]
        parent = "" if thing.parent is None else thing.parent
        confidence = round(thing.confidence or 0.0, 4)
        facts = [thing.number, thing.text, "; ".join(names[1:]), thing.level, parent, confidence]
        rows.append([*facts, *np.round(numbers, 6).tolist(), thing.n_gaussians, thing.n_regions])
    return rows
