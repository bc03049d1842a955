"""The answer to a text, decided once, in the scene."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import torch
from torch import Tensor

from scoup.base import listed
from scoup.field import Field
from scoup.query.expression import Expression
from scoup.query.presence import LEAST_GAUSSIANS, Certainty, certainty, said_score
from scoup.query.question import AskedText

if TYPE_CHECKING:
    from scoup.query.things import Thing


class RunnerUp(NamedTuple):
    """The best thing elsewhere, if it fits nearly as well (``constants.RUNNER_UP``)."""

    thing: int
    """Its number."""
    score: float | None
    """As of ``Answer``: the difference says by how much it is worse."""


@dataclass(frozen=True, eq=False, repr=False)
class Answer:
    """The answer of a scene to one text. Tensors are on the CPU.

    Example:
        >>> field = scoup.LanguageField.load("f.scoup")
        >>> answer = field.answer(field.question("kettle", always=True))
        >>> answer.mask.shape == (len(field),), field.at("view_00").show([answer])[0].mask.shape
        (True, torch.Size([30, 40]))
    """

    text: str
    """What was asked."""
    mask: Tensor
    """[N] boolean, the Gaussians that answer; empty if the thing is not there."""
    level: str
    """Name of the level that answers."""
    score: float | None
    """The share of everyday words whose best fit in this scene is lower, 0 to 1, or less if some of them are nearer to
    what fits best (``scoup.query.presence``); None with too few everyday words."""
    asked: AskedText
    """The text as vectors."""
    presence: bool = True
    """Whether the thing is there: its score is not below that of the question, or that was not judged."""
    things: tuple[int, ...] = ()
    """Numbers of the things that answer, best first (``field.things`` describes them); empty in a field without things,
    with a threshold, and for what is not there."""
    scores: tuple[float | None, ...] = ()
    """The score of each of these things alone."""
    runner_up: RunnerUp | None = None
    """The best thing elsewhere, if it fits nearly as well; None otherwise."""
    threshold: float | None = None
    """The Gaussians that answer are above it, on relevancy rescaled over the scene; None if things answer."""

    def __repr__(self) -> str:
        facts = (
            f"{int(self.mask.sum()):,} of {len(self.mask):,} Gaussians, level {self.level}, {self.remark()}"
        )
        return f"Answer({self.text!r}: {facts if self.presence else self.remark()})"

    @property
    def heats(self) -> tuple[AskedText, ...]:
        """The texts whose largest relevancy is shown as heat."""
        return (self.asked,)

    @property
    def word(self) -> str:
        """What answers is called: "mug" where "mugs" was asked; the whole of a phrase or expression."""
        return self.asked.word

    @property
    def certainty(self) -> Certainty | None:
        """The score in words: sure, likely, doubtful, not here."""
        return certainty(self.score, self.presence)

    def counted(self) -> str:
        """Return how many things it is, with their numbers: "thing 3", "2 things (3, 5)"; "" without things."""
        if len(self.things) < 2:
            return "".join(f"thing {number}" for number in self.things)
        return f"{len(self.things)} things ({', '.join(map(str, self.things))})"

    def remark(self) -> str:
        """Return score and certainty in a few words, and the runner-up."""
        runner_up = f", or thing {self.runner_up.thing}" if self.presence and self.runner_up else ""
        if self.score is None:
            return "presence not judged" + runner_up if self.presence else "not in this scene"
        where, least = str(self.certainty) if self.presence else "not in this scene", self.asked.present_from
        if not self.presence and least is not None and self.score >= least:
            where += f": what fits has fewer than {LEAST_GAUSSIANS} Gaussians"
        return f"{where} (score {said_score(self.score, least)}){runner_up}"

    def to_dict(self) -> dict[str, Any]:
        """Return the answer as plain JSON values, rounded."""
        return {
            "gaussians": int(self.mask.sum()),
            "count": len(self.things),
            "things": list(self.things),
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
            **({} if self.threshold is None else {"threshold": round(self.threshold, 3)}),
        }


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class ExpressionAnswer(Answer):
    """The answer to a phrase, or to an expression such as "mug and not handle".

    Level, score, runner-up and threshold are those of the wanted text with the largest score.

    Example:
        >>> found = field.answer("kettle and not wooden table")
        >>> str(found.tree), [part.text for part in found.parts]
        ('kettle and not wooden table', ['kettle', 'wooden table'])
    """

    tree: Expression
    """The texts, and the operators and relations between them."""
    parts: tuple[Answer, ...]
    """The answers to its texts."""
    found: tuple[Thing, ...] = ()
    """The things that answer."""
    without: tuple[int, ...] = ()
    """Numbers of things whose Gaussians are taken out of those of ``things``."""
    seen_from: str = ""
    """Name of the camera from which left, right, front and back are meant; "" where nothing depends on it."""

    @property
    def word(self) -> str:
        return self.asked.word if isinstance(self.tree.root, str) else self.text

    @property
    def heats(self) -> tuple[AskedText, ...]:
        """The wanted texts."""
        return tuple(answer.asked for answer in self.parts if answer.text in self.tree.wanted)

    def remark(self) -> str:
        """Return score and certainty in a few words, after the names of things that were not asked for by name, or by
        one of several; where nothing answers, what was found.
        """
        seen = f", as seen from {self.seen_from}" if self.seen_from else ""
        if not self.presence and any(one.text != self.text for one in self.parts):
            needed = (one for one in self.parts if one.text not in self.tree.excluded)
            absent = [f"{one.text}: {one.remark()}" for one in needed if not one.presence]
            counts = ", ".join(f"{one.text}: {len(one.things) or 1}" for one in self.parts if one.presence)
            matched = f"found {counts}, but none that is so{seen}" if counts else "nothing found"
            return "; ".join(absent) or matched
        texts = {one.asked.word for one in self.parts} if len(self.tree.wanted) == 1 else set[str]()
        named = Counter(thing.title for thing in self.found if thing.text not in texts)
        names = listed([name if count == 1 else f"{count} x {name}" for name, count in named.items()], 12)
        return f"{names}; " * bool(names) + super().remark() + seen

    def verdict(self) -> dict[str, Any]:
        """Return level, score, presence and point of view as plain JSON values, rounded."""
        return {**super().verdict(), **({"seen_from": self.seen_from} if self.seen_from else {})}


def answer_relevancy(field: Field, answer: Answer) -> Tensor:
    """Return the relevancy of every Gaussian of the field at the level of an answer, [N] float32 on the CPU."""
    heats = [field.gaussian_relevancy(asked.query, asked.canonical)[asked.level, 0] for asked in answer.heats]
    return torch.stack(heats).amax(0).cpu()


def _rounded(score: float | None) -> float | None:
    return None if score is None else round(score, 4)
