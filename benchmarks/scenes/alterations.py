"""Other versions of a thing: another name, other colours, more or fewer Gaussians."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from scoup_lab.synthetic.art.paints import Paint
from scoup_lab.synthetic.art.things import Piece, Thing


def called(thing: Thing, name: str) -> Thing:
    """Return the thing under another name, and its parts under names that say whose they are.

    Called "green mug", the mug's "mug body" is the "green mug body", and its "coffee" the "coffee of the green
    mug"; the "bear head" of a teddy bear that is called "brown bear" is the "brown bear head".
    """
    return replace(
        thing,
        name=name,
        pieces=tuple(replace(piece, part=_part(piece.part, thing.name, name)) for piece in thing.pieces),
    )


def _part(part: str, old: str, new: str) -> str:
    for start in (old, old.split()[-1], new, new.split()[-1]):
        if part == start:
            return new
        if part.startswith(f"{start} "):
            return new + part[len(start) :]
    return f"{part} of the {new}"


def painted(thing: Thing, paints: Mapping[str, Paint]) -> Thing:
    """Return the thing with other paints for the first piece of some parts; the others are details, such as the
    eyes on a head, and stay as they are."""
    left, pieces = dict(paints), []
    for piece in thing.pieces:
        pieces.append(replace(piece, paint=left.pop(piece.part, piece.paint)))
    return replace(thing, pieces=tuple(pieces))


def finer(thing: Thing, factor: float) -> Thing:
    """Return the thing with ``factor`` times the detail: few see a thing far off, so that it needs fewer Gaussians."""
    return replace(
        thing, pieces=tuple(replace(piece, detail=piece.detail * factor) for piece in thing.pieces)
    )


def several(*things: Thing) -> tuple[Thing, ...]:
    """Return things of one name, such as four chairs, as the several instances of one object that they are."""
    return tuple(replace(thing, several=True) for thing in things)


def plain(name: str, *pieces: Piece) -> Thing:
    """Return a thing whose pieces are all the same part, named as itself."""
    return Thing(name, tuple(replace(piece, part=name) for piece in pieces))


def broader(thing: Thing, factor: float) -> Thing:
    """Return the thing with ``factor`` times the limit on the size of its Gaussians. The limit is made for a
    table-top; where a scene is larger and the same number of Gaussians lie further apart, it would leave
    holes."""
    return replace(thing, pieces=tuple(replace(piece, thin=piece.thin * factor) for piece in thing.pieces))
