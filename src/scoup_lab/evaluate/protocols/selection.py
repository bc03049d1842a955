"""The 3D-selection protocol: Gaussians are chosen by their own relevancy, and the silhouette of those chosen meets the
2D label (docs/evaluation.md, after VALA-3D).

Never to be mixed with the 2D protocols: the same field scores very differently (LangSplat has 51.4 there and 9.66
here).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from scoup import raster
from scoup.base.errors import InputError
from scoup.query.question import TextVectors
from scoup.query.votes import select_by_relevancy
from scoup.scene.cameras import Camera
from scoup.scene.gaussians import Gaussians
from scoup_lab.baselines.fitted import FittedMethod
from scoup_lab.data.labels import LabelledFrame
from scoup_lab.evaluate.metrics import iou
from scoup_lab.evaluate.protocols.neighbourhood import Neighbourhood
from scoup_lab.evaluate.protocols.pixels import LabelledScene
from scoup_lab.evaluate.scores import PairScore, SceneScore, scene_score

PROTOCOL = "3D selection"


@dataclass(frozen=True)
class SelectionPreset:
    """Constants from relevancy of Gaussians to a silhouette; the defaults are VALA-3D's."""

    name: str = "vala-3d"  # for tables
    neighbours: int | None = 10  # blend half and half with the mean of this many neighbours; None: do not
    threshold: float = 0.6  # of the rescaled relevancy
    silhouette: float = 10 / 255  # a pixel belongs to the silhouette above this opacity


VALA_3D = SelectionPreset()


def silhouette(
    gaussians: Gaussians,
    chosen: Tensor,
    camera: Camera,
    raster_preset: str,
    least: float = VALA_3D.silhouette,
) -> Tensor:
    """Return [H, W] boolean: where the chosen Gaussians [N], drawn alone, are more opaque than ``least``.

    Drawn alone means that nothing hides them: a thing behind another one has its whole silhouette.
    """
    if not chosen.any():
        return torch.zeros(camera.height, camera.width, dtype=torch.bool, device=chosen.device)
    alone = gaussians.select(chosen)
    projection = raster.project(alone, camera, raster_preset)
    nothing = torch.zeros(len(alone), 1, device=alone.device)
    return raster.render_channels(projection, nothing)[1] > least


def score_scene(
    scene: str,
    gaussians: Gaussians,
    frames: Iterable[tuple[LabelledFrame, Camera]],
    chosen: Mapping[str, Tensor],
    raster_preset: str = "inria",
    preset: SelectionPreset = VALA_3D,
) -> SceneScore:
    """Score every label of every frame.

    ``chosen``: label -> [N] boolean, the Gaussians selected for it in the whole scene.
    """
    pairs = []
    for frame, camera in frames:
        truth = frame.resized(camera.width, camera.height)
        for label in frame.labels:
            if label not in chosen:
                raise InputError(f"frame {frame.name!r}: there is no selection for the label {label!r}")
            shape = silhouette(gaussians, chosen[label], camera, raster_preset, preset.silhouette).cpu()
            # A selection that shows nothing scores 0, even where the truth is empty too.
            score = iou(shape, truth.masks[label]) if shape.any() else 0.0
            pairs.append(PairScore(frame.name, label, score, None, -1, float("nan"), None))
    return scene_score(scene, preset.name, pairs, PROTOCOL)


def score_method(
    scene: LabelledScene, vectors: TextVectors, fitted: FittedMethod, gaussians: Gaussians, raster_preset: str
) -> SceneScore:
    """Select Gaussians for every label by what a method made of a scene, and score the scene."""
    rule, coded = VALA_3D, fitted.coded()
    around = Neighbourhood.of(gaussians.means, coded.any(0), rule.neighbours) if rule.neighbours else None
    chosen = {}
    for label, query in zip(vectors.texts, vectors.queries, strict=True):
        relevancy = fitted.gaussian_relevancy(query[None], vectors.canonical)[:, 0]
        blended = relevancy if around is None else around.blend(relevancy, coded)
        chosen[label] = select_by_relevancy(blended, coded, rule.threshold).mask
    return score_scene(scene.name, gaussians, scene.frames, chosen, raster_preset, rule)
