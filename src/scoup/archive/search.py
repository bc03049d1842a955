"""One scan of an archive, asked: by the code that answers ``field.things``, without the Gaussians."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, TypeAlias

import torch
from torch import Tensor

from scoup.archive.scan_files import Scan
from scoup.base.errors import MissingFileError, ScoupWarning
from scoup.field.language_field import LanguageField
from scoup.models.text import TextEncoder
from scoup.query import matching
from scoup.query.answer_scene import answers_of
from scoup.query.expression import parse_expression
from scoup.query.matching import ComparedTable, choose_things, compared_words, find_instances, hub_cosines
from scoup.query.phrases import Phrase, texts_of
from scoup.query.presence import LEAST_GAUSSIANS, NullScores, is_present, other_words, presence_threshold
from scoup.query.question import Question, make_question, text_vectors
from scoup.query.relations import things_of_question

Rank: TypeAlias = "tuple[float, float]"
"""Score and fit, by which things of all scans are ordered."""
_RULE = (
    matching.HUB_QUANTILE,
    matching.HUB_SHARE,
    matching.FEW_REGIONS,
    matching.UNSTABLE,
    matching.LEAST_STABILITY,
)


@dataclass(frozen=True, eq=False)
class Search:
    """A text or phrase for every scan."""

    question: Question[Any]  # with the expression
    encoder: TextEncoder
    counted: bool  # things are one instance each
    words: Tensor  # [B, D]
    digest: str  # of the words
    others: Tensor  # [Q, B] boolean, the words that count (``other_words``); none with too few words

    @classmethod
    def of(cls, text: str, encoder: TextEncoder, counted: bool, present_from: float | None) -> Search:
        """Parse and encode a text; errors are those of ``LanguageField.things``."""
        expression, source = parse_expression([text], encoder.names), encoder.name or "the word table"
        assert expression.targets  # it raises for what selects Gaussians only
        vectors = text_vectors(encoder, expression.texts, source)
        least = presence_threshold(len(vectors.everyday), source, present_from)
        question = Question.from_vectors(vectors.with_everyday(), present_from=least, expression=expression)
        words = compared_words(question)
        others = other_words(question.queries, words)
        if not question.can_judge_presence:
            others = others[:, :0]
        return cls(question, encoder, counted, words, words_digest(words), others)


@dataclass(frozen=True, eq=False)
class AskedScan:
    """A scan, and how its things fit the texts of a search."""

    search: Search
    scan: Scan
    known: ComparedTable
    fits: Tensor  # [T, Q]
    scores: list[NullScores]  # Q

    @classmethod
    def of(cls, search: Search, scan: Scan) -> AskedScan:
        if search.digest not in scan.compared:
            record = scan.record
            known_words = record.words == search.digest and len(record.best_fits) == len(search.words)
            hubs = scan.hubs if known_words else hub_cosines(scan.table, search.words)
            table = ComparedTable.known(scan.table, search.words, hubs, scan.counts, scan.shared)
            scan.compared.clear()
            scan.compared[search.digest] = table, record.best_fits if known_words else table.best_fits
        known, best_fits = scan.compared[search.digest]
        fits = known.fits(search.question.queries.float().cpu())
        scores = [NullScores(best_fits[: len(others)], others) for others in search.others]
        return cls(search, scan, known, fits, scores)

    def rank(self, thing: int, text: str) -> tuple[float | None, Rank]:
        """Return the score of a thing for a text, and its rank."""
        number = self.search.question.texts.index(text)
        fit = float(self.fits[thing, number])
        score = self.scores[number](fit)
        return score, (-1.0 if score is None else score, fit)

    @property
    def bound(self) -> Rank | None:
        """A rank that no thing exceeds; None where nothing can answer."""
        assert self.search.question.expression is not None
        if not bool(self.known.usable.any()):
            return None
        best = torch.where(self.known.usable[:, None], self.fits, -torch.inf).argmax(0).tolist()
        least, bounds = self.search.question.present_from, []
        of_texts = {
            text: self.rank(thing, text) for text, thing in zip(self.search.question.texts, best, strict=True)
        }
        for target in self.search.question.expression.targets:
            if all(is_present(of_texts[text][0], LEAST_GAUSSIANS, least) for text in texts_of(target)):
                bounds.append(of_texts[texts_of(target)[0]][1])
        return max(bounds, default=None)

    def things(self) -> list[tuple[int, str]]:
        """Return the numbers of the things that answer, each once and with the text it answers, best first."""
        question = self.search.question
        assert question.expression is not None
        chosen = dict(zip(question.texts, self._chosen(), strict=True))
        targets = [
            target for target in question.expression.targets if all(chosen[text] for text in texts_of(target))
        ]
        if any(isinstance(target, Phrase) for target in targets):
            return self._of_field()
        found: dict[int, str] = {}
        for text in (texts_of(target)[0] for target in targets):
            for thing in chosen[text]:
                found.setdefault(thing, text)
        return list(found.items())

    def _chosen(self) -> Iterator[list[int]]:
        """The things that answer each text; none where it is not present."""
        least = self.search.question.present_from
        for number, choice in enumerate(choose_things(self.known, self.fits)):
            if choice is None:
                yield []
                continue
            size = int(self.known.counts[choice.things].sum())
            things = choice.things
            if self.search.counted:
                things = find_instances(self.known, self.fits[:, number], things)
            yield things.tolist() if is_present(self.scores[number](choice.fit), size, least) else []

    def _of_field(self) -> list[tuple[int, str]]:
        """The things that answer phrases, for which shapes are compared: the field itself is asked."""
        record, asked, problem = self.scan.record, self.search.question, "has changed"
        try:
            field = LanguageField.load(record.field_path)
            if field.thing_table is not None and torch.equal(
                field.thing_table.embeddings, self.scan.table.embeddings
            ):
                always, least = asked.present_from is None, asked.present_from
                question = make_question(field, asked.expression, self.search.encoder, always, least)
                answers = answers_of(field, question)
                found = things_of_question(field, question, answers, None, self.search.counted)
                return [(thing.number, thing.text) for thing in found if thing.number is not None]
        except MissingFileError as error:
            problem = f"cannot be asked ({error})"
        message = (
            f"{record.field_path}: {problem} since it became the scan {record.name}, which answers no phrase"
        )
        warnings.warn(f"{message}; add it again", ScoupWarning, stacklevel=2)
        return []


def words_digest(words: Tensor) -> str:
    """Return the digest of words [B, D] and of the rule by which things are compared with them."""
    return hashlib.sha256(repr(_RULE).encode() + words.contiguous().numpy().tobytes()).hexdigest()[:32]
