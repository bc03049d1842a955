"""The question to a field: texts as vectors, and the rules by which they are answered."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from scoup.query.expression import Expression
from scoup.query.text_vectors import TextVectors


@dataclass(frozen=True, eq=False, repr=False)
class Question(TextVectors):
    """Texts and the rules of their answers, made by ``field.question(texts, ...)``.

    Example:
        >>> question = field.question(["kettle", "wooden table"], threshold=0.6)
        >>> question.texts, question.threshold, question.queries.shape
        (('kettle', 'wooden table'), 0.6, torch.Size([2, 16]))
    """

    threshold: float | None = None
    """Gaussians with relevancy above this, 0 to 1 once it is rescaled over the scene, answer in place of things. None:
    things answer, or in a field without things the Gaussians above the threshold at which the answer changes least
    (``scoup.query.stable_threshold``)."""
    level: int | None = None
    """Position of the one that answers; ``field.question`` also takes its name. None: the best, for each text."""
    present_from: float | None = None
    """The score from which a text counts as present (``scoup.query.presence``). None: presence is not judged, and
    something is found for any text."""
    is_single: bool = False
    """It was one text or vector, not a list, and so is the answer."""
    expression: Expression | None = None
    """Of the texts, for ``field.select``; None: they are combined with `or`."""

    @classmethod
    def from_vectors(cls, vectors: TextVectors, **options: Any) -> Question:
        """Make a question of vectors, with attributes as options."""
        return cls(**{**vars(vectors), **options})

    def one(self, number: int, **options: Any) -> Question:
        """Return the question of one of its texts, with some attributes replaced."""
        return self.some(slice(number, number + 1), **options)

    def some(self, chosen: slice, **options: Any) -> Question:
        """Return the question of some of its texts, with some attributes replaced."""
        return replace(self, texts=self.texts[chosen], queries=self.queries[chosen], **options)
