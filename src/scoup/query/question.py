"""What a field is asked: texts as vectors, and the rules by which they are answered."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from scoup.query.expression import Expression
from scoup.query.presets import QUERY_PRESETS, QueryPreset
from scoup.query.text_vectors import TextVectors


@dataclass(frozen=True, eq=False, repr=False)
class Question(TextVectors):
    """Texts and how they are to be answered; ``field.question(texts, ...)`` makes one, and every answer takes it.

    Attributes:
        preset: how relevancy becomes masks and points in a view (``scoup.query.presets.QUERY_PRESETS``). "default"
            also compares with everyday words; the others follow the papers' systems, do without, and always find
            something.
        threshold: a Gaussian answers above this, 0 to 1, once relevancy is rescaled over the scene. None: the
            threshold at which the answer changes least (``scoup.query.stable_threshold``). ``field.question`` puts it
            into the preset as well, for the pixels of a view.
        rescaled: false puts the threshold of Gaussians on the relevancy itself, where 0.5 is a draw with what texts
            are compared with; None is 0.6 then.
        neighbours: blend the relevancy of each Gaussian half and half with the mean of this many nearest neighbours;
            0 is off.
        level: position of the one that answers; ``field.question`` also takes its name. None: the preset chooses, for
            each text.
        present_from: the z-score from which a text counts as present (``scoup.query.presence``). None: presence is
            not judged, and something is found for any text.
        is_single: it was one text or vector, not a list: answers are not lists either.
        expression: of the texts, for ``field.select``; None: any of them may answer.

    Example:
        >>> question = field.question(["kettle", "wooden table"], threshold=0.6)
        >>> question.texts, question.threshold, question.queries.shape
        (('kettle', 'wooden table'), 0.6, torch.Size([2, 16]))
    """

    preset: QueryPreset = QUERY_PRESETS["default"]
    threshold: float | None = None
    rescaled: bool = True
    neighbours: int = 0
    level: int | None = None
    present_from: float | None = None
    is_single: bool = False
    expression: Expression | None = None

    @classmethod
    def from_vectors(cls, vectors: TextVectors, **options: Any) -> Question:
        """Ask vectors as they are; options by name, as the attributes."""
        return cls(**{**vars(vectors), **options})

    def one(self, number: int, **options: Any) -> Question:
        """The question of one of its texts alone; options by name in the place of its own."""
        chosen = slice(number, number + 1)
        return replace(self, texts=self.texts[chosen], queries=self.queries[chosen], **options)
