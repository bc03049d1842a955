"""A text or an image for all scans of an archive: judged as in their fields (``scoup.query.thing_judge``)."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import torch
from torch import Tensor

from scoup.archive.scan_files import Scan
from scoup.base import InputError, MissingFileError
from scoup.field import NameTable, ThingTable
from scoup.models import TextEncoder
from scoup.query import (
    AskedThings,
    Certainty,
    Expression,
    LanguageField,
    Question,
    ThingIndex,
    asked_things,
    parse_expression,
)

Encode: TypeAlias = "Callable[[tuple[str, ...]], Tensor]"
LEAD = 0.5
"""By how much a rank grows with the lead of a thing. Chosen on simulated archives and four scenes of real models."""
SAME_PLACE = 0.5
"""Of two things that look like an image, the lower is left out if they share more of the Gaussians of one."""


class Found(NamedTuple):
    """A thing that answers."""

    scene: int  # number of its scan
    thing: int
    text: str
    score: float | None
    rank: float  # among the things of all scans
    certainty: Certainty | None = None  # of the answer of its scan
    runner_up: int | None = None  # of the first thing of a scan (``Answer.runner_up``)


class UnaskedScanError(InputError):
    """A scan whose field cannot be asked."""


def parse_search(
    text: str, encoder: TextEncoder, present_from: float | None
) -> tuple[Expression, Question[Any]]:
    """Parse and encode a text; errors are those of ``LanguageField.things``."""
    expression, source = parse_expression([text], encoder.names), encoder.name or "the word table"
    if any(not phrase.text for phrase in expression.phrases) or not expression.leaves(True):
        raise InputError(f"{text}: does not name what is looked for; ask a single field for everything there")
    return expression, Question.encoded(encoder, expression.texts, source, present_from)


@dataclass(frozen=True, eq=False)
class AskedScans:
    """A text or phrase, asked of S scans."""

    expression: Expression
    asked: AskedThings  # the texts of the expression
    scans: Sequence[Scan]

    def _of_text(self, values: Tensor, text: str) -> Tensor:
        return values[:, self.asked.question.texts.index(text)]

    def batches(self) -> Iterator[tuple[float, Callable[[], list[Found]]]]:
        """Yield functions that return the things that answer in some scans, each once and with the text it answers, and
        a rank that none of these things exceeds, falling.

        All scans are one batch, or each is one where its field has to be asked: then the function may raise an
        UnaskedScanError, as the field is gone or has changed.
        """
        expression, verdicts = self.expression, self.asked.verdicts
        targets = expression.leaves(True)
        if expression.is_plain:
            yield math.inf, lambda: self.ranked_things(
                [(scene, thing, str(text)) for scene in range(len(self.scans)) for text in targets
                 if (verdict := verdicts[str(text)][scene]).presence for thing in verdict.things])  # fmt: skip
            return
        best: dict[int, float] = {}
        for target in targets:
            needed = (target,) if isinstance(target, str) else target.texts
            ranks = self._best_ranks(needed[0])
            for scene, rank in enumerate(ranks):
                if all(verdicts[text][scene].presence for text in needed):
                    best[scene] = max(rank, best.get(scene, -math.inf))
        for scene, rank in sorted(best.items(), key=lambda item: -item[1]):
            yield rank, lambda scene=scene: self.ranked_things(self._of_field(scene))

    def ranked_things(self, answers: Sequence[tuple[int, int, str]]) -> list[Found]:
        """Return things, by scan, number and text, with scores and ranks, each for its first text."""
        first = {(scene, thing): text for scene, thing, text in reversed(answers)}
        ranked: dict[tuple[int, int], Found] = {}
        for text in dict.fromkeys(first.values()):
            word = self.asked.question.words[self.asked.question.texts.index(text)]
            keys = [key for key, own_text in first.items() if own_text == text]
            rows = [self.asked.index.starts[scene] + thing for scene, thing in keys]
            fits = self._of_text(self.asked.fits, text)[rows].tolist()
            scores = self.asked.scores[text].each(fits, *zip(*keys, strict=True))
            ranks = rank_of(scores, self._of_text(self._leads, text)[rows])
            for key, score, rank in zip(keys, scores, ranks, strict=True):
                verdict = self.asked.verdicts[text][key[0]]
                is_first = self.expression.is_plain and verdict.things[:1] == key[1:]
                rival = verdict.runner_up.thing if is_first and verdict.runner_up else None
                ranked[key] = Found(*key, word, score, rank, verdict.certainty, rival)
        every = dict.fromkeys((scene, thing) for scene, thing, _ in answers)
        return [ranked[key] for key in every if self.scans[key[0]].arrays["placed"][key[1]]]

    @cached_property
    def _leads(self) -> Tensor:
        return self.asked.index.leads(self.asked.fits)

    def _best_ranks(self, text: str) -> list[float]:
        """Return an upper bound of the ranks of the things of each scan, for a text."""
        usable = self.asked.index.usable
        fits, leads = (
            np.maximum.reduceat(
                torch.where(usable, self._of_text(values, text), -torch.inf).numpy(),
                self.asked.index.starts[:-1],
            )
            for values in (self.asked.fits, self._leads)
        )
        return rank_of(self.asked.scores[text].each(fits.tolist(), range(len(fits))), torch.from_numpy(leads))

    def _of_field(self, scene: int) -> list[tuple[int, int, str]]:
        """Ask the field itself for the things that answer phrases, which need shapes to be compared."""
        scan, asked = self.scans[scene], self.asked
        try:
            field = LanguageField.load(scan.field_path)
            if field.thing_table is None or not _is_same(
                field.thing_table, self.asked.index.vectors[scene], scan.names
            ):
                problem = f"the field of scan {scan.name} has changed: {scan.field_path}"
                raise UnaskedScanError(f"{problem}; add it again")
            things = asked_things(field, asked.encoder, self.expression, asked.question.present_from)
        except MissingFileError as error:
            missing = "field" if error.path == scan.field_path else "splat"
            problem = f"the {missing} of scan {scan.name} is gone: {error.path}"
            raise UnaskedScanError(f"{problem}; put it back or add the field again") from error
        texts = dict(zip(asked.question.words, asked.question.texts, strict=True))
        return [(scene, thing.number, texts[thing.text]) for thing in things if thing.number is not None]


def look_alikes(index: ThingIndex, vector: Tensor, name: str, placed: Sequence[Tensor]) -> Iterator[Found]:
    """Yield the things that look most like an image with a vector [D] of unit norm, best first, without the parts and
    wholes of one before, and without things that are not ``placed``, [T] boolean per scan. Score and rank are the
    cosine with the image."""
    cosines = torch.where(index.usable, index.cosines(vector[None])[:, 0], -torch.inf)
    left, counts = (index.usable & torch.cat([*placed])).numpy(), index.counts.clamp(min=1).numpy()
    scenes = np.repeat(np.arange(len(index.vectors)), np.diff(index.starts)).tolist()
    ends, others, shared = (tensor.numpy() for tensor in index.shares)
    values = cosines.tolist()
    for row in cosines.argsort(descending=True, stable=True).tolist():
        if left[row]:
            start, pairs = index.starts[scenes[row]], slice(ends[row], ends[row + 1])
            near = start + others[pairs]
            left[near[shared[pairs] > SAME_PLACE * np.minimum(counts[near], counts[row])]] = False
            yield Found(scenes[row], row - start, name, values[row], values[row])


def _is_same(table: ThingTable, vectors: Tensor, names: NameTable | None) -> bool:
    """Return whether the things of a field have the names and embeddings of a scan."""
    votes = [torch.zeros(0) if known is None else known.matrix(len(table)) for known in (table.names, names)]
    return torch.equal(table.embeddings, vectors) and torch.equal(*votes)


def rank_of(scores: Sequence[float | None], leads: Tensor) -> list[float]:
    """Return the ranks of things of all scans from their scores (None if not judged) and leads.

    A lead says how much better a thing fits a text than the everyday words that fit it best. Where many scores are
    high, it tells scans apart better than they do.
    """
    return [
        (-1 if score is None else score) + LEAD * lead
        for score, lead in zip(scores, leads.tolist(), strict=True)
    ]


def words_digest(words: Tensor) -> str:
    """Return the digest of words [B, D]."""
    return hashlib.sha256(words.contiguous().numpy().tobytes()).hexdigest()[:32]
