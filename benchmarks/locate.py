"""Where things are, against the truth: ``field.locate`` and boxes in views on synthetic scenes.

    python -m benchmarks.locate --scenes table-4 hall-3 --out docs/benchmarks/locate.json

Each scene is built by the default settings and queried for every object and group of a single thing. The position is
compared with the middle of the thing's true Gaussians, in diagonals of the box around them, with and without strays
left off; extents by the ratio of the boxes' diagonals, Gaussians by their intersection over union. In the held-out
views, boxes around the main parts of the mask, the connected part that holds the point alone, and the whole mask are
compared with the true boxes; "stretched" is the share of boxes more than twice as large as the true one.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import torch
import tyro
from torch import Tensor

import scoup
from benchmarks.scenes import find_layout
from scoup.io import check_output
from scoup.query.locate import Location, oriented_box
from scoup.query.methods import Encoder
from scoup.query.segment import main_parts, mask_box
from scoup_lab.bench import describe_environment, write_json
from scoup_lab.synthetic.scene import DemoScene, make_demo_scene


@dataclass(frozen=True, eq=False)
class Named:
    """The true Gaussians of a name.

    Attributes:
        name: of the thing.
        mask: [N] boolean.
        middle: [3] float64.
        diagonal: of the box around them, in world units.
    """

    name: str
    mask: Tensor
    middle: Tensor
    diagonal: float


def main(
    scenes: Annotated[tuple[str, ...], tyro.conf.arg(metavar="LAYOUT-SEED")] = (
        "table-4",
        "shelves-2",
        "hall-3",
        "yard-3",
    ),
    n_gaussians: int = 120_000,
    out: Path | None = None,
    overwrite: bool = False,
) -> None:
    """Print a table; write it as JSON with ``--out``."""
    if out is not None:
        check_output(out, overwrite)
    rows = [row for name in scenes for row in measure(name, n_gaussians)]
    heads = " ".join(f"{name:>{width}}" for name, width in COLUMNS.items())
    print(f"{'scene':12} {'what':24} {'things':>6} {heads}")
    for row in rows:
        numbers = (f"{row[key]:{width}.3f}" if key in row else " " * width for key, width in COLUMNS.items())
        print(f"{row['scene']:12} {row['what']:24} {row['things']:6} {' '.join(numbers)}")
    if out is not None:
        record = {
            "environment": describe_environment(),
            "n_gaussians": n_gaussians,
            "rows": [without_infinite(row) for row in rows],
        }
        write_json(out, record, overwrite)


COLUMNS = {"median_error": 12, "within_quarter": 14, "extent": 6, "iou": 6, "stretched": 9}


def without_infinite(row: dict[str, Any]) -> dict[str, Any]:
    """A row for JSON: None where most things were not found, which makes a median infinite."""
    return {key: None if value == float("inf") else value for key, value in row.items()}


def measure(scene_name: str, n_gaussians: int) -> list[dict[str, Any]]:
    """The rows of one scene."""
    layout, _, seed = scene_name.rpartition("-")
    scene = make_demo_scene(int(seed), n_gaussians, layout=find_layout(layout))
    field = scoup.build(scene.gaussians, scene.building, scene.regions)
    encoder: Encoder = dict(
        zip(scene.words.texts, torch.from_numpy(scene.words.vectors).float(), strict=True)
    )
    things = true_things(scene)
    located = field.location(field.question([thing.name for thing in things], encoder=encoder, always=True))
    found = list(zip(things, located, strict=True))
    parts = {
        "strays left off": [of_part(each) for _, each in found],
        "all that answers": [of_all(field, each) for _, each in found],
    }
    rows = []
    for what, places in parts.items():
        errors = torch.tensor(
            [distance(thing, position) for thing, (position, _) in zip(things, places, strict=True)]
        )
        extents = torch.tensor(
            [extent(field, thing, mask) for thing, (_, mask) in zip(things, places, strict=True)]
        )
        overlaps = torch.tensor(
            [overlap(thing.mask, mask) for thing, (_, mask) in zip(things, places, strict=True)]
        )
        rows.append({
            "scene": scene_name, "what": what, "things": len(things), "median_error": float(errors.median()),
            "within_quarter": float((errors <= 0.25).float().mean()),
            "extent": float(extents.median()), "iou": float(overlaps.mean()),
        })  # fmt: skip
    return [*rows, *box_rows(scene_name, scene, field, encoder)]


def true_things(scene: DemoScene) -> list[Named]:
    """Objects and groups that are one thing each."""
    found = []
    for level in ("m", "l"):
        ids = ids_at(scene, level)
        for number, name in enumerate(scene.parts.names(level)):
            mask = ids == number
            if (
                name not in scene.parts.several
                and int(mask.sum()) >= 20
                and name not in {each.name for each in found}
            ):
                means = scene.gaussians.means[mask].double()
                box = oriented_box(means, scene.gaussians.opacities[mask].double())
                found.append(Named(name, mask, means.median(0).values, float(box.extent.norm())))
    return found


def ids_at(scene: DemoScene, level: str) -> Tensor:
    """[N] the true name's number at a level; -1 for none."""
    return torch.from_numpy(scene.parts.at_level(scene.part_of_gaussian.numpy(), level)).long()


