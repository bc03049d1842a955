"""Things of one scene or many, compared with everyday words: answers to texts, and their presence.

The fit of a thing to a text is their cosine, less half of the cosine with the words that fit the thing best: some
things are near to any word (local scaling of cosines, one side of it; Conneau et al. 2018). Its unit is the scene's
spread, by how much the cosines of one thing's regions with a text differ (``ThingTable.spread``), so that a gap means
the same for every embedding model. Things of few regions, and those that views segment differently, fit less: their
means are less certain, and they are more often a part or a blend of what people name.

Fields, pages, agents and archives ask ``ThingIndex``; a field is an index of one scene. ``scoup.query.matching``
chooses, ``scoup.query.presence`` scores. Ours; measured in docs/answers.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import accumulate, combinations, islice, pairwise
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from scoup.field import NO_THING, Field, NameTable, ThingTable
from scoup.models import TextEncoder
from scoup.query import constants
from scoup.query.answer import RunnerUp
from scoup.query.matching import Choice, choose_things
from scoup.query.named import Named, find_named, joined
from scoup.query.presence import Certainty, TextScore, certainty, is_present, text_scores
from scoup.query.question import Question, TextVectors, check_encoder, near_names

NUMBERS_AT_A_TIME = 1 << 15  # that PyTorch converts in one thread
_ARRAYS = ("levels", "counts", "mass", "usable", "doubt", "spread", "hubs", "best_fits")
THINGS_AT_A_TIME = 512  # whose fits to all everyday words are in memory together


class Shares(NamedTuple):
    """Gaussians that two things of a scene share, both ways; a thing shares all that it has with itself."""

    ends: Tensor
    """[N + 1] int64: the pairs of thing n are those from ``ends[n]`` to ``ends[n + 1]``."""
    others: Tensor
    """[E] int32, number of the other thing in its scene, rising."""
    gaussians: Tensor
    """[E] float32."""

    def pairs(self) -> list[tuple[int, int, float]]:
        """Return two things of one scene, and the Gaussians that they share, for each pair."""
        rows = torch.arange(len(self.ends) - 1).repeat_interleave(self.ends.diff())
        return list(zip(rows.tolist(), self.others.tolist(), self.gaussians.tolist(), strict=True))


class Verdict(NamedTuple):
    """The answer of one scene to one text."""

    things: tuple[int, ...]
    """Numbers in the scene, of one level, best first; empty where no thing is usable."""
    scores: tuple[float | None, ...]
    """Of each of them alone."""
    level: int
    score: float | None
    presence: bool
    runner_up: RunnerUp | None

    @property
    def certainty(self) -> Certainty | None:
        """As of ``Answer``."""
        return certainty(self.score, self.presence)


@dataclass(frozen=True, eq=False)
class ThingIndex:
    """N things of S scenes, compared with B everyday words. Things of a scene follow each other."""

    words: Tensor  # [B, D]
    vectors: tuple[Tensor, ...]  # per scene [T, D], mean embeddings of unit norm
    levels: Tensor  # [N] uint8
    counts: Tensor  # [N] float32, Gaussians
    mass: Tensor  # [N] float32
    usable: Tensor  # [N] boolean: things that may answer, as they have Gaussians and an embedding
    doubt: Tensor  # [N] float32, how much few regions and instability lower a fit
    spread: Tensor  # [N] float32, of the scene
    hubs: Tensor  # [N] float32, the cosine at ``constants.HUB_QUANTILE``
    shares: Shares
    known_best_fits: Tensor | None = None  # [S, B] float32

    @classmethod
    def of(cls, things: ThingTable, words: Tensor) -> ThingIndex:
        """Compare things with everyday words, or with whatever stands in their place."""
        counts = things.sums(torch.ones(len(things.owners))).float()
        vectors, mass = things.embeddings.float().cpu(), things.mass.cpu()
        return cls(
            words=words.clone(),
            vectors=(vectors,),
            levels=things.levels.cpu(),
            counts=counts,
            mass=mass,
            usable=(counts > 0) & vectors.any(1) & (mass > 0),
            doubt=_doubt(things.n_regions.cpu(), things.stability.cpu()),
            spread=torch.full_like(mass, things.spread),
            hubs=hub_cosines(vectors, words),
            shares=shared_gaussians(things),
        )

    @classmethod
    def of_field(cls, field: Field, encoder: TextEncoder) -> ThingIndex | None:
        """Return ``thing_index`` with the everyday words of an encoder, which must fit (``check_encoder``)."""
        check_encoder(field, encoder)
        return thing_index(field, Question.encoded(encoder, []))

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Tensor], vectors: Tensor, words: Tensor) -> ThingIndex:
        """Return the index of one scene from its ``arrays``, vectors [T, D] and words [B, D]."""
        parts, shares = {name: arrays[name] for name in _ARRAYS}, map(arrays.__getitem__, Shares._fields)
        return cls(words, (vectors,), shares=Shares(*shares), known_best_fits=parts.pop("best_fits"), **parts)

    def arrays(self) -> dict[str, Tensor]:
        """Return all but vectors and words."""
        return {name: getattr(self, name) for name in _ARRAYS} | self.shares._asdict()

    @classmethod
    def joined(cls, indices: Sequence[ThingIndex]) -> ThingIndex:
        """Return one index of the scenes of several, one at least, all compared with the same words."""
        first = [0, *accumulate(len(index.shares.others) for index in indices)]
        shares = Shares(
            torch.cat([index.shares.ends[:-1] + start for index, start in zip(indices, first, strict=False)]
                      + [torch.tensor(first[-1:])]),
            torch.cat([index.shares.others for index in indices]),
            torch.cat([index.shares.gaussians for index in indices]),
        )  # fmt: skip
        return cls(
            words=indices[0].words,
            vectors=tuple(vectors for index in indices for vectors in index.vectors),
            shares=shares,
            known_best_fits=pad_sequence([fits for index in indices for fits in index.best_fits], True),
            **{name: torch.cat([getattr(index, name) for index in indices]) for name in _ARRAYS[:-1]},
        )

    def with_words(self, words: Tensor) -> ThingIndex:
        """Return the index of other words."""
        hubs = torch.cat([hub_cosines(vectors, words) for vectors in self.vectors])
        return replace(self, words=words, hubs=hubs, known_best_fits=None)

    @cached_property
    def starts(self) -> list[int]:
        """[S + 1] first thing of each scene, and N."""
        return [*accumulate(map(len, self.vectors), initial=0)]

    def cosines(self, queries: Tensor) -> Tensor:
        """Return the cosines [N, Q] float32 of all things with unit vectors [Q, D].

        Each scene has a product of its own: of several together, the last bits would differ from those of one alone.
        """
        queries = queries.float().cpu().T
        return torch.cat([_float(vectors) @ queries for vectors in self.vectors])

    def fits(self, queries: Tensor) -> Tensor:
        """Return the fits [N, Q] float32 of all things to unit vectors [Q, D], in units of the scene's spread."""
        return self._fits(self.cosines(queries), slice(None))

    def _fits(self, cosines: Tensor, rows: slice) -> Tensor:
        lowered = cosines - constants.HUB_SHARE * self.hubs[rows, None]
        return lowered / self.spread[rows, None] - self.doubt[rows, None]

    def leads(self, fits: Tensor) -> Tensor:
        """Return the leads [N, Q] of things, from their fits to texts, over the everyday words that fit them best."""
        return fits - ((1 - constants.HUB_SHARE) * self.hubs / self.spread)[:, None]

    @cached_property
    def best_fits(self) -> Tensor:
        """The best fit of each everyday word with a thing that it does not name, in each scene, [S, B] float32.

        A word names the things that it fits better than all other words. So words of what is in the scene, of which a
        small table may have nothing else, say the same as words of what is not.
        """
        if self.known_best_fits is not None:
            return self.known_best_fits
        best = torch.full((len(self.vectors), len(self.words)), -torch.inf)
        for scene, (first, end) in enumerate(pairwise(self.starts)):
            for start in range(first, end, THINGS_AT_A_TIME):
                rows = slice(start, min(end, start + THINGS_AT_A_TIME))
                cosines = self.vectors[scene][start - first :][:THINGS_AT_A_TIME].float() @ self.words.T
                fits = self._fits(cosines, rows)
                fits.scatter_(1, cosines.argmax(1, keepdim=True), -torch.inf)
                fits[~self.usable[rows]] = -torch.inf
                best[scene] = torch.maximum(best[scene], fits.amax(0))
        return best

    def shared(self, things: Tensor, counted: Tensor, width: int) -> Tensor:
        """Return the Gaussians that things [...], where they are ``counted``, share with the first ``width`` of their
        scenes, [..., width] float32."""
        ends, things = self.shares.ends, things.flatten()
        sizes = torch.where(counted.flatten(), ends[things + 1] - ends[things], 0)
        rows = torch.arange(len(things)).repeat_interleave(sizes)
        pairs = torch.arange(len(rows)) + (ends[things] - sizes.cumsum(0) + sizes)[rows]
        shared = torch.zeros(len(things), width)
        shared[rows, self.shares.others[pairs].long()] = self.shares.gaussians[pairs]
        return shared.view(*counted.shape, width)

    def text_scores(
        self, question: Question[Any], fits: Tensor, named: Sequence[Mapping[int, Named]] = ()
    ) -> list[TextScore]:
        """Return the score of each text from the fits [N, Q] (``scoup.query.presence.text_scores``)."""

        def nearer(number: int, scene: int) -> Tensor:
            rows = slice(*self.starts[scene : scene + 2])
            best = torch.where(self.usable[rows], fits[rows, number], -torch.inf).argmax()
            vector = self.vectors[scene][best].float()
            return self.words @ vector - question.queries[number].float().cpu() @ vector

        every = [partial(nearer, number) for number in range(len(question.texts))]
        return text_scores(question, self.best_fits, named, every)

    def judge(
        self,
        question: Question[Any],
        named: Sequence[Mapping[int, Named]],
        known_fits: Tensor | None = None,
    ) -> Iterator[list[Verdict]]:
        """Yield the answer of each scene to each text of a question. ``named`` says for each text, by scene, what a
        model with words said of it (``named_texts``); ``known_fits`` [N, Q] are of its texts, if asked for before."""
        fits = self.fits(question.queries) if known_fits is None else known_fits
        scores = self.text_scores(question, fits, named)
        for number, choices in enumerate(choose_things(self, fits, question.level)):
            text_fits = fits[:, number]
            for scene, name in named[number].items():
                choice, rows = choices[scene], slice(*self.starts[scene : scene + 2])
                if choice is not None and name.is_sure:
                    parts = self.levels[rows], self.usable[rows], text_fits[rows]
                    choices[scene] = joined(choice, name.votes, *parts, question.level)
            yield self._verdicts(question, choices, text_fits, scores[number])

    def _verdicts(
        self, question: Question[Any], choices: Sequence[Choice | None], fits: Tensor, score: TextScore
    ) -> list[Verdict]:
        level, least = question.level or 0, question.present_from
        nothing = 0.0 if question.can_judge_presence else None
        verdicts = [Verdict((), (), level, nothing, is_present(nothing, 0, least), None)] * len(choices)
        made = [(scene, choice) for scene, choice in enumerate(choices) if choice is not None]
        rivals = [
            (scene, choice.runner_up)
            for scene, choice in made
            if choice.runner_up is not None
            and float(fits[self.starts[scene] + choice.runner_up]) >= choice.fit - constants.RUNNER_UP
        ]
        rows = [self.starts[scene] + rival for scene, rival in rivals]
        of_rivals = score.each(fits[rows].tolist(), *zip(*rivals, strict=True)) if rivals else []
        runners_up = {
            scene: RunnerUp(rival, value) for (scene, rival), value in zip(rivals, of_rivals, strict=True)
        }
        scores = score.each([choice.fit for _, choice in made], [scene for scene, _ in made])
        things = [(scene, thing) for scene, choice in made for thing in choice.things]
        rows = [self.starts[scene] + thing for scene, thing in things]
        counts = iter(self.counts[rows].tolist())
        alone = iter(score.each(fits[rows].tolist(), *zip(*things, strict=True)) if things else ())
        for (scene, choice), value in zip(made, scores, strict=True):
            size = len(choice.things)
            present = is_present(value, int(sum(islice(counts, size))), least)
            verdicts[scene] = Verdict(
                choice.things, tuple(islice(alone, size)), choice.level, value, present, runners_up.get(scene)
            )
        return verdicts


