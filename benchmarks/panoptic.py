"""Sparse codes of panoptic maps, where classes are few, beside a plain vote of classes.

    python -m benchmarks.panoptic [--scenes kitchen hall-1/8 ...] [--seeds 10 11 ...] [--out FILE.json]

A scene has panoptic maps with the faults of a segmenter (``benchmarks.panoptic_maps``), by seed. It is rasterised once
a seed, and every way (``benchmarks.panoptic_ways``) votes on the same region sums. Gaussians with a code, and the
pixels of views held out, get the class whose vector has the largest cosine with their code; accuracy and mIoU are over
those whose true class is known. Pixels that nothing paints count as wrong.

The reference is the plain vote, "one-hot": the class with the largest blending weight. "learned" is the default build
as it would be without ``scoup.coding.distinct``. "no top-K" keeps all atoms of a Gaussian: what is left then is how the
norms of decoded codes weigh classes. "one atom kept" is the class with the largest weight again, but as a field.

The strengths of faults and the rules of ``scoup.coding.distinct`` were chosen on kitchen, table-0, hall-0, shelves-0
and yard-0, also with 20 and 8 classes, with seeds 0 and 1. The defaults here are the others, which report.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
import tyro
from numpy.typing import NDArray
from torch import Tensor

from benchmarks.data import data_folder
from benchmarks.panoptic_maps import panoptic_truth
from benchmarks.panoptic_ways import WAYS, Case, Voted
from scoup import raster
from scoup.io import check_output
from scoup.scene.codes import SparseCodes, cosines_from_codes
from scoup_lab.bench import describe_environment, markdown, write_json
from scoup_lab.evaluate.metrics import bootstrap_interval

SCENES = tuple(
    scene + classes
    for classes in ("", "/20", "/8")
    for scene in ("kitchen", "table-1", "hall-1", "shelves-1", "yard-1")
    if scene + classes != "yard-1/20"  # it has no more
)
SEEDS = (10, 11, 12, 13)
METRICS = ("Gaussians, accuracy", "Gaussians, mIoU", "pixels, accuracy", "pixels, mIoU")


@dataclass(frozen=True)
class Arguments:
    scenes: tuple[str, ...] = SCENES
    """kitchen, or a layout of benchmarks.scenes and its seed; a number of classes may follow, such as hall-1/8."""
    seeds: tuple[int, ...] = SEEDS
    """Of the maps (faults and class vectors) and of codebooks."""
    n_gaussians: int = 60_000
    """Of procedural scenes."""
    epochs: int = 4000
    """Epochs of the paper's solver."""
    out: Path | None = None
    """Where to write the figures as JSON."""
    overwrite: bool = False
    """Replace OUT."""
    data: Path = field(default_factory=data_folder)
    """Folder that holds kitchen/ and clip/."""


COMPARISONS = (
    *((way, "one-hot") for way in WAYS if way != "one-hot"),
    ("default, one round", "learned, one round"),
    ("learned, two rounds", "learned, one round"),
    ("default, two rounds", "default, one round"),
)
"""First way minus second way."""


def main(arguments: Arguments) -> dict[str, Any]:
    """Run every way, print the tables, give the record."""
    if arguments.out is not None:
        check_output(arguments.out, arguments.overwrite)
    environment = describe_environment()
    found: dict[str, dict[str, dict[str, Any]]] = {}
    for name in arguments.scenes:
        truth = panoptic_truth(name, arguments.data, arguments.n_gaussians)
        views = [raster.project(truth.gaussians, camera) for camera in truth.held_out]
        for seed in arguments.seeds:
            started = time.perf_counter()
            case = Case.of(truth, seed, arguments.epochs)
            scores = {way: score(case, views, vote_of(case)) for way, vote_of in WAYS.items()}
            codes = {kind: figures(*getattr(case, kind)) for kind in ("learned", "default", "paper")}
            found.setdefault(name, {})[str(seed)] = {"scores": scores, "codes": codes}
            line = " ".join(
                f"{scores[way][0]:.4f}" for way in ("one-hot", "learned, two rounds", "default, two rounds")
            )
            print(f"{name:12} {seed:3} {line}  {time.perf_counter() - started:.1f} s", flush=True)
    record = {
        "what": "benchmarks.panoptic: sparse codes of panoptic maps beside a plain vote of classes",
        "environment": environment,
        "settings": {
            "seeds": arguments.seeds,
            "n_gaussians": arguments.n_gaussians,
            "epochs": arguments.epochs,
        },
        "metrics": METRICS,
        "means": {
            way: [np.mean([rows[way][m] for _, _, rows in _rows(found)]) for m in range(4)] for way in WAYS
        },
        "differences": {f"{a} - {b}": differences(found, a, b) for a, b in COMPARISONS},
        "scenes": found,
    }
    print_tables(record)
    if arguments.out is not None:
        write_json(arguments.out, record, arguments.overwrite)
    return record


