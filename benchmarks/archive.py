"""Which scans contain a thing, and where: an archive's answers against plain cosines, and scores across scans."""

from __future__ import annotations

import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
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
from scoup.archive.archive import ABOUT, FORMAT, VERSION, Archive
from scoup.archive.scan_files import write_scan
from scoup.archive.search import words_digest
from scoup.models.text import TextEncoder
from scoup.models.word_table import save_table
from scoup.models.words import CANONICAL_PHRASES
from scoup.query.matching import ComparedTable, choose_things
from scoup_lab.bench import markdown
from scoup_lab.evaluate.metrics import bootstrap_interval

FIRST = 10  # scans, for the recall
TEXT = "teapot"


@dataclass(frozen=True, eq=False)
class Fits:
    """How S scans fit Q texts and B everyday words."""

    fits: Floats  # [S, Q] of the best thing that answers
    cosines: Floats  # [S, Q] the largest
    null: Floats  # [S, B] best fits


def _centred(of: Fits) -> Floats:
    return (of.fits - of.null.mean(1, keepdims=True)) / of.null.std(1, keepdims=True)


def _tail(of: Fits) -> Floats:
    """In means of the excess over the 80 % quantile of the scan's words: an exponential tail."""
    start = np.quantile(of.null, 0.8, axis=1, keepdims=True)
    above = of.null > start
    return (of.fits - start) / (((of.null - start) * above).sum(1) / above.sum(1))[:, None]


def _against_the_archive(of: Fits) -> Floats:
    centred = _centred(of)
    return (centred - centred.mean(0)) / centred.std(0)


def _both_sides(of: Fits) -> Floats:
    return of.fits - 0.5 * np.sort(of.fits, 0)[-FIRST:].mean(0)


RULES: dict[str, tuple[str, Callable[[Fits], Floats]]] = {
    "cosine": ("plain cosine", lambda of: of.cosines),
    "own": (
        "score in its own scan (`scoup archive`)",
        lambda of: (of.null[:, None] < of.fits[:, :, None]).mean(2) + 1e-6 * of.fits,
    ),
    "half": (
        "fit, less half of its scan's mean",
        lambda of: of.fits - 0.5 * of.null.mean(1, keepdims=True),
    ),
    "tail": ("exponential tail per scan", _tail),
    "both": ("local scaling on both sides", _both_sides),
    "text z": ("z-score per text against the archive", _against_the_archive),
}
"""Key -> title, and the scores [S, Q] of scans for texts, by which they are ordered."""