@dataclass(frozen=True, eq=False)
class AskedThings:
    """The things of an index, asked the texts of a question."""

    index: ThingIndex
    question: Question[Any]
    names: Sequence[NameTable | None]  # of the things of each scene
    encoder: TextEncoder
    encode: Callable[[tuple[str, ...]], Tensor]  # of the encoder, with a cache

    @cached_property
    def fits(self) -> Tensor:
        """[N, Q]."""
        return self.index.fits(self.question.queries)

    @cached_property
    def _named(self) -> list[dict[int, Named]]:
        """For each text, by scene."""
        named: dict[int, list[Named | None]] = {}
        for scene, names in enumerate(self.names):
            if names is None:
                continue
            near = near_names(names, self.encoder, self.question, self.encode)
            count = len(self.index.vectors[scene])
            named[scene] = find_named(names, count, replace(self.question, near=near))
        texts = range(len(self.question.texts))
        return [{scene: name for scene, of in named.items() if (name := of[text])} for text in texts]

    @cached_property
    def scores(self) -> dict[str, TextScore]:
        """Of each text."""
        scores = self.index.text_scores(self.question, self.fits, self._named)
        return dict(zip(self.question.texts, scores, strict=True))

    @cached_property
    def verdicts(self) -> dict[str, list[Verdict]]:
        """For each text, of the scenes."""
        verdicts = self.index.judge(self.question, self._named, self.fits)
        return dict(zip(self.question.texts, verdicts, strict=True))


