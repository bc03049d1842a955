"""Positions of things in the world and in views, against the ground truth."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import torch
from torch import Tensor

import scoup
from benchmarks.scenes import scene_of
from benchmarks.study import Record, Study
from scoup.field.language_field import Encoder
from scoup.query.boxes import PointSets
from scoup.scene.up import estimate_up
from scoup_lab.bench import markdown
from scoup_lab.evaluate.metrics import iou
from scoup_lab.synthetic.scene import DemoScene

IN_SPACE, IN_VIEWS = "strays left off", "box of the main parts"
LEAST = 20  # Gaussians of a thing
Box: TypeAlias = tuple[int, int, int, int]


@dataclass(frozen=True, kw_only=True)
class Locate(Study):
    """Locate every object and group of a single thing by `field.location` and the boxes of `field.answer`.

    Each scene is built by the default settings. The position is compared with the middle of the thing's true Gaussians,
    in diagonals of the box around them; extents by the ratio of the boxes' diagonals, Gaussians by intersection over
    union. In the held-out views, boxes are compared with the true ones; "stretched" is the share of boxes more than
    twice as large.
    """

    scenes: tuple[str, ...] = ("table-4", "shelves-2", "hall-3", "yard-3")
    """Layouts of benchmarks.scenes with a seed."""
    n_gaussians: int = 120_000
    """Of each scene."""

    def measure(self, known: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        for name in self.scenes:
            if name in known:
                continue
            scene = scene_of(name, self.n_gaussians)
            field = scoup.build(scene.gaussians, scene.building, scene.regions)
            vectors = torch.from_numpy(scene.words.vectors).float()
            encoder: Encoder = dict(zip(scene.words.texts, vectors, strict=True))
            yield name, [in_space(scene, field, encoder), in_views(scene, field, encoder)]

    def record(self, rows: dict[str, Any]) -> Record:
        return {"rows": [{"scene": name, **row} for name, of_scene in rows.items() for row in of_scene]}

    @staticmethod
    def table(record: Record) -> str:
        """Return one column per scene."""
        rows = {(row["scene"], row["what"]): row for row in record["rows"]}
        names = list(dict.fromkeys(row["scene"] for row in record["rows"]))
        body = [
            [title, *(_cell(rows[name, what][key], form) for name in names)]
            for title, what, key, form in (
                ("things that are located", IN_SPACE, "things", "d"),
                ("median error of the position", IN_SPACE, "median_error", ".3f"),
                ("within a quarter of a diagonal", IN_SPACE, "within_quarter", ".3f"),
                ("extent", IN_SPACE, "extent", ".2f"),
                ("IoU of the Gaussians", IN_SPACE, "iou", ".3f"),
                ("boxes in held-out views", IN_VIEWS, "things", "d"),
                ("IoU of the box", IN_VIEWS, "iou", ".3f"),
                ("boxes over twice the true area", IN_VIEWS, "stretched", ".3f"),
            )
        ]
        return markdown(["", *names], body)


def in_space(scene: DemoScene, field: scoup.LanguageField, encoder: Encoder) -> Record:
    """Return errors of positions, extents and Gaussians; None where most things were not found."""
    things = true_things(scene)
    located = field.location(field.question(list(things), encoder=encoder, always=True))
    errors, extents, overlaps = [], [], []
    for truth, place in zip(things.values(), located, strict=True):
        middle, diagonal = middle_and_diagonal(scene, truth)
        found = torch.zeros_like(truth)
        if place.thing is not None:
            found[place.thing.gaussians] = True
        distance = torch.inf if place.position is None else float((place.position - middle).norm()) / diagonal
        ratio = middle_and_diagonal(scene, found)[1] / diagonal if found.any() else 0.0
        errors.append(distance)
        extents.append(max(ratio, 1 / max(ratio, 1e-9)))
        overlaps.append(iou(truth, found))
    error, extent = float(torch.tensor(errors).median()), float(torch.tensor(extents).median())
    return {
        "what": IN_SPACE,
        "things": len(things),
        "median_error": error if error < torch.inf else None,
        "within_quarter": sum(each <= 0.25 for each in errors) / len(errors),
        "extent": extent,
        "iou": sum(overlaps) / len(overlaps),
    }


def in_views(scene: DemoScene, field: scoup.LanguageField, encoder: Encoder) -> Record:
    """Return how boxes overlap with the true ones, of things that have one box in a held-out view."""
    overlaps, stretched = [], []
    for camera in scene.held_out:
        frame = scene.labelled_frame(camera.name, ("m", "l"))
        names = [label for label in frame.labels if len(frame.boxes[label]) == 1]
        answers = field.at(camera).answer(field.question(names, encoder=encoder, always=True))
        for label, answer in zip(names, answers, strict=True):
            x0, y0, x1, y1 = map(int, frame.boxes[label][0].tolist())
            truth = (x0, y0, x1 + 1, y1 + 1)
            overlaps.append(0.0 if answer.box is None else box_overlap(answer.box, truth))
            stretched.append(answer.box is not None and _area(answer.box) > 2 * _area(truth))
    count = len(overlaps)
    return {
        "what": IN_VIEWS,
        "things": count,
        "iou": sum(overlaps) / count,
        "stretched": sum(stretched) / count,
    }


def true_things(scene: DemoScene) -> dict[str, Tensor]:
    """Return objects and groups that are one thing each: name -> [N] boolean."""
    found: dict[str, Tensor] = {}
    for level in ("m", "l"):
        ids = torch.from_numpy(scene.parts.at_level(scene.part_of_gaussian.numpy(), level)).long()
        for number, name in enumerate(scene.parts.names(level)):
            mask = ids == number
            if name not in scene.parts.several and int(mask.sum()) >= LEAST:
                found.setdefault(name, mask)
    return found


def middle_and_diagonal(scene: DemoScene, mask: Tensor) -> tuple[Tensor, float]:
    """Return the middle [3] of some Gaussians [N], and the diagonal of the box around them, in world units."""
    means, opacities = scene.gaussians.means[mask].double(), scene.gaussians.opacities[mask].double()
    box = PointSets.of_one_thing(means, opacities).boxes(estimate_up(()))[0]
    assert box is not None
    return means.median(0).values, float(box.extent.norm())


def box_overlap(first: Box, second: Box) -> float:
    """Return intersection over union of two boxes (x0, y0, x1, y1)."""
    width = min(first[2], second[2]) - max(first[0], second[0])
    height = min(first[3], second[3]) - max(first[1], second[1])
    both = max(0, width) * max(0, height)
    return both / (_area(first) + _area(second) - both)


def _area(box: Box) -> int:
    return (box[2] - box[0]) * (box[3] - box[1])


def _cell(value: float | None, form: str) -> str:
    return "-" if value is None else f"{value:{form}}"
