"""Two claims of the paper on synthetic scenes with ground truth: the entropy of votes, and glass."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from statistics import mean
from typing import Any

import torch
from torch import Tensor

from scoup.query.presets import QUERY_PRESETS
from scoup.query.text_vectors import TextVectors
from scoup.scene.gaussians import Gaussians
from scoup_lab.baselines.rasterised_scene import RasterisedScene
from scoup_lab.evaluate.protocols.lerf_ovs import PROTOCOL
from scoup_lab.evaluate.protocols.pixels import LabelledScene
from scoup_lab.evaluate.scores import PairScore
from scoup_lab.evaluate.studies.ablation_rows import BASE, find_ablations
from scoup_lab.evaluate.studies.ablations import Ablations, ablation_record
from scoup_lab.evaluate.studies.study_scene import StudyScene
from scoup_lab.synthetic.scene import DemoScene

OBJECTS = ("m",)  # the level whose names are queried
PRESET = QUERY_PRESETS["scoup"]
GLASS = 0.1  # share of a thing's opacity that is left when it becomes glass


def study_scene(demo: DemoScene, gaussians: Gaussians) -> StudyScene:
    """Return a demo scene with its Gaussians or others, labelled in the views held out; nothing is written."""
    found = [(demo.labelled_frame(camera.name, OBJECTS), camera) for camera in demo.held_out]
    frames = [(frame, camera) for frame, camera in found if frame.labels]
    nowhere = Path()
    labelled = LabelledScene(demo.layout.name, nowhere, nowhere, nowhere, demo.held_out, PROTOCOL, frames)
    labels, canonical = labelled.labels, demo.canonical
    vectors = TextVectors(tuple(labels), demo.text_vectors(labels), canonical, canonical[:0])
    return StudyScene(labelled, vectors, RasterisedScene(gaussians, demo.building, demo.regions))


def entropy_rows(demo: DemoScene) -> dict[str, Any]:
    """Return mIoU of the rows of the entropy ablation: the half of a sort loses its codes, or is dropped
    from blending too."""
    scene = study_scene(demo, demo.gaussians)
    return ablation_record(Ablations(find_ablations(["entropy"]), PRESET, (0,)).results([scene]))


def members(demo: DemoScene, name: str) -> Tensor:
    """Return [N] boolean: the Gaussians that lie on an object."""
    of_objects = demo.parts.at_level(demo.part_of_gaussian.numpy(), "m")
    return torch.from_numpy(of_objects == demo.parts.names("m").index(name))


def as_glass(gaussians: Gaussians, chosen: Tensor) -> Gaussians:
    """Return the Gaussians with the opacity of those chosen [N] multiplied by ``GLASS``."""
    return replace(gaussians, opacities=torch.where(chosen, GLASS * gaussians.opacities, gaussians.opacities))


def glass_rows(demo: DemoScene, things: int) -> list[dict[str, Any]]:
    """Return mIoU and localisation of things before and after their opacity is multiplied by ``GLASS``, one
    thing at a time, and of all other things of the scene. The masks and embeddings of the regions stay as they
    are.
    """
    whole = study_scene(demo, demo.gaussians)
    before = whole.score(BASE.fit(whole.rasterised), PRESET).pairs
    labels = [pair.label for pair in before]
    rows = []
    for name in sorted(set(labels), key=lambda label: (-labels.count(label), label))[:things]:
        scene = study_scene(demo, as_glass(demo.gaussians, members(demo, name)))
        after = scene.score(BASE.fit(scene.rasterised), PRESET).pairs
        row: dict[str, Any] = {"thing": name, "views": labels.count(name)}
        for which, pairs in (("before", before), ("after", after)):
            own = [pair for pair in pairs if pair.label == name]
            others = [pair for pair in pairs if pair.label != name]
            row[which] = _scores(own) | {f"others_{key}": value for key, value in _scores(others).items()}
        rows.append(row)
    return rows


def _scores(pairs: list[PairScore]) -> dict[str, float | None]:
    if not pairs:
        return {"miou": None, "accuracy": None}
    return {"miou": mean(pair.iou for pair in pairs), "accuracy": mean(bool(pair.hit) for pair in pairs)}
