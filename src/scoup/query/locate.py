"""The place of a thing in the world: position and upright box of the Gaussians that answer a query."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from scoup.base.html import card
from scoup.base.records import rounded_vector
from scoup.query.answer import SceneAnswer
from scoup.query.coded_scene import CodedScene
from scoup.query.select import true_rows
from scoup.query.thing_shapes import OrientedBox, ThingPoints
from scoup.query.things import things_in_mask
from scoup.raster import morton_codes
from scoup.scene.neighbours import linked_parts, nearest_points
from scoup.scene.up import estimate_up

NEIGHBOURS = 8
"""Each Gaussian of an answer is linked to so many of its nearest others in the answer."""
LONGEST_LINK = 3.0
"""Links longer than this times the median are cut, so that strays fall off."""

MOST_LINKED = 8192
"""Of more Gaussians than these, the cells of a grid are linked instead."""


@dataclass(frozen=True, eq=False, repr=False)
class Location:
    """The place of a thing in the world. Tensors are on the CPU.

    Example:
        >>> field = scoup.LanguageField.load("f.scoup")
        >>> place = field.location(field.question("kettle", always=True))
        >>> place.position.shape
        torch.Size([3])
    """

    position: Tensor | None
    """[3] float64 world units, the median of the thing's Gaussians; None if it is not there."""
    box: OrientedBox | None
    """Around these Gaussians; None if the thing is not there."""
    confidence: float
    """Mean relevancy of these Gaussians, 0..1, where 0.5 is a draw with the canonical phrases; 0 if the thing is not
    there."""
    gaussians: Tensor
    """[M] int64, the thing: the connected part of the answer that weighs most."""
    answer: SceneAnswer
    """All Gaussians that answer, with level, score and presence."""
    things: tuple[int, ...] = ()
    """Numbers of the things that answer (``field.things`` describes them); empty where the votes answer."""

    def __repr__(self) -> str:
        if self.position is None or self.box is None:
            return f"Location({self.answer.text!r}: not in this scene)"
        return (
            f"Location({self.answer.text!r} at {_rounded(self.position)}, extent {_rounded(self.box.extent)}, "
            f"confidence {self.confidence:.2f}, {len(self.gaussians):,} Gaussians)"
        )

    def _repr_html_(self) -> str:
        facts = {name: value for name, value in self.record().items() if name != "box"}
        if self.box is not None:
            facts |= self.box.record()
        return card(f"{self.answer.text!r} in the world", facts)

    @property
    def presence(self) -> bool:
        """Return whether the thing is there; true if that was not judged and any Gaussian answers."""
        return self.position is not None

    def said(self, metres_per_unit: float | None = None) -> str:
        """Return position, extent and confidence in a few words; in metres, too, if the length of the unit is known."""
        if self.position is None or self.box is None:
            return "nowhere"
        extent = " x ".join(f"{side:.3g}" for side in self.box.extent.tolist())
        if metres_per_unit is not None:
            extent += (
                f" ({' x '.join(f'{side * metres_per_unit:.3g}' for side in self.box.extent.tolist())} m)"
            )
        position = ", ".join(f"{part:g}" for part in _rounded(self.position))
        numbers = f", thing {', '.join(map(str, self.things))}" if self.things else ""
        return f"[{position}], extent {extent}, confidence {self.confidence:.2f}{numbers}"

    def record(self, metres_per_unit: float | None = None) -> dict[str, Any]:
        """Return the location as plain JSON values, rounded; in metres, too, if the length of the unit is known."""
        return {
            **metres_record(self.position, self.box, metres_per_unit),
            "position": None if self.position is None else _rounded(self.position),
            "box": None if self.box is None else self.box.record(),
            "confidence": round(self.confidence, 4),
            "gaussians": len(self.gaussians),
            "things": list(self.things),
            **{name: value for name, value in self.answer.record().items() if name != "gaussians"},
        }


