"""All answers of a field to one text: in its views, and in the world."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from torch import Tensor

from scoup.base.html import card
from scoup.base.records import rounded_vector
from scoup.pictures import as_picture
from scoup.query.answer import Answer
from scoup.query.locate import Location


@dataclass(frozen=True, eq=False, repr=False)
class Finding:
    """The answers to one text in the views of some cameras, and its place in the world.

    Example:
        >>> field = scoup.LanguageField.load("f.scoup")
        >>> finding = field.finding(field.question("kettle", always=True))
        >>> finding.text, len(finding.answers)
        ('kettle', 4)
    """

    text: str
    """What was asked."""
    answers: tuple[Answer, ...]
    """One per camera, in their order."""
    location: Location
    """Where the thing is in the world."""

    def __repr__(self) -> str:
        seen = sum(answer.presence for answer in self.answers)
        return f"Finding({self.text!r}: in {seen} of {len(self.answers)} views; {self.location!r})"

    def _repr_html_(self) -> str:
        facts = {name: value for name, value in self.location.record().items() if name != "box"}
        best = self.best
        picture = None if best is None else as_picture(best.pictures()["overlay"])
        return card(f"{self.text!r}, best seen in {best.view if best else 'no view'}", facts, picture)

    @property
    def presence(self) -> bool:
        """Return whether the thing is in the scene or in a view."""
        return self.location.presence or any(answer.presence for answer in self.answers)

    @property
    def best(self) -> Answer | None:
        """The answer in the best view: present there, with the largest score; None without a camera."""
        return max(self.answers, key=lambda answer: (answer.presence, answer.score), default=None)

    @property
    def position(self) -> Tensor | None:
        """The middle of the thing, [3] float64 world units; None if it is not there."""
        return self.location.position

    @property
    def confidence(self) -> float:
        """Confidence of the location, 0..1; 0.5 is a draw with the canonical phrases."""
        return self.location.confidence


def answer_record(answer: Answer) -> dict[str, Any]:
    """Return an answer as `scoup query` writes it into query.json: its record, and the position of its mask."""
    position = answer.position
    return {**answer.record(), "position": None if position is None else rounded_vector(position.tolist())}
