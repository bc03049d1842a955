"""The quality of answers, by ways of building a field and rules of reading an answer from it."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from statistics import mean
from typing import Any, ClassVar

import torch

from benchmarks.answer_scenes import AnswerScene, make_scene
from benchmarks.study import Record
from benchmarks.ways import DRAWS, LAYOUTS, WAYS, StudyOfScenes, groups_of
from scoup.models.words import with_everyday
from scoup.query.answering import answer_view
from scoup.query.localize import localize
from scoup.query.presence import PRESENT_FROM
from scoup.query.presets import QUERY_PRESETS
from scoup.query.question import Question
from scoup.query.segment import segment
from scoup.uplift.build_settings import BuildSettings
from scoup_lab.baselines.fitted import FittedField, FittedMethod
from scoup_lab.baselines.method import MethodSettings
from scoup_lab.bench import markdown
from scoup_lab.evaluate.metrics import any_inside, bootstrap_interval, iou

RULES = ("peak", "always", "asked", "localisation")
SLOW = frozenset({"paper"})  # which takes a minute a level: the first seed alone
COMPARED = (
    ("default", "dense"),
    ("default", "paper"),
    ("default", "votes"),
    ("paper", "dense"),
)


@dataclass(frozen=True, kw_only=True)
class Answers(StudyOfScenes):
    """Score ways of building a field by rules of reading an answer, with paired differences.

    Scenes are draws of the kitchen (`benchmarks.kitchen_draws`; "kitchen-11x2" has noise twice as strong,
    "kitchen-11-desk" and "kitchen-11-clip" the statistics of `benchmarks.embedding_kinds`), procedural layouts, and the
    real "desk" and "desk-all". Cases put faults into their regions (`scoup_lab.synthetic.faults`). Masks and embeddings
    are simulated everywhere but on desk: figures compare ways with each other and cannot be set against published ones.

    All ways are scored by the same rules. peak: the protocol of LERF-OVS, threshold 0.6, the level with the largest
    relevancy. always: as `scoup query --always` answers. asked: as `scoup query` answers; a text that it calls absent
    scores 0, and ways that are no field, which cannot judge presence, have none. localisation: by the protocol of
    LERF-OVS, 1 where the point is right.
    """

    scenes: tuple[str, ...] = (*DRAWS, *(f"{name}x2" for name in DRAWS), *LAYOUTS)
    """Draws of the kitchen, layouts of benchmarks.scenes with a seed, desk and desk-all."""
    cases: tuple[str, ...] = ("clean",)
    """Faults, see scoup_lab.synthetic.faults."""
    ways: tuple[str, ...] = ("dense", "votes", "default")
    """Names of WAYS; paper takes minutes a scene and seed."""
    seeds: tuple[int, ...] = (2, 3, 4)
    """Of the codebook; scores are means over them."""
    epochs: int = 4000
    """Of the Adam solver."""

    rows_depend_on: ClassVar[tuple[str, ...]] = ("seeds", "epochs", "size")

    def measure(self, known: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        for name in self.scenes:
            keys = [
                (case, way) for case in self.cases for way in self.ways if f"{name}/{case}/{way}" not in known
            ]
            scene = make_scene(name, self.data, self.size) if keys else None
            for case, way in keys:
                assert scene is not None
                yield f"{name}/{case}/{way}", {"pairs": scene.pairs, "scores": self._scores(scene, case, way)}

    def _scores(self, scene: AnswerScene, case: str, way: str) -> Record:
        """Return per rule the IoU of each pair as means over seeds, and what it took."""
        inputs, method, started = scene.inputs(case), WAYS[way], time.perf_counter()
        build = BuildSettings(epochs=self.epochs)
        by_seed, size = [], 0.0
        for seed in self.seeds if method.random and way not in SLOW else self.seeds[:1]:
            fitted = method.uplift(inputs, MethodSettings(seed, build))
            by_seed.append(score(scene, fitted))
            size = fitted.bytes_per_gaussian
        means = {
            rule: [round(mean(each), 3) for each in zip(*(of[rule] for of in by_seed), strict=True)]
            for rule in RULES
        }
        by_seeds = {rule: [round(mean(of[rule]), 4) for of in by_seed] for rule in RULES if by_seed[0][rule]}
        seconds = round(time.perf_counter() - started, 1)
        return {**means, "seeds": by_seeds, "bytes_per_gaussian": size, "seconds": seconds}

    def line(self, figures: Any) -> str:
        scores = figures["scores"]
        return "  ".join(f"{rule} {mean(scores[rule]):.3f}" for rule in RULES if scores[rule])

    def record(self, rows: dict[str, Any]) -> Record:
        """Return means over scenes, and paired differences: queries are drawn, each scene counting alike."""
        pairs: Record = {}
        scores: Record = {}
        for key, figures in rows.items():
            name, case, way = key.split("/")
            pairs[name] = figures["pairs"]
            scores.setdefault(f"{name}/{case}", {})[way] = figures["scores"]
        sets = {
            f"{kind}, {case}": [f"{name}/{case}" for name in names]
            for case in self.cases
            for kind, names in groups_of(self.scenes).items()
        }
        cells = list(dict.fromkeys(cell for each in sets.values() for cell in each))
        if len(sets) > 1:
            sets["all"] = cells
        return {
            "settings": {name: self.settings()[name] for name in self.rows_depend_on},
            "ways": {
                way: {key: _means(scores, each, way) for key, each in sets.items()} for way in self.ways
            },
            "scenes": {way: {cell: _means(scores, [cell], way) for cell in cells} for way in self.ways},
            "differences": {
                f"{first} - {second}": {
                    key: {rule: _difference(scores, pairs, each, (first, second), rule) for rule in RULES}
                    for key, each in sets.items()
                }
                for first, second in COMPARED
                if {first, second} <= set(self.ways)
            },
            "pairs": pairs,
            "scores": {
                cell: {way: scores[cell][way] for way in self.ways if way in scores[cell]} for cell in scores
            },
        }

    @staticmethod
    def table(record: Record) -> str:
        keys = next(iter(record["ways"].values()))
        return "\n".join(f"\n{key}\n\n" + table_of(record, key) for key in keys)


def score(scene: AnswerScene, fitted: FittedMethod) -> dict[str, list[float]]:
    """Return per rule the IoU of each (frame, label) pair, or whether it is a hit; none if the way cannot follow it."""
    scores: dict[str, list[float]] = {rule: [] for rule in RULES}
    everyday = with_everyday(scene.canonical, scene.everyday)
    fixed, asked = QUERY_PRESETS["scoup"], QUERY_PRESETS["default"]
    field = fitted.field if isinstance(fitted, FittedField) else None
    if field is not None:
        field.attach(scene.gaussians, known=True)
    for (frame, view), camera in zip(scene.frames, scene.cameras, strict=True):
        queries = torch.stack([scene.queries[label] for label in frame.labels])
        plain = fitted.relevancy(view, queries, scene.canonical)  # [S, Q, H, W]
        if field is not None:
            question = Question(
                tuple(frame.labels), queries, everyday, scene.everyday, scene.name, present_from=-math.inf
            )
            answers = answer_view(field, camera, question, view)
            found = [iou(answer.mask, frame.masks[answer.text]) for answer in answers]
            scores["always"] += found
            there = [(answer.z_score or 0) >= PRESENT_FROM for answer in answers]
            scores["asked"] += [each * float(present) for each, present in zip(found, there, strict=True)]
        for position, label in enumerate(frame.labels):
            truth = frame.masks[label]
            hit = any_inside(localize(plain[:, position], fixed).pixels, frame.boxes[label])
            scores["localisation"].append(float(hit))
            scores["peak"].append(iou(segment(plain[:, position], fixed).mask, truth))
            if field is None:
                votes = segment(fitted.relevancy(view, queries[[position]], everyday)[:, 0], asked)
                scores["always"].append(iou(votes.mask, truth))
    return scores


def table_of(record: Record, key: str) -> str:
    """Return Markdown of one set of scenes: every way by every rule, then the differences."""
    body = [
        [way, *("" if of[key][rule] is None else f"{of[key][rule]:.3f}" for rule in RULES)]
        for way, of in record["ways"].items()
    ]
    body += [
        [name, *(difference_cell(of[key][rule]) for rule in RULES)]
        for name, of in record["differences"].items()
    ]
    return markdown(["way", *RULES], body)


def difference_cell(values: Sequence[float] | None) -> str:
    """Return a difference with its interval; nothing where there is none."""
    return "{:+.3f} [{:+.3f}, {:+.3f}]".format(*values) if values else ""


def _means(scores: Record, cells: Sequence[str], way: str) -> Record:
    found = {}
    for rule in RULES:
        values = [scores[cell][way][rule] for cell in cells]
        found[rule] = round(mean(mean(each) for each in values), 4) if all(values) else None
    return found


def _difference(
    scores: Record, pairs: Record, cells: Sequence[str], ways: tuple[str, str], rule: str
) -> list[float] | None:
    values, labels, scenes = [], [], []
    for cell in cells:
        both = [scores[cell][way][rule] for way in ways]
        if not all(both):
            return None
        of_cell = pairs[cell.split("/")[0]]
        values += [a - b for a, b in zip(*both, strict=True)]
        labels += [label for _, label in of_cell]
        scenes += [cell] * len(of_cell)
    found = bootstrap_interval(values, labels, scenes=scenes)
    return [round(value, 4) for value in (found.mean, found.low, found.high)]