def location(field: CodedScene, answer: SceneAnswer) -> Location:
    """Return the place of an answer of ``answer_scene``.

    The thing is the connected part (``rough_parts``) of its Gaussians that weighs most. A Gaussian weighs its
    opacity times its relevancy.
    """
    members = true_rows(answer.mask)
    rows = members.to(field.gaussians.device)
    means, scales, opacities = (
        part.index_select(0, rows).cpu()  # much faster than part[rows]
        for part in (field.gaussians.means, field.gaussians.scales, field.gaussians.opacities)
    )
    if not (torch.isfinite(means).all() and torch.isfinite(scales).all()):
        usable = torch.isfinite(means).all(1) & torch.isfinite(scales).all(1)
        members, means, opacities = members[usable], means[usable], opacities[usable]
    means, relevancy = means.double(), answer.relevancy.index_select(0, members).double()
    weights = opacities.double().clamp(0, 1) * relevancy
    if not len(members) or not weights.any():
        return Location(None, None, 0.0, members[:0], answer)
    parts = torch.from_numpy(rough_parts(means.numpy()))
    part = int(torch.bincount(parts, weights).argmax())
    own = true_rows(parts == part)
    members, means, weights, relevancy = (
        each.index_select(0, own) for each in (members, means, weights, relevancy)
    )
    points = ThingPoints.of_one_thing(means, weights)
    position, box = torch.from_numpy(points.medians()[0]), points.boxes(estimate_up(field.cameras or ()))[0]
    confidence = float((relevancy * weights).sum() / weights.sum())
    things = answering_things(field, answer.mask, answer.level, answer.threshold)
    numbers = () if things is None else tuple(things.tolist())
    return Location(position, box, confidence, members, answer, numbers)


def answering_things(
    field: CodedScene, mask: Tensor, level: str | int, threshold: float | None
) -> Tensor | None:
    """Return the numbers [M] int64 of the things that a selection ``mask`` [N] at a level consists of; None where the
    votes answer (by a threshold), or the field has no things."""
    if field.thing_table is None or threshold is not None:
        return None
    return things_in_mask(field.thing_table, mask, field.level_index(level))


def metres_record(
    position: Tensor | None, box: OrientedBox | None, metres_per_unit: float | None
) -> dict[str, Any]:
    """Return a place in metres as plain JSON values; nothing if it, or the length of the scene's unit, is not known."""
    if position is None or box is None or metres_per_unit is None:
        return {}
    return {
        "position_metres": _rounded(position * metres_per_unit),
        "extent_metres": _rounded(box.extent * metres_per_unit),
    }


def connected_parts(points: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the number [M] of the connected part of each point [M, 3].

    Each point is linked to its nearest others, and links much longer than usual are cut.
    """
    count = min(NEIGHBOURS, len(points) - 1)
    if count < 1:
        return np.zeros(len(points), np.int64)
    nearest, lengths = nearest_points(points, count)
    return linked_parts(nearest, lengths, LONGEST_LINK * float(np.median(lengths[:, -1])))


def rough_parts(points: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return ``connected_parts`` of points [M, 3], or where they are many, of the cells of a grid that they fill."""
    if len(points) <= MOST_LINKED:
        return connected_parts(points)
    places, order = morton_codes(torch.from_numpy(points))[0].sort()
    differing = places[1:] ^ places[:-1]
    coarser = bisect_left(
        range(21), True, key=lambda step: int((differing >> 3 * step > 0).sum()) < MOST_LINKED
    )
    cells = torch.empty_like(order)
    cells[order] = torch.nn.functional.pad(differing >> 3 * coarser > 0, (1, 0)).cumsum(0)
    own = cells.numpy()
    middles = np.stack([np.bincount(own, axis) for axis in points.T], 1) / np.bincount(own)[:, None]
    return connected_parts(middles)[own]


def _rounded(vector: Tensor) -> list[float]:
    return rounded_vector(vector.tolist())
