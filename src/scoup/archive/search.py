"""One scan of an archive, asked: by the code that answers ``field.things``, without the Gaussians."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeAlias

import torch
from torch import Tensor

from scoup.archive.read_scans import ScanBlock
from scoup.archive.scan_files import Scan, ScanRecord
from scoup.base.errors import InputError, MissingFileError
from scoup.models.text import TextEncoder
from scoup.query import matching
from scoup.query.answer_scene import compared_others
from scoup.query.ask import things_of_question
from scoup.query.expression import Expression, parse_expression
from scoup.query.language_field import LanguageField
from scoup.query.matching import ComparedTable, compared_words, hub_cosines
from scoup.query.named import Named, choose, joined_presence, named_texts
from scoup.query.phrases import texts_of
from scoup.query.presence import TextScore, is_present, presence_threshold
from scoup.query.question import Question, encode_texts, make_question, near_names
from scoup.scene.names import number_of
from scoup.scene.things import ThingTable

Encode: TypeAlias = "Callable[[tuple[str, ...]], Tensor]"
LEAD = 0.5
"""By how much a rank grows with the lead of a thing. Chosen on simulated archives (seeds 10 and 11) and four scenes of
real models; ``python -m benchmarks archive`` reports others."""
ROUNDING = 1e-3
"""Fits that are computed together differ by less from those of a scan."""
SAME_PLACE = 0.5
"""Of two things that look like an image, the lower is left out if they share more of the Gaussians of one."""
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

    expression: Expression
    question: Question[Any]  # of its texts
    encoder: TextEncoder
    words: Tensor  # [B, D]
    digest: str  # of the words
    others: Tensor  # [Q, B] boolean, the words that count (``compared_others``); none with too few words
    encode: Encode  # of the encoder, with a cache

    @classmethod
    def of(
        cls, text: str, encoder: TextEncoder, encode: Encode, counted: bool, present_from: float | None
    ) -> Search:
        """Parse and encode a text; errors are those of ``LanguageField.things``."""
        expression, source = parse_expression([text], encoder.names), encoder.name or "the word table"
        if any(not phrase.text for phrase in expression.phrases) or not expression.leaves(True):
            raise InputError(
                f"{text}: does not name what is looked for; ask a single field for everything there"
            )
        vectors = encode_texts(encoder, expression.texts)
        least = presence_threshold(len(vectors.everyday), source, present_from)
        question = Question.from_vectors(vectors.with_everyday(), present_from=least)
        words = compared_words(question)
        others = compared_others(question)
        return cls(expression, question, encoder, words, words_digest(words), others, encode)

    def ask(self, scan: Scan) -> AskedScan:
        """Ask a scan."""
        return AskedScan.of(self, scan)

    def near(self, record: ScanRecord) -> tuple[str | None, ...]:
        """Return the names of things of a scan that are nearly the texts."""
        given = [text for text, (_, votes) in record.names.items() if votes]
        return near_names(record.names, given, self.encoder, self.question, self.encode)

    def bounds(self, block: ScanBlock) -> list[float | None]:
        """Return a rank for each scan that none of its things exceeds; None where nothing can answer."""
        cosines = block.cosines(self.question.queries.float().cpu())
        every = cosines * block.scales[:, None] - block.lowered[:, None]
        fits, leads = (block.most(each) + ROUNDING for each in (every, every - block.rest_of_hubs[:, None]))
        known = [words == (self.digest, len(self.words)) for words in block.words]
        if not any(known):
            return [math.inf] * len(known)  # statistics of other words
        scores = torch.stack(
            [
                (block.best_fits[:, : len(others)][:, others] < fit[:, None]).sum(1) / others.sum().double()
                for others, fit in zip(self.others, fits.T, strict=True)
            ],
            1,
        )  # NaN if no word counts
        for number, record in enumerate(block.records):
            if record.names:
                scores[number] = self._joined(record, scores[number])
        least = self.question.present_from
        there = (fits > -math.inf) & (scores >= least if least is not None else True)
        columns = []
        for target in self.expression.leaves(True):
            texts = [self.question.texts.index(text) for text in texts_of(target)]
            ranks = rank_of(scores, leads)[:, texts[0]].tolist()
            found = there[:, texts].all(1).tolist()
            columns.append([rank if each else None for rank, each in zip(ranks, found, strict=True)])
        every = (max((rank for rank in ranks if rank), default=None) for ranks in zip(*columns, strict=True))
        return [rank if is_known else math.inf for rank, is_known in zip(every, known, strict=True)]

    def _joined(self, record: ScanRecord, scores: Tensor) -> Tensor:
        """Return scores [Q] of a scan in which a model has looked for names."""
        near, presences = self.near(record), [presence for presence, _ in record.names.values()]
        joined = scores.tolist()
        for number, text in enumerate(self.question.texts):
            name = number_of(record.names, near[number] or text if near else text)
            if name is not None:
                score = None if math.isnan(joined[number]) else joined[number]
                joined[number] = joined_presence(presences[name], score)
        return torch.tensor(joined, dtype=torch.float64)


class UnaskedScanError(InputError):
    """A scan whose field cannot be asked."""


@dataclass(frozen=True, eq=False)
class AskedScan:
    """A scan, and how its things fit the texts of a search."""

    search: Search
    scan: Scan
    known: ComparedTable
    fits: Tensor  # [T, Q]
    scores: list[TextScore]  # Q
    named: list[Named | None]  # Q

    @classmethod
    def of(cls, search: Search, scan: Scan) -> AskedScan:
        compared = scan.compared.get(search.digest)
        if compared is None:
            record = scan.record
            known_words = record.words == search.digest and len(record.best_fits) == len(search.words)
            hubs = scan.hubs if known_words else hub_cosines(scan.table, search.words)
            table = ComparedTable.known(scan.table, search.words, hubs, scan.counts, scan.shared)
            compared = table, record.best_fits if known_words else table.best_fits
            scan.compared.clear()
            scan.compared[search.digest] = compared
        known, best_fits = compared
        fits = known.fits(search.question.queries.float().cpu())
        named = named_texts(scan.table, replace(search.question, near=search.near(scan.record)))
        scores = [
            TextScore(best_fits[: len(others)], others, name)
            for others, name in zip(search.others, named, strict=True)
        ]
        return cls(search, scan, known, fits, scores, named)

    def rank(self, thing: int, text: str) -> tuple[float | None, float]:
        """Return the score of a thing for a text, and its rank among the things of all scans."""
        number = self.search.question.texts.index(text)
        score = self.scores[number](float(self.fits[thing, number]), thing)
        known = torch.tensor(math.nan if score is None else score, dtype=torch.float64)
        return score, float(rank_of(known, self._leads[thing, number]))

    @cached_property
    def _leads(self) -> Tensor:
        return self.known.leads(self.fits)

    def things(self) -> list[tuple[int, str]]:
        """Return the numbers of the things that answer, each once and with the text it answers, best first.

        Raises:
            UnaskedScanError: the field is needed, and is gone or has changed.
        """
        expression = self.search.expression
        chosen = dict(zip(self.search.question.texts, self._chosen(), strict=True))
        targets = [
            target for target in expression.leaves(True) if all(chosen[text] for text in texts_of(target))
        ]
        if targets and not expression.is_plain:
            return self._of_field()
        found: dict[int, str] = {}
        for text in map(str, targets):
            for thing in chosen[text]:
                found.setdefault(thing, text)
        return list(found.items())

    def _chosen(self) -> Iterator[list[int]]:
        """The things that answer each text; none where it is not present."""
        least = self.search.question.present_from
        for number, choice in enumerate(choose(self.known, self.fits, self.named)):
            if choice is None:
                yield []
                continue
            size = int(self.known.counts[choice.things].sum())
            score = self.scores[number](choice.fit)
            things = choice.things
            yield things.tolist() if is_present(score, size, least) else []

    def _of_field(self) -> list[tuple[int, str]]:
        """The things that answer phrases, for which shapes are compared: the field itself is asked."""
        record, search = self.scan.record, self.search
        try:
            field = LanguageField.load(record.field_path)
            if field.thing_table is None or not _is_same(field.thing_table, self.scan.table):
                problem = f"the field of scan {record.name} has changed: {record.field_path}"
                raise UnaskedScanError(f"{problem}; add it again")
            least = search.question.present_from
            question = make_question(field, search.encoder, search.expression, least is None, least)
            found = things_of_question(field, question)
        except MissingFileError as error:
            part = "field" if error.path == record.field_path else "splat"
            problem = f"the {part} of scan {record.name} is gone: {error.path}"
            raise UnaskedScanError(f"{problem}; put it back or add the field again") from error
        return [(thing.number, thing.text) for thing in found if thing.number is not None]


@dataclass(frozen=True, eq=False)
class ImageSearch:
    """An image for every scan. Its things are ordered by their cosines with it: those of texts, by which scans are
    compared otherwise, are all lower."""

    name: str
    vector: Tensor  # [D] of unit norm

    def bounds(self, block: ScanBlock) -> list[float | None]:
        """Return a rank for each scan that none of its things exceeds; None where nothing can answer."""
        cosines = block.cosines(self.vector[None]).masked_fill(block.lowered[:, None].isinf(), -torch.inf)
        best = block.most(cosines)[:, 0].tolist()
        return [None if cosine == -math.inf else cosine + ROUNDING for cosine in best]

    def ask(self, scan: Scan) -> AskedImage:
        """Ask a scan."""
        cosines = scan.table.embeddings.float() @ self.vector
        cosines[(scan.counts <= 0) | (scan.table.mass <= 0)] = -torch.inf
        return AskedImage(self, scan, cosines)


@dataclass(frozen=True, eq=False)
class AskedImage:
    """A scan, and the cosines of its things with an image."""

    search: ImageSearch
    scan: Scan
    cosines: Tensor  # [T]

    def rank(self, thing: int, text: str) -> tuple[float, float]:
        """Return the cosine of a thing, which is its rank, too."""
        return float(self.cosines[thing]), float(self.cosines[thing])

    def things(self) -> Iterator[tuple[int, str]]:
        """Yield the numbers of things, best first; parts of one before, and what it is a part of, are left out."""
        shared = self.scan.shared.to_dense() > SAME_PLACE * self.scan.counts.clamp(min=1)
        left = shared.new_ones(len(shared)) & (self.cosines > -torch.inf)
        for thing in self.cosines.argsort(descending=True, stable=True).tolist():
            if left[thing]:
                left &= ~(shared[thing] | shared[:, thing])
                yield thing, self.search.name


Asked: TypeAlias = "AskedScan | AskedImage"


def _is_same(one: ThingTable, other: ThingTable) -> bool:
    """Return whether two tables say the same of names and embeddings."""
    votes = [torch.zeros(0) if each.names is None else each.names.matrix(len(each)) for each in (one, other)]
    return torch.equal(one.embeddings, other.embeddings) and torch.equal(*votes)


def rank_of(scores: Tensor, leads: Tensor) -> Tensor:
    """Return the ranks of things of all scans from their scores (NaN if not judged) and leads.

    A lead says how much better a thing fits a text than the everyday words that fit it best. Where many scores are
    high, it tells scans apart better than they do.
    """
    return scores.nan_to_num(-1) + LEAD * leads


def words_digest(words: Tensor) -> str:
    """Return the digest of words [B, D] and of the rule by which things are compared with them."""
    return hashlib.sha256(repr(_RULE).encode() + words.contiguous().numpy().tobytes()).hexdigest()[:32]