@dataclass(frozen=True, kw_only=True)
class Archives(Study):
    """Search archives of simulated scans and of the four scenes with real models for the names of things; time it."""

    data: Path = field(default_factory=data_folder)
    """Folder of the scenes with real models."""
    scans: int = 50
    """Simulated scans of an archive."""
    seeds: tuple[int, ...] = (0, 1, 2)
    """Archives of each kind of embeddings. Rules were compared on the seeds 100 and 101."""
    things: tuple[int, ...] = (150_000,)
    """Things of the archives that are timed."""

    rows_depend_on = ("scans",)

    def measure(self, known: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        world = World.open(self.data)
        for seed in self.seeds:
            for kind in KINDS:
                if f"{kind}/{seed}" not in known:
                    scans = world.simulate(KINDS[kind], self.scans, seed)
                    yield f"{kind}/{seed}", _figures(world, scans)
        with tempfile.TemporaryDirectory() as name:
            if "real/0" not in known:
                yield "real/0", _figures(world, world.real(self.data, Path(name)))
            for count in self.things:
                if f"times/{count}" not in known:
                    yield f"times/{count}", _times(world, count, Path(name) / str(count))

    def line(self, figures: Any) -> str:
        return json.dumps({key: of for key, of in figures.items() if key != "texts"})

    def record(self, rows: dict[str, Any]) -> Record:
        kinds = dict.fromkeys(name.partition("/")[0] for name in rows if not name.startswith("times"))
        return {
            "kinds": {
                kind: _summary({n: of for n, of in rows.items() if n.startswith(kind)}) for kind in kinds
            },
            "times": {name.partition("/")[2]: of for name, of in rows.items() if name.startswith("times")},
        }

    @staticmethod
    def table(record: Record) -> str:
        titles = {"real": "real models"} | {name: kind.title for name, kind in KINDS.items()}
        names = ("AP", "place", "AUC")
        heads = [f"{titles[kind]}: {name}" for kind in record["kinds"] for name in names]
        body = [
            [title, *(_cell(name, of[rule][name]) for of in record["kinds"].values() for name in names)]
            for rule, (title, _) in RULES.items()
        ]
        seconds = [
            [f"{of['things']:,} things", what, *(f"{part:.2f}" for part in parts)]
            for of in record["times"].values()
            for what, parts in of["seconds"].items()
        ]
        times = markdown(["archive of", "what", "seconds", "processor seconds"], seconds)
        return markdown(["scans ordered by", *heads], body) + "\n\n" + times


def _figures(world: World, scans: Sequence[TrueScan]) -> Record:
    """Return per text the figures of each rule, and the AUC of each rule over all scans and texts."""
    queries, everyday = world.of(world.asked), world.of(world.everyday)
    there = np.array([[bool(scan.boxes.get(word)) for word in world.asked] for scan in scans])
    rows, placed = [], {"fits": np.zeros(there.shape), "cosines": np.zeros(there.shape)}
    for number, true in enumerate(scans):
        scan = true.scan
        known = ComparedTable.known(scan.table, everyday, scan.hubs, scan.counts, scan.shared)
        fits = known.fits(queries)
        cosines = torch.where(known.usable[:, None], known.embeddings @ queries.T, -torch.inf).max(0)
        things = [[] if choice is None else choice.things.tolist() for choice in choose_things(known, fits)]
        best = [of[int(fits[of, text].argmax())] for text, of in enumerate(things)]
        for name, chosen in (("fits", best), ("cosines", cosines.indices.tolist())):
            placed[name][number] = [
                true.contains(word, thing) for word, thing in zip(world.asked, chosen, strict=True)
            ]
        rows.append((fits[best, range(len(best))], cosines.values, scan.record.best_fits))
    of = Fits(*(torch.stack(part).double().numpy() for part in zip(*rows, strict=True)))
    scores = {rule: score(of) for rule, (_, score) in RULES.items()}
    texts: Record = {}
    for text in np.flatnonzero(there.any(0) & ~there.all(0)):
        mine = there[:, text]
        texts[world.asked[text]] = {
            rule: [
                *_ranking(score[:, text], mine),
                float(placed["cosines" if rule == "cosine" else "fits"][mine, text].mean()),
            ]
            for rule, score in scores.items()
        }
    mixed = [number for number in range(len(scans)) if there[number].any() and not there[number].all()]
    return {
        "things": sum(len(each.scan.counts) for each in scans),
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


def _times(world: World, count: int, folder: Path) -> Record:
    """Return wall and processor seconds, and memory, with an archive of so many things: some scans many times."""
    folder.mkdir()
    words = [*world.everyday, *CANONICAL_PHRASES]
    table = folder / "words.npz"
    save_table(table, words, world.of(words).numpy(), model="simulated")
    about = {
        "format": FORMAT,
        "version": VERSION,
        "embedding_model": "simulated",
        "dim": 512,
        "words": "words.npz",
    }
    (folder / ABOUT).write_text(json.dumps(about))
    some = [each.scan for each in world.simulate(KINDS["clip"], 48, seed=7)]
    files = [folder / f"{scan.record.name}.parquet" for scan in some]
    encoder = TextEncoder.open(table)
    digest = words_digest(encoder.everyday())
    written = [
        _seconds(write_scan, replace(scan, record=replace(scan.record, file=file, words=digest)))
        for scan, file in zip(some, files, strict=True)
    ]
    clock: Record = {"write one scan": np.median(written, 0).tolist()}
    total, number = sum(len(scan.counts) for scan in some), 0
    while total < count:
        shutil.copy(files[number % len(some)], folder / f"copy-{number:05}.parquet")
        total += len(some[number % len(some)].counts)
        number += 1
    shell = [sys.executable, "-c", "from scoup.cli.app import entry; entry()", "archive", str(folder)]
    for name, words in (("shell, empty", ["--help"]), ("shell", [TEXT])):
        clock[name] = _seconds(subprocess.run, [*shell, *words], check=True, stdout=subprocess.DEVNULL)
    memory = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1e3
    archive = Archive(folder, encoder)
    clock["first text"] = _seconds(archive.find, TEXT)
    clock["further texts"] = np.median([_seconds(archive.find, text) for text in world.asked[:5]], 0).tolist()
    clock["same texts again"] = np.median(
        [_seconds(archive.find, text) for text in world.asked[:5]], 0
    ).tolist()
    os.utime(files[0])
    clock["a text after one scan was added"] = _seconds(archive.find, TEXT)
    clock["remove one scan"] = _seconds(archive.remove, files[0].stem)
    size = sum(file.stat().st_size for file in folder.glob("*.parquet"))
    return {
        "things": total,
        "scans": number + len(some),
        "files in MB": size / 1e6,
        "memory in MB": memory,
        "seconds": clock,
    }


def _seconds(work: Callable[..., Any], *arguments: Any, **options: Any) -> list[float]:
    """Return wall and processor seconds, children's included."""
    before, start = os.times(), time.perf_counter()
    work(*arguments, **options)
    after = os.times()
    return [round(time.perf_counter() - start, 3), round(sum(after[:4]) - sum(before[:4]), 3)]