def _float(vectors: Tensor) -> Tensor:
    """Return vectors as float32, converted in parts that one thread takes: of thousands of scenes, waiting for other
    threads would take longer than the work."""
    if vectors.dtype == torch.float32:
        return vectors
    converted, rows = torch.empty(vectors.shape), max(1, NUMBERS_AT_A_TIME // vectors.shape[1])
    for target, source in zip(converted.split(rows), vectors.split(rows), strict=True):
        target.copy_(source)
    return converted


def _doubt(n_regions: Tensor, stability: Tensor) -> Tensor:
    few = constants.FEW_REGIONS * n_regions.clamp(min=1).rsqrt()
    return few - constants.UNSTABLE * stability.clamp(min=constants.LEAST_STABILITY).log()


def hub_cosines(vectors: Tensor, words: Tensor) -> Tensor:
    """Return the cosine [T] of each thing with the words [B, D] that fit it best, at ``constants.HUB_QUANTILE``."""
    rank = max(1, math.ceil(constants.HUB_QUANTILE * len(words)))
    batches = vectors.split(THINGS_AT_A_TIME) or [vectors]
    return torch.cat([(batch.float() @ words.T).kthvalue(rank, dim=1).values for batch in batches])


def shared_gaussians(things: ThingTable) -> Shares:
    """Return the numbers of Gaussians that two things of a field share."""
    owners, count = things.owners.cpu().long(), len(things)
    rows = others = torch.arange(count)
    counts = things.sums(torch.ones(len(owners))).float()
    for one, other in combinations(owners.T, 2):
        both = (one != NO_THING) & (other != NO_THING)
        keys, shared = (one[both] * count + other[both]).unique(return_counts=True)
        pairs = keys // max(count, 1), keys % max(count, 1)
        rows, others = torch.cat([rows, *pairs]), torch.cat([others, *reversed(pairs)])
        counts = torch.cat([counts, *[shared.float()] * 2])
    order = (rows * count + others).argsort()
    ends = torch.zeros(count + 1, dtype=torch.int64)
    ends[1:] = torch.bincount(rows, minlength=count).cumsum(0)
    return Shares(ends, others[order].int(), counts[order])


def thing_index(field: Field, texts: TextVectors) -> ThingIndex | None:
    """Return the things of a field, compared with the words of texts; None for a field without things."""
    if field.thing_table is None or not len(field.thing_table):
        return None
    table, words = field.thing_table, texts.compared
    return field.kept((ThingIndex, words.numpy().tobytes()), lambda: ThingIndex.of(table, words))