def score(case: Case, views: Sequence[raster.Projection], voted: Voted) -> list[float]:
    """[accuracy, mIoU] over Gaussians, and over the pixels of the views."""
    truth = case.truth
    numbers = torch.zeros(len(voted.indices), len(voted.codebook))
    numbers.scatter_add_(1, voted.indices[:, 0].long(), voted.weights[:, 0].float())
    labels = classes_of(cosines_from_codes(numbers, voted.codebook, voted.vectors))
    seen = (case.histogram > 0).any(1).numpy()
    pixels = [
        classes_of(
            raster.render_cosines(view, voted.indices, voted.weights, voted.codebook[None], voted.vectors)[
                0
            ].movedim(0, -1)
        ).ravel()
        for view in views
    ]
    shown = np.concatenate([truth.shown[camera.name].ravel() for camera in truth.held_out])
    return [
        *accuracy_and_miou(labels, np.where(seen, truth.of_gaussian, -1), truth.scored),
        *accuracy_and_miou(np.concatenate(pixels), shown, truth.scored),
    ]


def classes_of(cosines: Tensor) -> NDArray[np.int64]:
    """The class of the largest cosine [..., C]; -1 where there is no code, which has a cosine of 0 with all."""
    best, place = cosines.max(-1)
    return torch.where(best > 0, place, -1).numpy()


def accuracy_and_miou(
    found: NDArray[np.int64], true: NDArray[Any], scored: NDArray[np.bool_]
) -> tuple[float, float]:
    """Share that is right, and the mean over classes of intersection over union.

    Args:
        found: [n] class, -1 for none.
        true: [n] class, -1 where it is not known: not counted.
        scored: [C] classes that count.
    """
    count = len(scored)
    known = np.append(scored, False)[true]
    pairs = true[known].astype(np.int64) * (count + 1) + np.where(found[known] < 0, count, found[known])
    table = np.bincount(pairs, minlength=count * (count + 1)).reshape(count, count + 1)
    right = table.diagonal()
    union = table.sum(1) + table[:, :count].sum(0) - right
    there = table.sum(1) > 0
    return float(right.sum() / table.sum()), float((right[there] / union[there]).mean())


def figures(codes: SparseCodes, atoms: Tensor) -> dict[str, float]:
    """What codes of regions look like: the mean of a region's largest weight, how many atoms are used, and the norms of
    decoded codes, by which the vote weighs classes."""
    norms = torch.linalg.vector_norm(codes.to_dense() @ atoms, dim=1)
    return {
        "largest weight": float(codes.weights[:, 0].mean()),
        "atoms used": len(codes.indices.long()[codes.weights > 0].unique()),
        "least norm": float(norms.min()),
        "largest norm": float(norms.max()),
    }


def _rows(found: dict[str, dict[str, dict[str, Any]]]) -> list[tuple[str, str, dict[str, list[float]]]]:
    """(scene, seed, scores of each way)."""
    return [(scene, seed, of["scores"]) for scene, seeds in found.items() for seed, of in seeds.items()]


def differences(
    found: dict[str, dict[str, dict[str, Any]]], first: str, second: str
) -> dict[str, dict[str, Any]]:
    """By metric: the mean over scenes of first minus second, and its interval, seeds drawn scene by scene."""
    scenes, seeds, rows = zip(*_rows(found), strict=True)
    intervals = [
        bootstrap_interval([row[first][m] - row[second][m] for row in rows], seeds, scenes=scenes)
        for m in range(4)
    ]
    return {
        metric: {"mean": each.mean, "interval": each.ends}
        for metric, each in zip(METRICS, intervals, strict=True)
    }


def print_tables(record: dict[str, Any]) -> None:
    """For people; in percent."""
    rows = [[way, *(f"{100 * value:.2f}" for value in values)] for way, values in record["means"].items()]
    print("\n" + markdown(["way", *METRICS], rows))
    signed = [
        [
            name,
            *(
                f"{100 * of['mean']:+.2f} ({100 * of['interval'][0]:+.2f} to {100 * of['interval'][1]:+.2f})"
                for of in by.values()
            ),
        ]
        for name, by in record["differences"].items()
    ]
    print("\n" + markdown(["difference", *METRICS], signed))


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
