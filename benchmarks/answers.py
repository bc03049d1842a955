"""Do the default's answers win? Ways of building a field and rules of reading an answer from it, on scenes that chose
nothing.

    python -m benchmarks.answers [--scenes kitchen-11 ... table-1 ...] [--cases clean wrong20] [--seeds 0 1 2]
        [--ways dense paper votes one-round default] [--epochs 4000] [--rows ROWS.json]
        [--out docs/benchmarks/answers.json]

Scenes are draws of the kitchen (``benchmarks.kitchen_draws``; "kitchen-11x2" has noise twice as strong,
"kitchen-11-desk" and "kitchen-11-clip" the statistics of ``benchmarks.embedding_kinds``), procedural layouts, and the
real "desk" and "desk-all" (``benchmarks.desk``); cases put faults into their regions (``scoup_lab.synthetic.faults``).
What chose the default, its threshold, level and constants: the kitchen as given, its draws 1 to 4 and 2x2 and 3x2, and
table-0, shelves-0, hall-0 and yard-0, with codebook seeds 0 and 1. Those are not among the scenes by default; seeds are
those of the codebook. Masks and embeddings are simulated everywhere but on desk: figures of the other scenes compare
ways with each other and cannot be set against published ones.

Every way is scored by the same rules:

* peak: the protocol of LERF-OVS, threshold 0.6, the level with the largest relevancy;
* mask: the same threshold, the level with the largest mean relevancy in its mask;
* everyday: the same beside everyday words;
* always: as `scoup query --always` answers: things where the way has them, else the stable threshold and the level by
  evidence;
* asked: as `scoup query` answers; a text that it calls absent scores 0. Ways that are no field cannot judge presence
  and have none;
* best level: the stable threshold on the votes, with the best level for each pair, which no rule can know;
* localisation: by the protocol of LERF-OVS, 1 where the point is right.

OUT holds the scores of all pairs (means over the seeds) beside their means and paired differences. With --rows they are
kept while the run goes on, and what is there is not run again.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from statistics import mean
from typing import Any

import torch
import tyro

from benchmarks.answer_scenes import AnswerScene, DrawName, SceneSize, make_scene
from benchmarks.data import data_folder
from benchmarks.desk import DESKS
from benchmarks.embedding_kinds import KINDS
from scoup.base.errors import InputError, looked_up
from scoup.base.records import record_text
from scoup.io import write_text
from scoup.models.words import with_everyday
from scoup.query.answering import answer_view
from scoup.query.localize import localize
from scoup.query.presence import PRESENT_FROM
from scoup.query.presets import QUERY_PRESETS
from scoup.query.question import Question
from scoup.query.segment import choose_level, level_masks
from scoup.uplift.build_settings import BuildSettings
from scoup_lab.baselines.fitted import FittedField, FittedMethod
from scoup_lab.baselines.method import Method, MethodSettings
from scoup_lab.baselines.methods import METHODS
from scoup_lab.baselines.sparse import SparseUplift
from scoup_lab.bench import describe_environment, markdown
from scoup_lab.evaluate.metrics import any_inside, bootstrap_interval, iou

DRAWS = tuple(f"kitchen-{seed}{noise}" for noise in ("", "x2") for seed in (11, 12, 13, 14, 15))
LAYOUTS = ("table-1", "shelves-1", "hall-1", "yard-1")
RULES = ("peak", "mask", "everyday", "always", "asked", "best level", "localisation")
WAYS = {
    "dense": METHODS["dense"],
    "paper": METHODS["paper"],
    "votes": Method("votes", SparseUplift(things=False)),
    "one-round": Method("one-round", SparseUplift(rounds=1)),
    "best-effort": Method("best-effort", SparseUplift(effort="best")),
    "default": METHODS["sparse"],
}
"""By name; those between "paper" and "default" change one thing of the default each."""
SLOW = frozenset({"paper"})  # which takes a minute a level: the first seed alone
COMPARED = (
    ("default", "dense"),
    ("default", "paper"),
    ("default", "votes"),
    ("default", "one-round"),
    ("default", "best-effort"),
    ("paper", "dense"),
)


@dataclass(frozen=True)
class Arguments:
    scenes: tuple[str, ...] = (*DRAWS, *LAYOUTS)
    """Draws of the kitchen, layouts of benchmarks.scenes with a seed, desk and desk-all."""
    cases: tuple[str, ...] = ("clean",)
    """Faults, see scoup_lab.synthetic.faults."""
    ways: tuple[str, ...] = ("dense", "votes", "one-round", "default")
    """Names of WAYS; paper takes minutes a scene and seed."""
    seeds: tuple[int, ...] = (2, 3, 4)
    """Of the codebook; scores are means over them."""
    epochs: int = 4000
    """Of the Adam solver."""
    rows: Path | None = None
    """File in which the scores of single pairs are kept, and taken up again."""
    out: Path | None = None
    """Where the summary is written; replaced."""
    data: Path = field(default_factory=data_folder)
    """Folder that contains kitchen/ and clip/, and desk/ for its scenes."""
    size: SceneSize = field(default_factory=SceneSize)


def main(arguments: Arguments) -> dict[str, Any]:
    """Run what is missing, print the tables and write the summary."""
    for name in arguments.ways:
        looked_up("way", name, WAYS)
    rows = _kept(arguments)
    for name in arguments.scenes:
        scene = None
        for case in arguments.cases:
            of_case = rows["scores"].setdefault(f"{name}/{case}", {})
            missing = [way for way in arguments.ways if way not in of_case]
            if not missing:
                continue
            scene = scene or make_scene(name, arguments.data, arguments.size)
            rows["pairs"][name] = scene.pairs
            for way, scores in run_case(scene, case, missing, arguments):
                of_case[way] = scores
                said = "  ".join(f"{rule} {mean(scores[rule]):.3f}" for rule in RULES if scores[rule])
                print(f"{name:12} {case:9} {way:10} {said}", flush=True)
                if arguments.rows is not None:
                    write_text(arguments.rows, json.dumps(rows), overwrite=True)
    found = summary(rows, arguments)
    print(table(found))
    if arguments.out is not None:
        write_text(arguments.out, record_text(found) + "\n", overwrite=True)
    return found


def _kept(arguments: Arguments) -> dict[str, Any]:
    settings = {"seeds": list(arguments.seeds), "epochs": arguments.epochs, "size": asdict(arguments.size)}
    if arguments.rows is None or not arguments.rows.exists():
        return {"settings": settings, "pairs": {}, "scores": {}}
    rows = json.loads(arguments.rows.read_text())
    if rows["settings"] != settings:
        raise InputError(f"{arguments.rows}: holds results of {rows['settings']}; name another --rows")
    return rows


def run_case(
    scene: AnswerScene, case: str, ways: Sequence[str], arguments: Arguments
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Per way: per rule the IoU of each pair, means over seeds, and what it took."""
    inputs = scene.inputs(case)
    for name in ways:
        method, started = WAYS[name], time.perf_counter()
        build = BuildSettings(epochs=arguments.epochs)
        by_seed, size = [], 0.0
        for seed in arguments.seeds if method.random and name not in SLOW else arguments.seeds[:1]:
            fitted = method.uplift(inputs, MethodSettings(seed, build))
            by_seed.append(score(scene, fitted))
            size = fitted.bytes_per_gaussian
        means = {
            rule: [round(mean(each), 3) for each in zip(*(of[rule] for of in by_seed), strict=True)]
            for rule in RULES
        }
        by_seeds = {rule: [round(mean(of[rule]), 4) for of in by_seed] for rule in RULES if by_seed[0][rule]}
        seconds = round(time.perf_counter() - started, 1)
        yield name, {**means, "seeds": by_seeds, "bytes_per_gaussian": size, "seconds": seconds}


