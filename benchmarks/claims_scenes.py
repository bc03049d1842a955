"""Claims of the paper on scenes with ground truth: entropy of votes and glass; on desk settings and features, too."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from statistics import mean
from typing import Any

import torch
from torch import Tensor

import scoup
from benchmarks.real_scenes import REAL_SCENES, RealScene
from scoup.query.question import TextVectors
from scoup.scene.cameras import Cameras
from scoup.scene.gaussians import Gaussians
from scoup.scene.regions import RegionMap, Regions
from scoup.uplift.build_settings import build_settings
from scoup.uplift.rasterise import region_sums
from scoup_lab.baselines.rasterised_scene import RasterisedScene
from scoup_lab.evaluate.protocols.lerf_ovs import PROTOCOL
from scoup_lab.evaluate.protocols.pixels import LabelledScene
from scoup_lab.evaluate.rules import MASK_RULES
from scoup_lab.evaluate.scores import PairScore
from scoup_lab.evaluate.studies.ablation_rows import BASE, find_ablations
from scoup_lab.evaluate.studies.ablations import Ablations, ablation_record
from scoup_lab.evaluate.studies.consistency import Consistency, consistency_record
from scoup_lab.evaluate.studies.study_scene import StudyScene
from scoup_lab.synthetic.scene import DemoScene

OBJECTS = ("m",)  # the level whose names are queried
RULE = MASK_RULES["scoup"]
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
    return ablation_record(Ablations(find_ablations(["entropy"]), RULE, (0,)).results([scene]))


def desk_scene(data: Path) -> StudyScene:
    """Return the real scene desk, all of whose photographs are built from."""
    desk, folder = RealScene.open("desk", data), data / "desk"
    files = folder, folder / "point_cloud.splat", folder / REAL_SCENES["desk"][1]
    labelled = LabelledScene("desk", *files, desk.cameras, PROTOCOL, desk.frames)
    labels, canonical = tuple(labelled.labels), desk.canonical
    queries = torch.stack([desk.everyday[desk.words.index(label)] for label in labels])
    vectors = TextVectors(labels, queries, canonical, canonical[:0])
    rasterised = RasterisedScene(scoup.load_gaussians(labelled.splat), desk.cameras, desk.regions)
    return StudyScene(labelled, vectors, rasterised)


def desk_rows(scene: StudyScene, things: int, seed: int) -> dict[str, Any]:
    """Return settings (the ablations of vote, atoms, non-zeros and entropy), agreement of features across views, and
    glass, of a scene with marked photographs."""
    ablations = find_ablations(["vote", "atoms", "non-zeros", "entropy"])
    results = Ablations(ablations, RULE, tuple(range(seed, seed + 3))).results([scene])
    features = Consistency(build_settings("default", seed=seed), seed=seed).results([scene])
    return {
        "settings": ablation_record(results),
        "features": consistency_record(features),
        "glass": glass_rows(scene, lambda name: marked_members(scene, name), things),
    }


def marked_members(scene: StudyScene, name: str) -> Tensor:
    """Return [N] boolean: the Gaussians most of whose contribution to labelled views lies in the marks of a name."""
    inside = torch.zeros(len(scene.rasterised.gaussians))
    everything = torch.zeros_like(inside)
    for frame, camera in scene.labelled.frames:
        if name in frame.masks:
            outside = (~frame.masks[name]).to(torch.int16)
            maps = {camera.name: {"m": RegionMap(outside, torch.eye(2))}}
            sums = region_sums(scene.rasterised.gaussians, Cameras([camera]), Regions.from_maps(maps))
            weights = sums.matrix(0, {camera.name: slice(0, 2)}).toarray()
            inside += torch.from_numpy(weights[:, 0])
            everything += torch.from_numpy(weights.sum(1))
    return inside > everything / 2


def members(demo: DemoScene, name: str) -> Tensor:
    """Return [N] boolean: the Gaussians that lie on an object."""
    of_objects = demo.parts.at_level(demo.part_of_gaussian.numpy(), "m")
    return torch.from_numpy(of_objects == demo.parts.names("m").index(name))


def as_glass(gaussians: Gaussians, chosen: Tensor) -> Gaussians:
    """Return the Gaussians with the opacity of those chosen [N] multiplied by ``GLASS``."""
    return replace(gaussians, opacities=torch.where(chosen, GLASS * gaussians.opacities, gaussians.opacities))


def glass_rows(whole: StudyScene, members_of: Callable[[str], Tensor], things: int) -> list[dict[str, Any]]:
    """Return mIoU and localisation of things before and after their opacity is multiplied by ``GLASS``, one
    thing at a time, and of all other things of the scene. The masks and embeddings of the regions stay as they
    are. ``members_of`` returns [N] whether each Gaussian lies on a thing.
    """
    before = whole.score(BASE.fit(whole.rasterised), RULE).pairs
    labels = [pair.label for pair in before]
    rows = []
    for name in sorted(set(labels), key=lambda label: (-labels.count(label), label))[:things]:
        base = whole.rasterised
        glass = as_glass(base.gaussians, members_of(name))
        scene = replace(whole, rasterised=RasterisedScene(glass, base.cameras, base.regions))
        after = scene.score(BASE.fit(scene.rasterised), RULE).pairs
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
