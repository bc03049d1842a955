"""The place of an answer in the world: that of its best thing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from torch import Tensor

from scoup.field import Field
from scoup.query.answer import Answer
from scoup.query.boxes import OrientedBox
from scoup.query.things import Thing, things_of_answer


@dataclass(frozen=True, eq=False, repr=False)
class Place:
    """The place of an answer in the world. Tensors are on the CPU.

    Example:
        >>> field = scoup.LanguageField.load("f.scoup")
        >>> place = field.location(field.question("kettle", always=True))
        >>> place.position.shape
        torch.Size([3])
    """

    answer: Answer
    """All that answers, with level, score and presence."""
    thing: Thing | None
    """The first of ``field.things``; None if it is not there."""

    @property
    def position(self) -> Tensor | None:
        """[3] float64 world units, the median of the thing's Gaussians; None if it is not there."""
        return None if self.thing is None else self.thing.position

    @property
    def box(self) -> OrientedBox | None:
        """Around the thing; None if it is not there."""
        return None if self.thing is None else self.thing.box

    @property
    def presence(self) -> bool:
        """True if the thing is there, or if that was not judged and any Gaussian answers."""
        return self.thing is not None

    def __repr__(self) -> str:
        return f"Place({self.answer.text!r}: {self.describe()})"

    def describe(self) -> str:
        """Return how many things it is, the place of the first, and the score, in a few words."""
        if self.thing is None:
            return self.answer.remark()
        first = ", the first" if len(self.answer.things) > 1 else ""
        return f"{self.answer.counted()}{first} at {self.thing.describe()}, {self.answer.remark()}".lstrip()

    def to_dict(self) -> dict[str, Any]:
        """Return the place as plain JSON values, rounded; in metres, too, as of ``Thing``."""
        kept = "position_metres", "extent_metres", "position", "box"
        thing = {} if self.thing is None else self.thing.to_dict()
        place = {name: thing[name] for name in kept if name in thing} or {"position": None, "box": None}
        return {**place, **self.answer.to_dict()}


def place_of(field: Field, answer: Answer) -> Place:
    """Return the place of an answer."""
    return Place(answer, next(iter(things_of_answer(field, answer)), None))
