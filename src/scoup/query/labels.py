"""The word of several that fits each Gaussian best, in the scene and in views."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from scoup import raster
from scoup.base import InputError, UnknownNameError
from scoup.field import NO_THING, Field
from scoup.pictures import Picture, contact_sheet, label_colors, swatch_legend
from scoup.query.answer import Answer
from scoup.query.field_view import FieldView

NONE = -1
"""The id of a Gaussian that no word fits."""
NONE_NAME = "none"
AT_A_TIME = 16  # words rendered together
LEAST_ALPHA = 0.5  # of a pixel with a label
COLUMNS, SHEET_WIDTH = 3, 1500
MOST_VIEWS = 6  # on a sheet


@dataclass(frozen=True, eq=False, repr=False)
class GaussianLabels:
    """The class of every Gaussian. Tensors are on the CPU.

    Example:
        >>> field = scoup.LanguageField.load("f.scoup")
        >>> labels = field.label(field.question(["kettle", "wooden table"], always=True))
        >>> labels.names
        ('kettle', 'wooden table')
    """

    ids: Tensor
    """[N] int32, the position of a word in ``names``; -1 for none of them."""
    answers: tuple[Answer, ...]
    """The answer to each of Q words."""
    instances: Tensor
    """[N] int32, which of these things it belongs to; -1 without a word, and where the votes answer."""

    @classmethod
    def of(cls, field: Field, answers: Sequence[Answer]) -> GaussianLabels:
        """Return the word that fits each Gaussian best, or "none", from the answers to the words; repeated words count
        once.

        A word applies to the Gaussians that answer it. Of several words for one Gaussian, the one answered by the
        finest level counts, for the name of a part says more than that of its whole; of words of one level the one with
        the largest score.
        """
        of_name: dict[str, Answer] = {}
        for answer in answers:
            of_name.setdefault(answer.word, answer)
        answers = [*of_name.values()]
        if NONE_NAME in of_name:
            raise InputError(f"labels need words that differ from {NONE_NAME!r} (got {', '.join(of_name)})")
        ids = labels_of_answers(answers, field.levels)
        instances = torch.full_like(ids, NO_THING)
        for number, answer in enumerate(answers):
            if answer.things and field.thing_table is not None:
                owners = field.thing_table.owners.cpu()
                inside = torch.isin(owners, torch.tensor(answer.things, dtype=owners.dtype))
                instances = torch.where(
                    ids == number, torch.where(inside, owners, NO_THING).amax(1), instances
                )
        return cls(ids, tuple(answers), instances)

    @property
    def names(self) -> tuple[str, ...]:
        """The Q words."""
        return tuple(answer.word for answer in self.answers)

    def __repr__(self) -> str:
        counts = ", ".join(f"{name}: {count:,}" for name, count in self.counts().items())
        return f"GaussianLabels({len(self.ids):,} Gaussians; {counts})"

    def mask(self, name: str) -> Tensor:
        """Return the Gaussians of a word, or of "none", [N] boolean.

        Raises:
            UnknownNameError: it is another word.
        """
        if name in self.names:
            return self.ids == self.names.index(name)
        if name == NONE_NAME:
            return self.ids == NONE
        raise UnknownNameError("class", name, (*self.names, NONE_NAME))

    def counts(self) -> dict[str, int]:
        """Return the number of Gaussians per word, and of "none"."""
        counts = torch.bincount(self.ids.long() + 1, minlength=len(self.names) + 1).tolist()
        return {**dict(zip(self.names, counts[1:], strict=True)), NONE_NAME: counts[0]}

    def to_dict(self) -> dict[str, Any]:
        """Return the meaning of the numbers as plain JSON values, as in ``labels.json`` (docs/editing.md)."""
        counts, colors = self.counts(), label_colors(len(self.names)).tolist()
        classes = [
            {
                "id": number,
                "name": answer.word,
                "color": colors[number],
                "gaussians": counts[answer.word],
                **{name: answer.to_dict()[name] for name in ("level", "things", "present", "score")},
            }
            for number, answer in enumerate(self.answers)
        ]
        none = {"id": NONE, "name": NONE_NAME, "gaussians": counts[NONE_NAME]}
        return {"gaussians": len(self.ids), "classes": classes, "none": none}


def labels_of_answers(answers: Sequence[Answer], levels: Sequence[str]) -> Tensor:
    """Return the number of the word of each Gaussian, [N] int32, ``NONE`` for none."""
    ids = torch.full((len(answers[0].mask),), NONE, dtype=torch.int32)
    # The best word comes last and overwrites the others; of equals the first word wins.
    order = sorted(
        range(len(answers)),
        key=lambda number: (-levels.index(answers[number].level), answers[number].score or 0.0, -number),
    )
    for number in order:
        ids[answers[number].mask] = number
    return ids


def label_map(view: FieldView, labels: GaussianLabels) -> Tensor:
    """Return the word whose Gaussians contribute most to each pixel, [H, W] int32 on the CPU; ``NONE`` where Gaussians
    without a word do, or where alpha is below ``LEAST_ALPHA``.
    """
    ids = labels.ids.to(view.field.codebook.device)
    numbers = torch.arange(NONE, len(labels.names), device=ids.device, dtype=ids.dtype)
    shape = view.camera.height, view.camera.width
    most, painted = torch.full(shape, -1.0, device=ids.device), torch.zeros(shape, device=ids.device)
    given = torch.full(shape, NONE, device=ids.device, dtype=ids.dtype)
    for batch in numbers.split(AT_A_TIME):
        image, painted = raster.render_channels(view.projection, (ids[:, None] == batch).float())
        largest, places = image.max(2)
        given = torch.where(largest > most, batch[places], given)
        most = torch.maximum(largest, most)
    return torch.where(painted >= LEAST_ALPHA, given, NONE).int().cpu()


def label_sheet(labels: GaussianLabels, views: Mapping[str, Picture]) -> Picture:
    """Draw views by their names, each the ``region_overlay`` of its ``label_map``, over a legend of the words."""
    sheet = contact_sheet([*views.values()], [*views], COLUMNS, SHEET_WIDTH)
    counts, colors = labels.counts(), label_colors(len(labels.names))
    order = sorted(enumerate(labels.names), key=lambda word: -counts[word[1]])
    used = [(number, name) for number, name in order if counts[name]]
    return swatch_legend(
        sheet,
        f"Labels of {len(labels.ids):,} Gaussians; grey: {NONE_NAME} of the words ({counts[NONE_NAME]:,}).",
        "words",
        [tuple(colors[number].tolist()) for number, _ in used],
        [name for _, name in used],
    )
