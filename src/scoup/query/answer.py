"""The answer to a text, decided once, in the scene."""

from __future__ import annotations

import copy
from collections import Counter
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import torch
from torch import Tensor

from scoup.base.counts import listed
from scoup.base.errors import InputError
from scoup.base.html import card
from scoup.query.presence import LEAST_GAUSSIANS, Certainty, certainty

if TYPE_CHECKING:
    from scoup.field.language_field import LanguageField
    from scoup.query.question import Question
    from scoup.query.things import Thing
    from scoup.query.view_answer import ViewAnswer
    from scoup.scene.cameras import Camera


class RunnerUp(NamedTuple):
    """The next best thing."""

    thing: int
    """Its number."""
    score: float | None
    """As of ``Answer``: the difference says by how much it is worse."""


@dataclass(frozen=True, eq=False)
class AskedText:
    """A text of an answer, and the level that answers it."""

    question: Question  # of one text
    level: int


@dataclass(frozen=True, eq=False, repr=False)
class Answer:
    """The answer of a scene to one text, or to an expression. Tensors are on the CPU.

    Example:
        >>> field = scoup.LanguageField.load("f.scoup")
        >>> answer = field.answer(field.question("kettle", always=True))
        >>> answer.mask.shape == (len(field),), answer.in_view("view_00").mask.shape
        (True, torch.Size([30, 40]))
    """

    text: str
    """What was asked."""
    mask: Tensor
    """[N] boolean, the Gaussians that answer; empty if the thing is not there."""
    level: str
    """Name of the level that answers."""
    score: float | None
    """The share of everyday words whose best fit in this scene is lower, 0 to 1; None with too few everyday words."""
    presence: bool = True
    """Whether the thing is there: its score is not below that of the question, or that was not judged."""
    things: tuple[int, ...] = ()
    """Numbers of the things that answer, best first (``field.things`` describes them); empty in a field without things,
    with a threshold, and for what is not there."""
    runner_up: RunnerUp | None = None
    """The best thing elsewhere; None where none is."""
    threshold: float | None = None
    """The Gaussians that answer are above it, on relevancy rescaled over the scene; None if things answer."""
    parts: tuple[Answer, ...] = ()
    """The answers to the texts of an expression."""
    wanted: tuple[str, ...] = ()
    """Texts of an expression that its things answer."""
    excluded: tuple[str, ...] = ()
    """Texts of an expression that stand under "not" only."""
    without: tuple[int, ...] = ()
    """Numbers of things whose Gaussians an expression takes out of those of ``things``."""
    seen_from: str = ""
    """Name of the camera from which left, right, front and back are meant; "" where nothing depends on it."""
    found: tuple[Thing, ...] = ()
    """The things that answer an expression."""
    asked: tuple[AskedText, ...] = ()
    """Whose relevancy is shown as heat: the text, or the wanted texts of an expression. Pickling drops it."""
    field: LanguageField | None = None
    """That was asked. Pickling drops it."""

    def __repr__(self) -> str:
        facts = (
            f"{int(self.mask.sum()):,} of {len(self.mask):,} Gaussians, level {self.level}, {self.remark()}"
        )
        return f"Answer({self.text!r}: {facts if self.presence else self.remark()})"

    def _repr_html_(self) -> str:
        return card(f"{self.text!r} in the scene", {**self.to_dict(), "of": f"{len(self.mask):,} Gaussians"})

    @property
    def nbytes(self) -> int:
        """Bytes of its masks and things."""
        return self.mask.nbytes + sum(part.nbytes for part in (*self.parts, *self.found))

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "field": None, "asked": ()}  # which hold the scene

    def __deepcopy__(self, memo: dict[int, Any]) -> Answer:
        parts = tuple(part.__deepcopy__(memo) for part in self.parts)
        return replace(self, mask=self.mask.clone(), parts=parts, found=copy.deepcopy(self.found, memo))

    @property
    def certainty(self) -> Certainty | None:
        """The score in words: sure, likely, doubtful, not here."""
        return certainty(self.score, self.presence)

    def remark(self) -> str:
        """Return score and certainty in a few words, after the names of things that were not asked for by name, or by
        one of several; of an expression that nothing answers, what was found.
        """
        seen = f", as seen from {self.seen_from}" if self.seen_from else ""
        if not self.presence and any(part.text != self.text for part in self.parts):
            needed = (part for part in self.parts if part.text not in self.excluded)
            absent = [f"{part.text}: {part.remark()}" for part in needed if not part.presence]
            found = ", ".join(f"{part.text}: {len(part.things) or 1}" for part in self.parts if part.presence)
            found = f"found {found}, but none that is so{seen}" if found else "nothing found"
            return "; ".join(absent) or found
        texts = {part.text for part in self.parts} if len(self.wanted) == 1 else set[str]()
        named = Counter(
            thing.text or f"thing {thing.number}" for thing in self.found if thing.text not in texts
        )
        names = listed([name if count == 1 else f"{count} x {name}" for name, count in named.items()], 12)
        start = f"{names}; " if names else ""
        if self.score is None:
            return f"{start}presence not judged{seen}" if self.presence else "not in this scene"
        where = str(self.certainty) if self.presence else "not in this scene"
        least = self.asked[0].question.present_from if self.asked else None
        if not self.presence and least is not None and self.score >= least:
            where += f": what fits has fewer than {LEAST_GAUSSIANS} Gaussians"
        return f"{start}{where} (score {self.score:.2f}){seen}"

    def relevancy(self) -> Tensor:
        """Return the relevancy of every Gaussian at the level of the answer, [N] float32.

        Raises:
            InputError: the answer was pickled.
        """
        field = self._asked_field()
        each = [
            field.gaussian_relevancy(one.question.queries, one.question.canonical)[one.level, 0]
            for one in self.asked
        ]
        return torch.stack(each).amax(0).cpu()

    def in_view(self, camera: Camera | str | int = 0, scale: float = 1.0) -> ViewAnswer:
        """Draw the answer in one view: mask, heat map, box, point. Nothing is decided again.

        Args:
            camera: of the view, or its name or position among the field's cameras. For several answers in one view, use
                ``field.at(camera).show``.
            scale: of the picture, for a quicker look: with 0.25 all is in pixels of a view of a quarter of the width.

        Raises:
            InputError, UnknownNameError: there is no such camera, or the answer was pickled.
        """
        return self._asked_field().at(camera, scale).show([self])[0]

    def _asked_field(self) -> LanguageField:
        if self.field is None:
            raise InputError(f"{self.text}: an answer that was pickled knows no scene; ask again")
        return self.field

    def to_dict(self) -> dict[str, Any]:
        """Return the answer as plain JSON values, rounded."""
        return {
            "gaussians": int(self.mask.sum()),
            "things": list(self.things),
            "count": len(self.things) if self.things or not self.presence else None,
            **self.verdict(),
            "runner_up": self.runner_up
            and {"thing": self.runner_up.thing, "score": _rounded(self.runner_up.score)},
        }

    def verdict(self) -> dict[str, Any]:
        """Return level, score and presence as plain JSON values, rounded."""
        return {
            "level": self.level,
            "score": _rounded(self.score),
            "certainty": self.certainty,
            "present": self.presence,
            **({"seen_from": self.seen_from} if self.seen_from else {}),
            **({} if self.threshold is None else {"threshold": round(self.threshold, 3)}),
        }


def _rounded(score: float | None) -> float | None:
    return None if score is None else round(score, 4)
