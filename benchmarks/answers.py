"""The quality of answers, by ways of building a field and rules of reading an answer from it."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from statistics import mean
from typing import Any, ClassVar

import torch
from torch import Tensor

from benchmarks.answer_presence import MOST_ABSENT, presence_of_groups, presence_table
from benchmarks.answer_scenes import AnswerScene, SceneSize, make_scene
from benchmarks.data import data_folder
from benchmarks.drawn import DrawnAnswer, answers_of, mask_ious, object_ious, question_of
from benchmarks.left_out import LEFT_OUT, WITHOUT, left_out, table_of_constant
from benchmarks.real_scenes import PHOTOGRAPHED, REAL_SCENES, place_of
from benchmarks.study import Record, Study
from benchmarks.ways import DRAWS, FULL_SIZE, LAYOUTS, WAYS, groups_of
from scoup.base import looked_up
from scoup.models import with_everyday
from scoup.query import constants
from scoup.query.thing_names import broader_words, thing_names
from scoup.uplift import BuildSettings
from scoup.uplift.settings import Scale
from scoup_lab.baselines.fitted import FittedField, FittedMethod
from scoup_lab.baselines.method import MethodSettings
from scoup_lab.baselines.rasterised_scene import Codes
from scoup_lab.bench import markdown
from scoup_lab.evaluate.metrics import any_inside, bootstrap_interval, iou
from scoup_lab.evaluate.relevancy_maps import localize, segment
from scoup_lab.evaluate.rules import MASK_RULES

RULES = ("peak", "always", "names", "scene", "asked", "localisation")
RIGHT_FROM = 0.5
"""Mean IoU over the views of a word from which an answer is right."""
COMPARED = (("default", "dense"), ("default", "paper"), ("default", "votes"), ("paper", "dense"))


@dataclass(frozen=True, kw_only=True)
class Answers(Study):
    """Score ways of building a field by rules of reading an answer, with paired differences.

    Scenes are draws of the kitchen (`benchmarks.kitchen_draws`; "kitchen-11x2" has noise twice as strong,
    "kitchen-11-desk" and "kitchen-11-clip" the statistics of `benchmarks.embedding_kinds`), procedural layouts, and the
    real "desk" and "desk-all". Masks and embeddings are simulated everywhere but
    on desk: figures compare ways with each other and cannot be set against published ones.

    All ways are scored by the same rules. peak: the protocol of LERF-OVS, threshold 0.6, the level with the largest
    relevancy. always: as `scoup query --always` answers, once in the scene: by things, or without them by the Gaussians
    above the threshold at which the answer changes least. names: the same, the mean over all names that people may
    use for an object (`benchmarks.other_names`), with real models. scene: as always, one IoU per word over all scored
    views together; what none of them shows counts as wrong. asked: as `scoup query` answers; a text that it calls
    absent scores 0, and ways that are no field, which cannot judge presence, have none. localisation: by the protocol
    of LERF-OVS, 1 where the point is right. presence: scores of the labels, and of up to 40 absent words.

    With --without, the default way is compared with itself without the constants named, one at a time.
    """

    scenes: tuple[str, ...] = (*DRAWS, *(f"{name}x2" for name in DRAWS), *LAYOUTS)
    """Draws of the kitchen, layouts of benchmarks.scenes with a seed, scenes of benchmarks.real_scenes."""
    ways: tuple[str, ...] = ("dense", "votes", "default")
    """Names of WAYS; paper takes minutes a scene and seed."""
    without: tuple[str, ...] = ()
    """Constants of LEFT_OUT, or all. Ways are then the default with and without each."""
    seeds: tuple[int, ...] = (2, 3, 4)
    """Of the codebook; scores are means over them."""
    epochs: int = 4000
    """Of the Adam solver."""
    size: SceneSize = field(default_factory=SceneSize)
    data: Path = field(default_factory=data_folder)
    """Folder that contains kitchen/ and clip/, and desk/ and real/ for their scenes."""

    rows_depend_on: ClassVar[tuple[str, ...]] = ("seeds", "epochs", "size")
    first_seed_alone: ClassVar[frozenset[str]] = frozenset({"paper"})  # minutes a scene

    def __post_init__(self) -> None:
        if self.without:
            names = [name for of in LEFT_OUT.values() for name in of]
            names = names if self.without == ("all",) else list(self.without)
            object.__setattr__(self, "ways", ("default", *(WITHOUT + name for name in names)))

    def check(self) -> None:
        for name in self.ways:
            if name.startswith(WITHOUT):
                table_of_constant(name.removeprefix(WITHOUT))
            else:
                looked_up("way", name, WAYS)

    def measure(self, known: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        for name in self.scenes:
            ways = [way for way in self.ways if f"{name}/{way}" not in known]
            scene = make_scene(name, self.data, self.size) if ways else None
            kept: dict[BuildSettings, Codes] = {}  # no constant of the tables decides codes of regions
            for way in ways:
                assert scene is not None
                yield f"{name}/{way}", {"pairs": scene.pairs, "scores": self._scores(scene, way, kept)}

    def _scores(self, scene: AnswerScene, way: str, kept: dict[BuildSettings, Codes]) -> Record:
        """Return per rule the IoU of each pair as means over seeds, and what it took."""
        name, started = way.removeprefix(WITHOUT), time.perf_counter()
        without, method = name != way, WAYS["default" if name != way else way]
        # The longer side of images without a limit is that of the cameras: region sums of this size are kept.
        scale: Scale = 1.0 if name == "AUTO_SIDE" or way in FULL_SIZE else "auto"
        inputs = scene.inputs(scale)
        inputs = replace(inputs, kept_codes=kept) if self.without else inputs
        build = BuildSettings(epochs=self.epochs)
        by_seed, size, build_seconds = [], 0.0, 0.0
        for seed in self.seeds if method.random and way not in self.first_seed_alone else self.seeds[:1]:
            with left_out(name) if without else nullcontext():
                build_started = time.perf_counter()
                fitted = method.uplift(inputs, MethodSettings(seed, build))
                if not by_seed:
                    build_seconds = round(scene.seconds[scale] + time.perf_counter() - build_started, 1)
                by_seed.append(score(scene, fitted))
            size = fitted.bytes_per_gaussian
        means = {
            rule: [round(mean(each), 3) for each in zip(*(of[rule] for of in by_seed), strict=True)]
            for rule in RULES
        }
        by_seeds = {rule: [round(mean(of[rule]), 4) for of in by_seed] for rule in RULES if by_seed[0][rule]}
        seconds = round(time.perf_counter() - started, 1)
        return {
            **means,
            "presence": by_seed[0]["presence"],
            "right": by_seed[0]["right"],
            "seeds": by_seeds,
            "bytes_per_gaussian": size,
            "seconds": seconds,
            "build_seconds": build_seconds,
        }

    def line(self, figures: Any) -> str:
        scores = figures["scores"]
        return "  ".join(f"{rule} {mean(scores[rule]):.3f}" for rule in RULES if scores[rule])

    def record(self, rows: dict[str, Any]) -> Record:
        """Return means over places, and paired differences: words are drawn, for all scenes of a place together."""
        pairs: Record = {}
        scores: Record = {}
        for key, figures in rows.items():
            name, way = key.split("/")
            pairs[name] = figures["pairs"]
            scores.setdefault(name, {})[way] = figures["scores"]
        groups = groups_of(self.scenes)
        photographed = [name for name in self.scenes if place_of(name) in PHOTOGRAPHED]
        sets = groups | ({"real photographs": photographed} if photographed else {})
        sets |= {"all": list(self.scenes)} if len(groups) > 1 else {}
        return {
            "settings": {name: self.settings()[name] for name in self.rows_depend_on},
            "ways": {
                way: {key: _means(scores, each, way) for key, each in sets.items()} for way in self.ways
            },
            "scenes": {way: {name: _means(scores, [name], way) for name in self.scenes} for way in self.ways},
            "build_seconds": {
                way: {name: scores[name][way].get("build_seconds") for name in self.scenes}
                for way in self.ways
            },
            "differences": {
                f"{first} - {second}": {
                    key: {rule: _difference(scores, pairs, each, (first, second), rule) for rule in RULES}
                    for key, each in sets.items()
                }
                for first, second in (
                    *COMPARED,
                    *(("default", way) for way in self.ways if way.startswith(WITHOUT)),
                )
                if {first, second} <= set(self.ways)
            },
            "presence": presence_of_groups(scores, groups, self.ways),
            "right": {
                way: {name: scores[name][way].get("right") for name in self.scenes} for way in self.ways
            },
            **({} if self.without else {"pairs": pairs, "scores": scores_of(scores, self.ways)}),
        }

    @staticmethod
    def table(record: Record) -> str:
        keys = next(iter(record["ways"].values()))
        return "\n".join(f"\n{key}\n\n" + table_of(record, key) for key in keys)


def scores_of(scores: Record, ways: Sequence[str]) -> Record:
    """Return the scores of each scene in the order of the ways."""
    return {name: {way: of[way] for way in ways if way in of} for name, of in scores.items()}


def score(scene: AnswerScene, fitted: FittedMethod) -> Record:
    """Return per rule the IoU of each (frame, label) pair, or whether it is a hit; and the scores of texts that are in
    the scene and of those that are not, for fields.
    """
    scores: dict[str, list[float]] = {rule: [] for rule in RULES}
    everyday = with_everyday(scene.canonical, scene.everyday)
    labels, absent = tuple(scene.queries), scene.absent[:MOST_ABSENT]
    answers = answers_of(scene, fitted, [name for of in scene.names.values() for name in of], everyday)
    by_names = mask_ious(scene, answers)
    scores["always"], scores["scene"] = [of[0] for of in by_names], object_ious(scene, answers)
    if len(answers) > len(labels):
        scores["names"] = [mean(of) for of in by_names]
    for found, (_, label) in zip(scores["always"], scene.pairs, strict=True):
        score = answers[label].score
        if score is not None:
            scores["asked"].append(found * float(score >= constants.PRESENT_FROM))
    scores |= by_relevancy(scene, fitted)
    of_absent = answers_of(scene, fitted, absent, everyday) if absent else {}
    presence = {
        "present": [answers[label].score for label in labels],
        "absent": [answer.score for answer in of_absent.values()],
    }
    return {**scores, "presence": presence, "right": right_answers(scene, fitted, answers, everyday)}


def by_relevancy(scene: AnswerScene, fitted: FittedMethod) -> dict[str, list[float]]:
    """Return the scores of the rules that render relevancy, which fields with the same codes share."""
    codes = codes_of(fitted) if isinstance(fitted, FittedField) else ()
    for one, of_one in scene.known_relevancy if codes else ():
        if all(torch.equal(*pair) for pair in zip(codes_of(one), codes, strict=True)):
            return of_one
    scores, fixed = {"localisation": [], "peak": []}, MASK_RULES["scoup"]
    for frame, view in scene.frames:
        queries = torch.stack([scene.queries[label] for label in frame.labels])
        plain = fitted.relevancy(view, queries, scene.canonical)  # [S, Q, H, W]
        for position, label in enumerate(frame.labels):
            hit = any_inside(localize(plain[:, position], fixed).pixels, frame.boxes[label])
            scores["localisation"].append(float(hit))
            scores["peak"].append(iou(segment(plain[:, position], fixed).mask, frame.masks[label]))
    if isinstance(fitted, FittedField):
        scene.known_relevancy.append((fitted, scores))
    return scores


def codes_of(fitted: FittedField) -> tuple[Tensor, Tensor, Tensor]:
    """Return the codebook, and indices and weights of the codes."""
    return fitted.field.codebook, fitted.field.code_indices, fitted.field.code_weights


def right_answers(
    scene: AnswerScene, fitted: FittedMethod, answers: Mapping[str, DrawnAnswer], everyday: Tensor
) -> dict[str, int]:
    """Return of how many labels the answer is right, of how many it or the runner-up is, and of how many a runner-up is
    named beside a right and a wrong answer. Of the things that answer rightly: how many have a name that a list of
    words gives, and how many a right one, of all everyday words (a word that is broader than a right one is right)
    and of the labels with as many absent words.
    """

    def right(every: Mapping[str, DrawnAnswer]) -> set[str]:
        of_label: dict[str, list[float]] = {}
        for (found, *_), (_, label) in zip(mask_ious(scene, every), scene.pairs, strict=True):
            of_label.setdefault(label, []).append(found)
        return {label for label, found in of_label.items() if mean(found) >= RIGHT_FROM}

    labels = tuple(scene.queries)
    shown = {label: answers[label] for label in labels}
    named = {label for label in labels if shown[label].runner_up is not None}
    first = right(shown)
    both = first | right({label: answer.runner_up or answer for label, answer in shown.items()})
    counts = {
        "labels": len(labels),
        "first": len(first),
        "either": len(both),
        "beside right": len(named & first),
        "beside wrong": len(named - first),
    }
    if isinstance(fitted, FittedField):
        for key, words in (("of all", scene.words), ("of few", (*labels, *scene.absent[: len(labels)]))):
            asked = replace(question_of(scene, words, everyday), present_from=constants.PRESENT_FROM)
            names = thing_names(fitted.field, asked)
            firsts = [(label, thing) for label in first if (thing := shown[label].thing) is not None]
            texts = {label: names[thing].texts for label, thing in firsts if thing in names}
            given = {label: some[0] for label, some in texts.items() if some}
            counts[f"named, {key}"] = len(given)
            counts[f"rightly, {key}"] = sum(
                bool({text, *broader_words().get(text, ())}.intersection(scene.names[label]))
                for label, text in given.items()
            )
    return counts


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


def _means(scores: Record, names: Sequence[str], way: str) -> Record:
    found = {}
    for rule in RULES:
        places: dict[str, list[float]] = {}
        for name in names:
            places.setdefault(place_of(name), []).extend(scores[name][way].get(rule) or [math.nan])
        value = mean(mean(values) for values in places.values())
        found[rule] = None if math.isnan(value) else round(value, 4)
    return found


def _difference(
    scores: Record, pairs: Record, names: Sequence[str], ways: tuple[str, str], rule: str
) -> list[float] | None:
    values, labels, scenes = [], [], []
    for name in names:
        both = [scores[name][way][rule] for way in ways]
        if not all(both):
            return None
        values += [a - b for a, b in zip(*both, strict=True)]
        of_pairs = [label for _, label in pairs[name]]
        labels += sorted(set(of_pairs)) if rule == "scene" else of_pairs
        scenes += [place_of(name)] * len(both[0])
    found = bootstrap_interval(values, labels, scenes=scenes)
    return [round(value, 4) for value in (found.mean, found.low, found.high)]


@dataclass(frozen=True, kw_only=True)
class Real(Answers):
    """Score ways of building a field, and presence, on scenes with real masks and real embeddings.

    The scenes are those of `benchmarks.real_scenes` whose data are at hand: desk and fox (all photographs and 17), and
    rendered photographs of a museum, a table, shelves, a hall and a yard, most with two poolings of the embeddings.
    Rules and figures are those of `benchmarks answers`. The constants of the answer were chosen on these scenes but fox
    and the museum.
    """

    scenes: tuple[str, ...] = tuple(REAL_SCENES)
    """Scenes of benchmarks.real_scenes."""
    ways: tuple[str, ...] = ("default", "votes", "paper", "dense")
    """Names of benchmarks.ways.WAYS."""

    first_seed_alone: ClassVar[frozenset[str]] = frozenset({"default"})  # whose things answer alike

    def record(self, rows: dict[str, Any]) -> Record:
        """Return figures per scene, none of single words."""
        return {key: of for key, of in super().record(rows).items() if key not in ("pairs", "scores")}

    @staticmethod
    def table(record: Record) -> str:
        """Return `always` of each way on each scene, bold the best, and means over the places of each kind by several
        rules; then presence, and counts of right answers, runners-up and names. Without constants: what each gains."""
        ways, of, body = list(record["scenes"]), record["scenes"], []
        gains = {pair: each for pair, each in record["differences"].items() if WITHOUT in pair}
        if gains:
            return constants_table(record, gains)
        pair = "default - paper"
        for kind, group in KINDS_OF_SCENES.items():
            names = [name for name in of[ways[0]] if (place_of(name) in PHOTOGRAPHED) == (kind == "real")]
            body += [[name, *_best([of[way][name]["always"] for way in ways]), ""] for name in names]
            for rule, title in MEANS.items() if names else ():
                values = [record["ways"][way][group][rule] for way in ways]
                difference = record["differences"].get(pair, {}).get(group, {}).get(rule)
                body.append([f"{title}, {kind}", *_best(values), difference_cell(difference)])
        tables = [markdown(["scene, mIoU", *ways, pair], body), presence_table(record["presence"])]
        right = record["right"].get("default", {})
        counted = [[name, *map(str, counts.values())] for name, counts in right.items()]
        return "\n\n".join([*tables, markdown(["answers of default, words", *COUNTED], counted)])


MEANS = {"always": "mean", "names": "mean, all names", "scene": "mean, one IoU per word"}
COUNTED = (
    "number", "right", "or the runner-up", "runner-up beside right", "beside wrong", "named, of all words", "rightly",
    "named, of few words", "rightly",
)  # fmt: skip
KINDS_OF_SCENES = {"real": "real photographs", "rendered": "rendered photographs, real models"}


def constants_table(record: Record, gains: Record) -> str:
    """Return what `always` loses without each constant: on average, on real photographs, and where it loses most."""
    rows = []
    for pair, each in gains.items():
        without = pair.removeprefix("default - ")
        default, other = (record["scenes"][way] for way in ("default", without))
        lost = [default[name]["always"] - other[name]["always"] for name in default]
        cells = [difference_cell(each.get(group, {}).get("always")) for group in ("all", "real photographs")]
        rows.append([without.removeprefix(WITHOUT), *cells, f"{max(lost):+.3f}"])
    return markdown(["constant", "always, with it", "real photographs", "most"], rows)


def _best(values: Sequence[float]) -> list[str]:
    """Return numbers, the largest in bold."""
    return [f"**{each:.3f}**" if each == max(values) else f"{each:.3f}" for each in values]