def score(scene: AnswerScene, fitted: FittedMethod) -> dict[str, list[float]]:
    """Per rule, the IoU of each (frame, label) pair, or whether it is a hit; none if the way cannot follow it."""
    scores: dict[str, list[float]] = {rule: [] for rule in RULES}
    everyday = with_everyday(scene.canonical, scene.everyday)
    fixed, asked = QUERY_PRESETS["scoup"], QUERY_PRESETS["default"]
    by_mask = replace(fixed, level_choice="mask")
    field = fitted.field if isinstance(fitted, FittedField) else None
    if field is not None:
        field.attach(scene.gaussians, known=True)
    for (frame, view), camera in zip(scene.frames, scene.cameras, strict=True):
        queries = torch.stack([scene.queries[label] for label in frame.labels])
        plain = fitted.relevancy(view, queries, scene.canonical)  # [S, Q, H, W]
        beside = fitted.relevancy(view, queries, everyday)
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
            for rule, maps, preset in (
                ("peak", plain, fixed),
                ("mask", plain, by_mask),
                ("everyday", beside, by_mask),
            ):
                masks = level_masks(maps[:, position], preset)
                scores[rule].append(iou(masks.masks[choose_level(masks, preset.level_choice)], truth))
            votes = level_masks(beside[:, position], asked)
            scores["best level"].append(max(iou(mask, truth) for mask in votes.masks))
            if field is None:
                scores["always"].append(iou(votes.masks[choose_level(votes, asked.level_choice)], truth))
    return scores


