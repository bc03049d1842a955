"""Things of fields against the truth: instances and relations."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

import scoup
from benchmarks.data import data_folder
from benchmarks.kitchen_draws import Truth, make_draw
from benchmarks.real_scenes import RealScene
from benchmarks.scenes import field_of, scene_of
from benchmarks.study import Record, Study
from benchmarks.things_truth import LEAST, Instances, is_true, true_axes
from scoup.query import Frame
from scoup.query.phrases import quoted
from scoup_lab.bench import markdown, torch_threads

RELATIONS = ("left of", "in front of", "on", "above")
FREE_OF_SCALE = tuple(name for name in RELATIONS if name != "on")
"""Relations whose truth needs no length of the scene's unit; the kitchen's is unknown."""
Cases: TypeAlias = "dict[str, list[tuple[bool | None, str]]]"
IOUS = (0.25, 0.5)
VIEWER = "input_0002.jpg"
FACTS = {
    "kettle left of the laptop computer": "kettle right of the laptop computer",
    "penguin right of the laptop computer": "penguin left of the laptop computer",
    "extension cord left of the penguin": "extension cord right of the penguin",
    "mouse on the mousepad": "mousepad on the mouse",
    "mousepad under the mouse": "mouse under the mousepad",
    "laptop computer on the desk": "desk on the laptop computer",
    "kettle on the desk": "desk on the kettle",
    "penguin on the desk": "desk on the penguin",
    "lamp above the desk": "desk above the lamp",
    "box above the kettle": "kettle above the box",
    "computer keyboard in front of the monitor": "computer keyboard behind the monitor",
    "laptop computer between the kettle and the penguin": "kettle between the laptop computer and the penguin",
}
"""What is true of desk as seen from ``VIEWER``, each with what is not."""


@dataclass(frozen=True, kw_only=True)
class Things(Study):
    """Compare `field.things` with the true objects of synthetic scenes, and with known facts of a real one.

    Instances: IoU of Gaussians, weighted by opacity, of each true object with the best thing, and average precision
    of the things of level m, ranked by their number of regions. Relations: phrases over pairs of names that are
    clearly true or clearly false by their boxes, as many of one as of the other where there are; a phrase counts as
    found if any thing answers. The truth is the meshes; in draws of the kitchen it is
    the Gaussians labelled by hand, along the field's own directions. Desk: facts listed by hand, and their
    converses, which nothing may answer.
    """

    scenes: tuple[str, ...] = ("table-4", "shelves-2", "hall-3", "yard-3", "kitchen-21", "kitchen-22")
    """Layouts of benchmarks.scenes with a seed, and draws of the kitchen (benchmarks.kitchen_draws)."""
    n_gaussians: int = 60_000
    """Of each layout."""
    most: int = 30
    """True and false phrases of each relation that are asked at most."""
    desk: bool = True
    """Ask the real scene too."""
    data: Path = field(default_factory=data_folder)
    """Folder that contains desk/, kitchen/ and clip/."""

    def measure(self, known: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        for name in self.scenes:
            if name not in known:
                kind, _, seed = name.rpartition("-")
                if kind == "kitchen":
                    yield name, of_kitchen(self.data, int(seed), self.most)
                else:
                    yield name, of_layout(name, self.n_gaussians, self.most)
        if self.desk and "desk" not in known:
            yield "desk", of_desk(self.data)

    def record(self, rows: dict[str, Any]) -> Record:
        return {"rows": [{"scene": name, **figures} for name, figures in rows.items()]}

    @staticmethod
    def table(record: Record) -> str:
        """Return one column per scene."""
        rows = record["rows"]
        lines: list[tuple[str, Callable[[Record], str]]] = [
            ("true objects", lambda row: str(row["objects"])),
            ("mean IoU with the best thing", lambda row: f"{row['iou']:.3f}"),
            *(
                (f"AP at IoU {each:g}", lambda row, each=each: f"{row['ap'][f'{each:g}']:.3f}")
                for each in IOUS
            ),
            *(
                (f"{name}: precision / recall", lambda row, name=name: _quality(row["relations"][name]))
                for name in RELATIONS
            ),
            ("true facts found", lambda row: _share(row["facts"])),
            ("false converses found", lambda row: _share(row["converses"])),
            ("median ms per text", lambda row: f"{row['text_ms']:.0f}"),
        ]
        body = []
        for title, cell in lines:
            cells = []
            for row in rows:
                try:
                    cells.append(cell(row))
                except KeyError:
                    cells.append("")
            if any(cells):
                body.append([title, *cells])
        return markdown(["", *(row["scene"] for row in rows)], body)


def of_layout(name: str, n_gaussians: int, most: int) -> Record:
    """Return all figures of a procedural scene."""
    scene = scene_of(name, n_gaussians)
    built = field_of(scene)
    frame = built.frame()
    axes = true_axes(built.camera(frame.seen_from))
    truth = Instances.of(scene)
    return of_scene(truth, built, frame, relation_cases(truth.boxes(axes), RELATIONS), most)


def of_kitchen(data: Path, seed: int, most: int) -> Record:
    """Return all figures of a draw of the kitchen."""
    truth = Truth.open(data, 0.5)
    built = scoup.build(truth.gaussians, truth.cameras, make_draw(truth, seed).regions)
    built = built.with_encoder(data / "clip" / "text_vit_b16_laion2b.npz")
    frame, instances = built.frame(), Instances.of_kitchen(truth)
    cases = relation_cases(instances.boxes(frame.axes.numpy()), FREE_OF_SCALE)
    return of_scene(instances, built, frame, cases, most)


def of_scene(truth: Instances, built: scoup.LanguageField, frame: Frame, cases: Cases, most: int) -> Record:
    """Return all figures of a scene whose truth is known."""
    names = [name for name in dict.fromkeys(truth.names) if name and truth.counts[name]]
    times = _asked(built, [f'"{name}"' for name in names])
    return {
        **instances(built, truth),
        "relations": relations(built, frame, cases, most),
        "text_ms": 1e3 * median(times),
    }


def instances(built: scoup.LanguageField, truth: Instances) -> Record:
    """Return IoU and average precision of the things against the true objects."""
    weights = built.gaussians.opacities.double().numpy()
    of_truth = np.bincount(truth.of_gaussian + 1, weights, len(truth.names) + 1)[1:]
    sizes = np.bincount(truth.of_gaussian + 1, minlength=len(truth.names) + 1)[1:]
    things = built.things()
    overlaps = np.zeros((len(things), len(truth.names)))
    for row, thing in enumerate(things):
        mine = thing.gaussians.numpy()
        both = np.bincount(truth.of_gaussian[mine] + 1, weights[mine], len(truth.names) + 1)[1:]
        overlaps[row] = both / (of_truth + weights[mine].sum() - both).clip(1e-9)
    overlaps = overlaps[:, sizes >= LEAST]
    middle = [row for row, thing in enumerate(things) if thing.level == "m"]
    ranked = sorted(middle, key=lambda row: -(things[row].n_regions or 0))
    return {
        "objects": overlaps.shape[1],
        "iou": float(overlaps.max(0).mean()),
        "ap": {f"{least:g}": average_precision(overlaps[ranked], least) for least in IOUS},
    }


def average_precision(overlaps: NDArray[np.float64], least: float) -> float:
    """Return the area below precision over recall of ranked things [T, O]; each object is found once."""
    free = np.ones(overlaps.shape[1], bool)
    hits = []
    for row in overlaps:
        best = int(np.where(free, row, -1).argmax())
        hits.append(bool(free[best] and row[best] >= least))
        free[best] &= not hits[-1]
    precision = np.cumsum(hits) / np.arange(1, len(hits) + 1)
    highest = np.maximum.accumulate(precision[::-1])[::-1]
    return float(highest[np.array(hits, bool)].sum() / overlaps.shape[1])


def relation_cases(boxes: Mapping[str, NDArray[np.float64]], relations: Sequence[str]) -> Cases:
    """Return, per relation, phrases over the names of boxes, and whether they are clearly true, clearly false or None.

    Names that are phrases themselves ("tea in a glass") are left out.
    """
    names = [name for name in boxes if quoted(name) == name]
    return {
        relation: [
            (is_true(relation, boxes[one], boxes[other]), f"{one} {relation} {other}")
            for one in names
            for other in names
            if one != other
        ]
        for relation in relations
    }


def relations(built: scoup.LanguageField, frame: Frame, cases: Cases, most: int) -> dict[str, list[int]]:
    """Return phrases per relation: true and found, true and missed, false and found, false and not found."""
    rng = np.random.default_rng(1)
    found = {}
    for relation, of in cases.items():
        tally = []
        for wanted in (True, False):
            clear = [phrase for holds, phrase in of if holds is wanted]
            asked = [clear[place] for place in rng.permutation(len(clear))[:most]]
            answered = sum(bool(built.things(built.question(phrase, frame=frame))) for phrase in asked)
            tally += [answered, len(asked) - answered]
        found[relation] = tally
    return found


def of_desk(data: Path) -> Record:
    """Return how many facts of the real scene are found."""
    desk = RealScene.open("desk", data)
    built = desk.field()
    frame = built.frame(VIEWER)
    texts = sorted({label for labelled, _ in desk.frames for label in labelled.labels})
    times = _asked(built, texts)
    missed = [fact for fact in FACTS if not built.things(built.question(fact, frame=frame))]
    wrong = [each for each in FACTS.values() if built.things(built.question(each, frame=frame))]
    return {
        "facts": [len(FACTS) - len(missed), len(FACTS)],
        "converses": [len(wrong), len(FACTS)],
        "missed": missed,
        "wrong": wrong,
        "text_ms": 1e3 * median(times),
    }


def _asked(built: scoup.LanguageField, texts: Sequence[str]) -> list[float]:
    """The seconds that each text takes with one thread."""
    times = []
    with torch_threads(1):
        for text in texts:
            started = time.perf_counter()
            built.things(text)
            times.append(time.perf_counter() - started)
    return times


def _share(of: list[int]) -> str:
    return f"{of[0]} of {of[1]}" if of[1] else ""


def _quality(tally: list[int]) -> str:
    """Precision and recall, with how many phrases are true and false."""
    hits, missed, false, quiet = tally
    if not hits + missed:
        return f"- ({false} of {false + quiet} false ones found)"
    precision = f"{hits / (hits + false):.2f}" if hits + false else "-"
    return f"{precision} / {hits / (hits + missed):.2f} ({hits + missed}, {false + quiet})"