def of_part(place: Location) -> tuple[Tensor | None, Tensor]:
    """Position and [N] mask of what ``locate`` says."""
    mask = torch.zeros_like(place.answer.mask)
    mask[place.gaussians] = True
    return place.position, mask


def of_all(field: scoup.LanguageField, place: Location) -> tuple[Tensor | None, Tensor]:
    """The same of all Gaussians that answer."""
    mask = place.answer.mask
    return (field.gaussians.means[mask].double().median(0).values if mask.any() else None), mask


def distance(thing: Named, position: Tensor | None) -> float:
    """From the true middle, in diagonals."""
    return float("inf") if position is None else float((position - thing.middle).norm()) / thing.diagonal


def extent(field: scoup.LanguageField, thing: Named, mask: Tensor) -> float:
    """Diagonal of the box around the Gaussians found, in true diagonals; the inverse if it is smaller."""
    if not mask.any():
        return float("inf")
    means, opacities = field.gaussians.means[mask].double(), field.gaussians.opacities[mask].double()
    ratio = float(oriented_box(means, opacities).extent.norm()) / thing.diagonal
    return max(ratio, 1 / max(ratio, 1e-9))


def overlap(first: Tensor, second: Tensor) -> float:
    """Intersection over union of two masks."""
    return int((first & second).sum()) / max(1, int((first | second).sum()))


def box_rows(
    name: str, scene: DemoScene, field: scoup.LanguageField, encoder: Encoder
) -> list[dict[str, Any]]:
    """Boxes in the held-out views, of things that have one box there."""
    found: dict[str, list[tuple[float, bool]]] = {
        "box of the main parts": [],
        "box of one part": [],
        "box of the mask": [],
    }
    for camera in scene.held_out:
        frame = scene.labelled_frame(camera.name, ("m", "l"))
        names = [label for label in frame.labels if len(frame.boxes[label]) == 1]
        question = field.question(names, encoder=encoder, always=True)
        for label, answer in zip(names, field.answer(question, camera), strict=True):
            x0, y0, x1, y1 = frame.boxes[label][0].tolist()
            truth = (int(x0), int(y0), int(x1) + 1, int(y1) + 1)
            one = main_parts(answer.mask, answer.point or (0, 0), answer.heat, torch.inf)
            boxes = (answer.box, mask_box(one), mask_box(answer.mask))
            for what, box in zip(found, boxes, strict=True):
                stretched = box is not None and area(box) > 2 * area(truth)
                found[what].append((0.0 if box is None else box_overlap(box, truth), stretched))
    return [
        {
            "scene": name,
            "what": what,
            "things": len(pairs),
            "iou": sum(iou for iou, _ in pairs) / len(pairs),
            "stretched": sum(stretched for _, stretched in pairs) / len(pairs),
        }
        for what, pairs in found.items()
    ]


def box_overlap(first: tuple[int, int, int, int], second: tuple[int, int, int, int]) -> float:
    """Intersection over union of two boxes (x0, y0, x1, y1)."""
    width = min(first[2], second[2]) - max(first[0], second[0])
    height = min(first[3], second[3]) - max(first[1], second[1])
    both = max(0, width) * max(0, height)
    return both / (area(first) + area(second) - both)


def area(box: tuple[int, int, int, int]) -> int:
    """Of a box (x0, y0, x1, y1) in pixels."""
    return (box[2] - box[0]) * (box[3] - box[1])


if __name__ == "__main__":
    tyro.cli(main)