def groups_of(scenes: Sequence[str]) -> dict[str, list[str]]:
    """Group scenes by what they are: draws of the kitchen by kind and noise, the real scene, procedural layouts."""
    groups: dict[str, list[str]] = {}
    for name in scenes:
        groups.setdefault(_group_of(name), []).append(name)
    return groups


def _group_of(name: str) -> str:
    if name in DESKS:
        return "desk (real)"
    draw = DrawName.parse(name)
    if draw is None:
        return "kitchen draws" if name == "kitchen" else "procedural"
    kind = f", {KINDS[draw.kind].title}" if draw.kind else ""
    return f"kitchen draws{kind}" + (f", noise x {draw.noise:g}" if draw.noise != 1 else "")


def summary(rows: dict[str, Any], arguments: Arguments) -> dict[str, Any]:
    """Means over scenes, and paired differences: queries are drawn, each scene counting alike."""
    found: dict[str, Any] = {
        "what": "benchmarks.answers: mIoU by way and rule, localisation accuracy; differences paired over queries with "
        "95 % intervals",
        "machine": describe_environment(),
        "settings": rows["settings"],
        "ways": {},
        "scenes": {},
        "differences": {},
        "pairs": rows["pairs"],
        "scores": {
            cell: {way: ways[way] for way in arguments.ways if way in ways}
            for cell, ways in rows["scores"].items()
        },
    }
    sets = {
        f"{kind}, {case}": [f"{name}/{case}" for name in names]
        for case in arguments.cases
        for kind, names in groups_of(arguments.scenes).items()
    }
    if len(sets) > 1:
        sets["all"] = [cell for cells in sets.values() for cell in cells]
    for way in arguments.ways:
        found["ways"][way] = {
            key: {rule: _rounded_mean([_mean(rows, cell, way, rule) for cell in cells]) for rule in RULES}
            for key, cells in sets.items()
        }
        found["scenes"][way] = {
            cell: {rule: _rounded_mean([_mean(rows, cell, way, rule)]) for rule in RULES}
            for cell in dict.fromkeys(cell for cells in sets.values() for cell in cells)
        }
    for first, second in COMPARED:
        if {first, second} <= set(arguments.ways):
            found["differences"][f"{first} - {second}"] = {
                key: {rule: _difference(rows, cells, first, second, rule) for rule in RULES}
                for key, cells in sets.items()
            }
    return found


def _mean(rows: dict[str, Any], cell: str, way: str, rule: str) -> float | None:
    found = rows["scores"][cell][way][rule]
    return mean(found) if found else None


def _rounded_mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return round(mean(known), 4) if len(known) == len(values) else None


def _difference(
    rows: dict[str, Any], cells: Sequence[str], first: str, second: str, rule: str
) -> list[float] | None:
    values, labels, scenes = [], [], []
    for cell in cells:
        both = [rows["scores"][cell][way][rule] for way in (first, second)]
        if not all(both):
            return None
        values += [a - b for a, b in zip(*both, strict=True)]
        labels += [label for _, label in rows["pairs"][cell.split("/")[0]]]
        scenes += [cell] * len(rows["pairs"][cell.split("/")[0]])
    found = bootstrap_interval(values, labels, scenes=scenes)
    return [round(value, 4) for value in (found.mean, found.low, found.high)]


def table(found: dict[str, Any]) -> str:
    """Markdown of a ``summary``."""
    keys = next(iter(found["ways"].values()))
    return "\n".join(f"\n{key}\n\n" + table_of(found, key) for key in keys)


def table_of(found: dict[str, Any], key: str) -> str:
    """Markdown of one set of scenes of a ``summary``: every way by every rule, then the differences."""
    body = [
        [way, *("" if of[key][rule] is None else f"{of[key][rule]:.3f}" for rule in RULES)]
        for way, of in found["ways"].items()
    ]
    body += [
        [
            name,
            *("{:+.3f} [{:+.3f}, {:+.3f}]".format(*of[key][rule]) if of[key][rule] else "" for rule in RULES),
        ]
        for name, of in found["differences"].items()
    ]
    return markdown(["way", *RULES], body)


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
