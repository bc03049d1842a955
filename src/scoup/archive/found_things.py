"""What a search in an archive finds."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from torch import Tensor

from scoup.archive.scan_header import OwnColumns
from scoup.base import WorldFrame, rounded_vector
from scoup.query import Certainty, LanguageField, OrientedBox


@dataclass(frozen=True, eq=False)
class FoundThing:
    """A thing of a scan that answers."""

    scan: str
    """Name of the scan."""
    thing: int
    """Its number in the field of the scan (``Thing.number``)."""
    text: str
    """The text that it answers, or the name of the image's file."""
    level: str
    """Name of its level."""
    score: float | None
    """As of ``Thing``: the share of everyday words whose best fit in its scan is lower, 0 to 1. Of an image: the cosine
    with it."""
    certainty: Certainty | None
    """Of the answer of its scan, as of ``Answer``; None for an image."""
    position: Tensor
    """[3] float64 in the units of its scan."""
    box: OrientedBox
    """Around it."""
    n_gaussians: int
    """How many Gaussians it has."""
    columns: OwnColumns
    """What was said of the scan when it was added."""
    field_path: Path
    """File of the scan's field."""
    world: WorldFrame
    """Of its scan, when it was added."""
    runner_up: int | None = None
    """Number of the best other thing of the scan, beside the first that answers there, if it fits nearly as well."""

    def field(self) -> LanguageField:
        """Load the field of the scan."""
        return LanguageField.load(self.field_path)

    def describe(self) -> str:
        """Return scan, number, position and extent in words, for people."""
        place = self.world.place(self.position.tolist(), self.box.extent.tolist())
        runner_up = "" if self.runner_up is None else f", or thing {self.runner_up}"
        return f"{self.scan}, thing {self.thing}, level {self.level}, at {place}{runner_up}"

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values, rounded."""
        return {
            "scan": self.scan,
            "thing": self.thing,
            "text": self.text,
            "level": self.level,
            "score": None if self.score is None else round(self.score, 4),
            "certainty": self.certainty,
            "position": rounded_vector(self.position.tolist()),
            "box": self.box.to_dict(),
            **self.world.metres(self.position.tolist(), self.box.extent.tolist()),
            "gaussians": self.n_gaussians,
            "runner_up": self.runner_up,
            "columns": dict(self.columns),
            "field": str(self.field_path),
        }


class FoundThings(list[FoundThing]):
    """Things, best first."""

    n_answers: int | None = None
    """How many answer in all; None if they were not counted, as the rest cannot be better."""
