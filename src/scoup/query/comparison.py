"""Differences between two captures of one place: objects that were added, removed or moved.

Two builds cut one place into things differently, so a thing of one capture is not compared with things of the other,
but with its Gaussians: it is still there if its own lie on Gaussians whose things look like it. Things that are not
there are one object if they lie in the box of the largest of them. It has gone only if cameras of the other capture
look through its place, or at something else in it. An object gone from one place and a new one elsewhere that look
alike, one to one, are one that moved. Ours; measured in docs/many_scenes.md.

The files of a comparison are JSON, pictures from before and after, and a page.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image

from scoup.base import (
    InputError,
    Progress,
    ScoupWarning,
    WorldFrame,
    as_json,
    counted,
    no_progress,
    rounded_vector,
    staged,
    write_text,
)
from scoup.field import NO_THING, Field
from scoup.pictures import Picture, as_picture
from scoup.query import constants
from scoup.query.catalog import PAGE, PICTURES, Card, cards_page, cropped, draw_things
from scoup.query.field_view import FieldView
from scoup.query.language_field import LanguageField
from scoup.query.registration import Array, Capture, Registration, centred, moved_points, register, scale_of
from scoup.query.thing_names import find_objects, named_things
from scoup.query.things import Thing
from scoup.query.view_answer import render_depth

SCHEMA = "scoup comparison"

Kind = Literal["added", "removed", "moved", "unseen"]
KINDS: tuple[Kind, ...] = ("added", "removed", "moved", "unseen")
RECORD = "compare.json"
SIDES = ("old", "new")
TITLES: dict[str, str] = {
    **{kind: kind.capitalize() for kind in KINDS},
    "unseen": "In one capture only, at a place that the other did not see",
}


@dataclass(frozen=True, eq=False)
class Change:
    """An object that is not where it was."""

    kind: Kind
    """Unseen: it is in one capture only, and the other did not see its place."""
    old: Thing | None
    """In the frame of the old capture."""
    new: Thing | None
    """In the frame of the new capture."""
    distance: float | None
    """How far it moved, in units of the old capture."""
    confidence: float
    """0 to 1: the share of it that is not there, times the share of its place that was seen (for unseen, was not); if
    it moved, of the surer side, times its cosine with what it was."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """The changes between two captures of one place."""

    changes: tuple[Change, ...]
    """By kind, the surest first."""
    counts: tuple[int, int]
    """Objects of the old and of the new capture."""
    registration: Registration
    """Of their frames."""
    world: WorldFrame
    """That of the old capture."""

    def describe(self, change: Change) -> str:
        """Return the kind of a change in words, and how far the object moved."""
        far = "" if change.distance is None else f" by {self.world.lengths([change.distance])}"
        return change.kind + far

    def to_dict(self) -> dict[str, Any]:
        """Return the comparison as plain JSON values, rounded; in metres, too, if the old capture knows its unit."""
        changes = []
        for change in self.changes:
            record: dict[str, Any] = {"kind": change.kind, "confidence": round(change.confidence, 4)}
            if change.distance is not None:
                (record["distance"],) = rounded_vector([change.distance], 6)
                if (unit := self.world.metres_per_unit) is not None:
                    record["distance_metres"] = round(change.distance * unit, 6)
            sides = {"old": change.old, "new": change.new}
            changes.append(record | {side: thing and thing.to_dict() for side, thing in sides.items()})
        return {
            "format": SCHEMA,
            "version": 1,
            **self.registration.to_dict(),
            "objects": {"old": self.counts[0], "new": self.counts[1]},
            "changes": changes,
        }


def compare(
    old: LanguageField, new: LanguageField, words: Sequence[str], transform: Array | None = None
) -> Comparison:
    """Return the objects that were added, removed or moved between two captures of one place.

    Args:
        old, new: with things and cameras, and embeddings of one model.
        words: that name the things (``LanguageField.naming_question``).
        transform: [4, 4] similarity from the frame of ``new`` to that of ``old``; None: things of both give it.

    Raises:
        InputError: a field has no things or cameras, the embeddings are of two models, or too few things agree.
    """
    _check(old, new)
    named = [named_things(field, field.naming_question(words)) for field in (old, new)]
    both = Capture(old, named[0]), Capture(new, named[1])
    centre = np.concatenate([capture.embeddings for capture in both]).mean(0)
    registration = register(*both, centre, transform)
    if not registration.plausible:
        _refuse(old, new, registration)
    matrix = registration.transform
    gone = _missing(*both, np.linalg.inv(matrix), centre)
    come = _missing(both[1], both[0], matrix, centre)
    changes = sorted(
        _changes(gone, come, matrix), key=lambda change: (KINDS.index(change.kind), -change.confidence)
    )
    counts = len(find_objects(old, named[0])), len(find_objects(new, named[1]))
    unit = old.world.metres_per_unit
    if new.world.metres_per_unit is None and unit is not None:
        world = replace(new.world, metres_per_unit=unit * scale_of(matrix))
        changes = [replace(one, new=one.new and replace(one.new, world=world)) for one in changes]
    return Comparison(tuple(changes), counts, registration, old.world)


def _refuse(old: Field, new: Field, registration: Registration) -> None:
    """Raise an error, or warn if the transform was passed."""
    agree = f"{registration.agreeing} of {registration.things} things agree"
    if registration.source != "transform passed":
        raise InputError(
            f"{_name(new)}: cannot be registered with {_name(old)} ({agree}); check that both show one place, or pass "
            "`transform`"
        )
    warnings.warn(
        f"{_name(new)}: `transform` does not fit {_name(old)} ({agree}); omit it to register the frames",
        ScoupWarning,
        stacklevel=3,
    )


def _name(field: Field) -> str:
    return str(field.path or "this field")


def _check(old: Field, new: Field) -> None:
    for field in (old, new):
        lacks = "things" if field.thing_table is None else "cameras, which say what it saw"
        if field.thing_table is None or not field.cameras:
            raise InputError(f"{_name(field)}: contains no {lacks}; build it from photographs")
    models = [
        f"{field.embedding_model or 'an unnamed model'} ({field.dim} dimensions)" for field in (old, new)
    ]
    if models[0] != models[1]:
        raise InputError(
            f"{_name(new)}: contains embeddings of {models[1]}, {_name(old)} of {models[0]}; build both with one model"
        )


@dataclass(frozen=True, eq=False)
class _Missing:
    """An object that is not there in the other capture."""

    things: list[Thing]  # it and its parts at all levels, largest first
    looks: Array  # [T, D] of each
    absent: float  # share of the first that is missing
    seen: float  # share of its place that the other capture saw

    def change(self, kind: Literal["added", "removed"]) -> Change:
        """Return it as a change by itself, preferably a named thing."""
        most = [thing for thing in self.things if 2 * thing.n_gaussians >= self.things[0].n_gaussians]
        thing = next((thing for thing in most if thing.text), self.things[0])
        old, new = (thing, None) if kind == "removed" else (None, thing)
        if self.seen < constants.SEEN:
            return Change("unseen", old, new, None, self.absent * (1 - self.seen))
        return Change(kind, old, new, None, self.absent * self.seen)


def _missing(one: Capture, other: Capture, to_other: Array, centre: Array) -> list[_Missing]:
    """Return the objects missing from the other capture; things in the box of a larger one belong to it."""
    if not one.things:
        return []
    points, things = one.points, one.things
    places = moved_points(points.means, to_other)
    # [M] up to which distance, in the other's units, each point lies on another.
    sizes = np.array([thing.size * max(constants.REACH, thing.n_gaussians**-0.5) for thing in things])
    reach = sizes[points.owners] * scale_of(to_other)
    absent = 1 - _present(one, other, places, reach, centre)
    together: dict[int, list[int]] = {}
    gone = np.flatnonzero(absent >= constants.GONE).tolist()
    for index in sorted(gone, key=lambda index: -things[index].n_gaussians):
        around = (first for first in together if things[first].box.contains(things[index].position))
        together.setdefault(next(around, index), []).append(index)
    together = {
        first: indices
        for first, indices in together.items()
        if sum(things[index].n_regions or 0 for index in indices) >= constants.GONE_REGIONS
    }
    asked = np.isin(points.owners, [*together])
    seen = _seen(other, places[asked], reach[asked])
    weights = np.zeros(len(asked))
    weights[asked] = points.weights[asked] * seen
    seen = points.sums(weights) / points.sums(points.weights).clip(1e-12)
    looks = centred(one.embeddings, centre)
    return [
        _Missing(
            [things[index] for index in indices],
            looks[[things[index].number or 0 for index in indices]],
            float(absent[first]),
            float(seen[first]),
        )
        for first, indices in together.items()
    ]


def _present(one: Capture, other: Capture, places: Array, reach: Array, centre: Array) -> Array:
    """Return the share of each thing [T] that lies on things like it in the other capture."""
    numbers = np.array([thing.number for thing in one.things], np.int64)
    cosines = centred(one.embeddings, centre)[numbers] @ centred(other.embeddings, centre).T
    alike = np.pad(
        ((cosines - constants.LIKE[0]) / (constants.LIKE[1] - constants.LIKE[0])).clip(0, 1), ((0, 0), (0, 1))
    )  # last: NO_THING
    points, table = one.points, other.field.thing_table
    assert table is not None
    nearest = other.tree.query(places, k=min(constants.NEAREST, len(other.solid)))
    distances, near = (np.asarray(array).reshape(len(points.means), -1) for array in nearest)
    owners = table.owners.cpu().numpy()[other.solid[near]]  # [M, k, S]
    likeness = alike[points.owners[:, None, None], owners].max(2)
    likeness = np.where((owners == NO_THING).all(2), 1.0, likeness)  # Gaussians of no thing may match any
    on = np.where(distances <= reach[:, None], likeness, 0.0).max(1)
    return points.sums(points.weights * on) / points.sums(points.weights).clip(1e-12)


def _seen(other: Capture, places: Array, reach: Array) -> NDArray[np.bool_]:
    """Return the places [M] at which, or through which, a camera of the other capture looks."""
    points, seen = torch.from_numpy(places), np.zeros(len(places), bool)
    for camera in other.field.cameras or ():
        small = camera.scaled(min(1.0, constants.DEPTH_SIDE / max(camera.width, camera.height)))
        pixels, depths = (tensor.numpy() for tensor in small.pixels(points))
        inside = small.shows(points).numpy() & ~seen
        if inside.any():
            depth = render_depth(other.field.project(small), other.field.gaussians, small).numpy()
            columns, rows = pixels[inside].astype(int).T
            seen[inside] = ~(depth[rows, columns] < depths[inside] - reach[inside])  # NaN: nothing is there
    return seen


def _changes(gone: Sequence[_Missing], come: Sequence[_Missing], matrix: Array) -> list[Change]:
    """Return the objects that moved, matched one to one, and all others by themselves."""
    from scipy.optimize import linear_sum_assignment

    scale, cosines, best = scale_of(matrix), np.zeros((len(gone), len(come))), {}
    for (one, old), (other, new) in product(enumerate(gone), enumerate(come)):
        growth = scale * np.array([t.size for t in new.things]) / [[t.size] for t in old.things]
        fit = np.where(
            (growth <= constants.RESIZED) & (growth >= 1 / constants.RESIZED), old.looks @ new.looks.T, 0
        )
        if fit.max() >= constants.LIKE[1] and max(old.seen, new.seen) >= constants.SEEN:
            cosines[one, other] = fit.max()
            first, second = np.argwhere(fit >= constants.LIKE[1])[0]  # the largest
            best[one, other] = old.things[first], new.things[second]
    pairs = [
        pair for pair in zip(*linear_sum_assignment(cosines, maximize=True), strict=True) if pair in best
    ]
    changes = []
    for pair in pairs:
        old, new = best[pair]
        position = moved_points(new.position.numpy(), matrix)
        distance = float(np.linalg.norm(position - old.position.numpy()))
        if distance > constants.STILL * old.size:
            sure = max(missing.absent * missing.seen for missing in (gone[pair[0]], come[pair[1]]))
            changes.append(Change("moved", old, new, distance, float(cosines[pair]) * sure))
    paired = [{pair[side] for pair in pairs} for side in (0, 1)]
    changes += [missing.change("removed") for index, missing in enumerate(gone) if index not in paired[0]]
    return changes + [missing.change("added") for index, missing in enumerate(come) if index not in paired[1]]


def save_comparison(
    old: Field,
    new: Field,
    comparison: Comparison,
    folder: Path,
    overwrite: bool = False,
    progress: Progress = no_progress,
) -> list[str]:
    """Write the files of a comparison of two fields into a folder; return their names, but for those of pictures."""
    files = [RECORD, PAGE]
    with staged(folder, files, overwrite) as hidden:
        record = as_json(comparison.to_dict(), indent=1)
        write_text(hidden / RECORD, record + "\n")
        (hidden / PICTURES).mkdir()
        cards: dict[str, list[Card]] = {kind: [] for kind in KINDS}
        for number, change in enumerate(comparison.changes):
            progress("pictures", number, len(comparison.changes))
            names = {}
            for side, picture in _pictures(old, new, change, comparison):
                names[side] = f"{PICTURES}/{number:04d}_{side}.jpg"
                Image.fromarray(picture).save(hidden / names[side], quality=85)
            cards[change.kind].append(_card(change, names, comparison))
        progress("pictures", len(comparison.changes), len(comparison.changes))
        heading = " and ".join(field.path.name if field.path else "a field" for field in (old, new))
        count = counted(len(comparison.changes) - len(cards["unseen"]), "change")
        sections = {f"{title} ({len(cards[kind])})": cards[kind] for kind, title in TITLES.items()}
        count = f"{count}; {comparison.registration.describe()}"
        content = cards_page(f"Changes between {heading}", count, sections, pairs=True)
        write_text(hidden / PAGE, content)
    return files


def _card(change: Change, pictures: Mapping[str, str], comparison: Comparison) -> Card:
    sides = zip(SIDES, (change.old, change.new), strict=True)
    there = [(side, thing) for side, thing in sides if thing is not None]
    _, thing = there[-1]
    facts = (
        f"{comparison.describe(change)}, confidence {change.confidence:.2f}",
        thing.world.lengths(thing.box.extent.tolist()),
        ", ".join(f"thing {thing.number} of the {side} capture" for side, thing in there),
    )
    return Card(thing, facts, dict(sorted(pictures.items(), reverse=True)))


def _pictures(
    old: Field, new: Field, change: Change, comparison: Comparison
) -> Iterator[tuple[str, Picture]]:
    """Yield the object before and after; where it is not there, its place from the same camera."""
    transform = comparison.registration.transform
    sides = (old, change.old, new, np.linalg.inv(transform)), (new, change.new, old, transform)
    for index, (field, thing, other, to_other) in enumerate(sides):
        drawn = draw_things(field, [] if thing is None else [thing], list(field.cameras or ()))
        for _, picture, camera, window in drawn:
            yield SIDES[index], picture
            if change.kind != "moved":
                scale = scale_of(to_other)
                moved = camera.moved(to_other[:3, :3] / scale, to_other[:3, 3] / scale, scale)
                colors = FieldView(other, moved).renders.colors()
                yield SIDES[1 - index], cropped(as_picture(colors.cpu()), window)
