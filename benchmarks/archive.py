"""Which scans contain a thing, and where: an archive's answers against plain cosines."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from benchmarks.answer_presence import auc
from benchmarks.archive_scans import Floats, TrueScan, World
from benchmarks.data import data_folder
from benchmarks.embedding_kinds import KINDS
from benchmarks.study import Record, Study
from scoup.archive.search import LEAD
from scoup.query.matching import choose_things
from scoup_lab.bench import markdown
from scoup_lab.evaluate.metrics import bootstrap_interval

FIRST = 10  # scans, for the recall
TEXT = "teapot"


RULES = {"cosine": "plain cosine", "own": "score in its own scan", "rank": "score and lead (`scoup archive`)"}
"""Key -> title of what scans are ordered by."""


@dataclass(frozen=True, kw_only=True)
class Archives(Study):
    """Search archives of simulated scans and of the four scenes with real models for the names of things."""

    data: Path = field(default_factory=data_folder)
    """Folder of the scenes with real models."""
    scans: int = 50
    """Simulated scans of an archive."""
    seeds: tuple[int, ...] = (0, 1, 2)
    """Archives of each kind of embeddings."""

    rows_depend_on = ("scans",)

    def measure(self, known: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        world = World.open(self.data)
        for seed in self.seeds:
            for kind in KINDS:
                if f"{kind}/{seed}" not in known:
                    scans = world.simulate(KINDS[kind], self.scans, seed)
                    yield f"{kind}/{seed}", _figures(world, scans)
        if "real/0" not in known:
            yield "real/0", _figures(world, world.real(self.data))

    def line(self, figures: Any) -> str:
        return json.dumps({key: of for key, of in figures.items() if key != "texts"})

    def record(self, rows: dict[str, Any]) -> Record:
        kinds = dict.fromkeys(name.partition("/")[0] for name in rows)
        return {
            "kinds": {
                kind: _summary({n: of for n, of in rows.items() if n.startswith(kind)}) for kind in kinds
            }
        }

    @staticmethod
    def table(record: Record) -> str:
        titles = {"real": "real models"} | {name: kind.title for name, kind in KINDS.items()}
        names = ("AP", "place", "AUC")
        heads = [f"{titles[kind]}: {name}" for kind in record["kinds"] for name in names]
        body = [
            [title, *(_cell(name, of[rule][name]) for of in record["kinds"].values() for name in names)]
            for rule, title in RULES.items()
        ]
        return markdown(["scans ordered by", *heads], body)


def _figures(world: World, scans: Sequence[TrueScan]) -> Record:
    """Return per text the figures of each rule, and the AUC of each rule over all scans and texts."""
    queries = world.of(world.asked)
    there = np.array([[bool(scan.boxes.get(word)) for word in world.asked] for scan in scans])
    scores = {rule: np.zeros(there.shape) for rule in RULES}
    placed = {rule: np.zeros(there.shape) for rule in RULES}
    for number, true in enumerate(scans):
        known = true.index
        fits = known.fits(queries)
        chosen = torch.zeros_like(fits, dtype=torch.bool)
        for text, (choice,) in enumerate(choose_things(known, fits)):
            if choice is not None:
                chosen[[*choice.things], text] = True
        null = known.best_fits[0].sort().values
        own = torch.searchsorted(null, fits.contiguous()).double() / len(null)
        cosines = torch.where(known.usable[:, None], known.cosines(queries), -torch.inf).double()
        of_things = {"own": own + 1e-6 * fits, "rank": own + LEAD * known.leads(fits)}
        of_things = {rule: torch.where(chosen, of, -torch.inf) for rule, of in of_things.items()}
        for rule, of in {"cosine": cosines, **of_things}.items():
            scores[rule][number], things = (each.numpy() for each in of.max(0))
            placed[rule][number] = [true.contains(*each) for each in zip(world.asked, things, strict=True)]
    texts: Record = {}
    for text in np.flatnonzero(there.any(0) & ~there.all(0)):
        mine = there[:, text]
        texts[world.asked[text]] = {
            rule: [
                *_ranking(score[:, text], mine),
                float(placed[rule][mine, text].mean()),
            ]
            for rule, score in scores.items()
        }
    mixed = [number for number in range(len(scans)) if there[number].any() and not there[number].all()]
    return {
        "things": sum(len(each.table) for each in scans),
        "AUC": {rule: auc(score[there], score[~there]) for rule, score in scores.items()},
        "AUC per scan": {
            rule: float(np.mean([auc(score[n][there[n]], score[n][~there[n]]) for n in mixed]))
            for rule, score in scores.items()
        },
        "texts": texts,
    }


def _cell(name: str, of: Sequence[float]) -> str:
    mean, low, high = (f"{100 * part:.1f}" for part in of)
    return mean if name == "AUC" else f"{mean} [{low}, {high}]"


def _ranking(scores: Floats, there: NDArray[np.bool_]) -> list[float]:
    """Return average precision, and the recall among the first scans as a share of what is possible."""
    found = there[np.argsort(-scores, kind="stable")]
    precision = found.cumsum() / np.arange(1, len(found) + 1)
    return [float(precision[found].mean()), float(found[:FIRST].sum() / min(FIRST, found.sum()))]


def _summary(rows: Mapping[str, Record]) -> Record:
    """Return by rule AP, recall, AUC, AUC per scan and place with their 95 % intervals over texts and archives."""
    found: Record = {}
    for rule in RULES:
        values = {(name, text): of[rule] for name, each in rows.items() for text, of in each["texts"].items()}
        groups = [text for _, text in values]
        columns = [bootstrap_interval([of[place] for of in values.values()], groups) for place in range(3)]
        areas = [
            bootstrap_interval([each[name][rule] for each in rows.values()], [*rows])
            for name in ("AUC", "AUC per scan")
        ]
        every = dict(
            zip(
                ("AP", "recall", "AUC", "AUC per scan", "place"),
                (*columns[:2], *areas, columns[2]),
                strict=True,
            )
        )
        found[rule] = {name: [round(x, 4) for x in (of.mean, of.low, of.high)] for name, of in every.items()}
    return found
