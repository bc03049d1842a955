"""Are absent things refused, and present ones not? Presence in views of scenes that chose nothing.

    python -m benchmarks.absence [--scenes kitchen-11 ... table-1 ...] [--seed 2] [--out docs/benchmarks/absence.json]

Every labelled view is asked for its labels (present), for the scene's other labels (out of view) and for words that
nothing in the scene is called (absent). The bounds of ``scoup.query.presence`` were chosen on the kitchen as given, its
draws 1 to 3, table-0 and shelves-0, with codebook seed 0.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
import tyro

from benchmarks.answer_scenes import AnswerScene, SceneSize, make_scene
from benchmarks.data import data_folder
from scoup.baselines.method import MethodSettings
from scoup.baselines.methods import METHODS
from scoup.baselines.sparse import SparseUplift
from scoup.bench import describe_environment, markdown, write_json
from scoup.models.words import with_everyday
from scoup.query.presence import PRESENT_FROM, view_z_scores
from scoup.query.segment import segment

PRESENT, OUT_OF_VIEW, ABSENT = "present", "out of view", "absent"
BOUNDS = (0.5, 1.0, 1.25, PRESENT_FROM, 1.75, 2.0, 2.3)


@dataclass(frozen=True)
class Arguments:
    scenes: tuple[str, ...] = (
        "kitchen-11",
        "kitchen-12",
        "kitchen-13",
        "table-1",
        "shelves-1",
        "hall-1",
        "yard-1",
    )
    """As in benchmarks.answers."""
    seed: int = 2
    """Of the codebook."""
    out: Path | None = None
    """Where the figures are written; replaced."""
    data: Path = field(default_factory=data_folder)
    """Folder that holds kitchen/ and clip/."""


def main(arguments: Arguments) -> dict[str, Any]:
    """Print the table and write the figures."""
    scenes: dict[str, Any] = {}
    for name in arguments.scenes:
        asked = ask(make_scene(name, arguments.data, SceneSize()), arguments.seed)
        scenes[name] = {f"from {bound:g}": refused(asked, bound) for bound in BOUNDS}
        scenes[name]["questions"] = {kind: len(values) for kind, values in asked.items()}
    kinds = (PRESENT, OUT_OF_VIEW, ABSENT)
    body = [
        [name, f"{bound:g}", *(f"{scenes[name][f'from {bound:g}'][kind]:.3f}" for kind in kinds)]
        for name in scenes
        for bound in BOUNDS
    ]
    print(markdown(["scene", "present from", *(f"{kind}, refused" for kind in kinds)], body))
    record = {
        "what": "benchmarks.absence: share of questions refused, by the bound on the z-score",
        "machine": describe_environment(),
        "seed": arguments.seed,
        "bound": PRESENT_FROM,
        "scenes": scenes,
    }
    if arguments.out is not None:
        write_json(arguments.out, record, overwrite=True)
    return record


def refused(asked: dict[str, list[float]], bound: float) -> dict[str, float]:
    """The share of each kind of question below a bound; 0 of none."""
    return {
        kind: round(float(np.mean([z < bound for z in values] or [0])), 4) for kind, values in asked.items()
    }


def ask(scene: AnswerScene, seed: int) -> dict[str, list[float]]:
    """The z-scores of all questions by their kind."""
    inputs = scene.inputs()
    uplift = METHODS["sparse"].uplift
    assert isinstance(uplift, SparseUplift)
    field = uplift(inputs, MethodSettings(seed)).field
    field.attach(scene.gaussians, known=True)
    words = (*scene.queries, *scene.absent)
    queries = torch.stack([scene.everyday[scene.words.index(word)] for word in words])
    canonical = with_everyday(scene.canonical, scene.everyday)
    found: dict[str, list[float]] = {PRESENT: [], OUT_OF_VIEW: [], ABSENT: []}
    for (frame, view), camera in zip(scene.frames, scene.cameras, strict=True):
        maps = field.relevancy(camera, queries, canonical, view)
        segments = [segment(each) for each in maps.unbind(1)]
        scores = view_z_scores(field, view, segments, queries, scene.everyday)
        for word, score in zip(words, scores.tolist(), strict=True):
            kind = ABSENT if word in scene.absent else PRESENT if word in frame.masks else OUT_OF_VIEW
            found[kind].append(score)
    return found


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
