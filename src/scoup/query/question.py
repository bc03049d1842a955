"""The question to a field: texts as vectors, and the rules by which they are answered."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from scoup.query.expression import Expression
from scoup.query.presets import QUERY_PRESETS, QueryPreset
from scoup.query.text_vectors import TextVectors


@dataclass(frozen=True, eq=False, repr=False)
class Question(TextVectors):
    """Texts and the rules of their answers, made by ``field.question(texts, ...)``.

    Example:
        >>> question = field.question(["kettle", "wooden table"], threshold=0.6)
        >>> question.texts, question.threshold, question.queries.shape
        (('kettle', 'wooden table'), 0.6, torch.Size([2, 16]))
    """

    preset: QueryPreset = QUERY_PRESETS["default"]
    """How relevancy becomes masks and points in a view (``scoup.query.presets.QUERY_PRESETS``). "default" also compares
    with everyday words; the others follow the papers' systems: without these words, and always finding something."""
    threshold: float | None = None
    """A Gaussian answers above this, 0 to 1, once relevancy is rescaled over the scene. None: the threshold at which
    the answer changes least (``scoup.query.stable_threshold``). ``field.question`` puts it into the preset as well,
    for the pixels of a view."""
    rescaled: bool = True
    """False puts the threshold of Gaussians on the relevancy itself, where 0.5 is a draw with what texts are compared
    with; None is 0.6 then."""
    neighbours: int = 0
    """Blend the relevancy of each Gaussian half and half with the mean of this many nearest neighbours; 0 is off."""
    level: int | None = None
    """Position of the one that answers; ``field.question`` also takes its name. None: the preset chooses, for each
    text."""
    present_from: float | None = None
    """The z-score from which a text counts as present (``scoup.query.presence``). None: presence is not judged, and
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
        chosen = slice(number, number + 1)
        return replace(self, texts=self.texts[chosen], queries=self.queries[chosen], **options)
